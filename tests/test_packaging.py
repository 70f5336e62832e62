"""What an installed mmc-gym is: light to import, complete in its wheel and its source archive."""

import re
import tarfile
import zipfile
from functools import partial
from importlib.metadata import requires, version
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.processes import run_python

ROOT = Path(__file__).resolve().parents[1]

HEAVY = {"matplotlib", "numba", "pandas", "pydantic", "pygame", "pymunk", "rich", "scipy", "torch"}
HEAVY |= {"stable_baselines3", "yaml"}


run_strictly = partial(run_python, "-W", "error", "-c", folder=ROOT)


def build(kind, folder):
    """Build the wheel or sdist of the source tree with the installed hatchling."""
    hook = f"import hatchling.build as b; print(b.build_{kind}({str(folder)!r}))"
    return folder / run_strictly(hook).split()[-1]


def test_import_loads_no_heavy_library_and_the_default_engine_needs_no_numba():
    loaded = run_strictly(
        "import sys, mmc_gym; print(*{name.split('.')[0] for name in sys.modules})\n"
        "from mmc_gym.cli import main\n"
        "try: main(['--help'])\n"
        "except SystemExit: assert 'torch' not in sys.modules\n"
        "sys.modules['numba'] = None\n"
        "import gymnasium; gymnasium.make('MMCReach-v0').reset()"
    )
    assert HEAVY.isdisjoint(loaded.splitlines()[0].split())


def test_import_loads_few_modules_and_lines_of_ours():
    shown = run_strictly(
        "import sys, mmc_gym\n"
        "print(*(one.__file__ for name, one in sys.modules.items() if name.startswith('mmc_gym')))"
    )
    loaded = [Path(path).read_text("utf-8") for path in shown.split()]
    assert len(loaded) <= 25
    assert sum(text.count("\n") for text in loaded) <= 5000


def test_every_requirement_is_pinned_exactly():
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pins = [Requirement(line) for line in lines if line and not line.startswith("#")]
    assert all(re.fullmatch(r"==[\w.]+", str(pin.specifier)) for pin in pins)
    needed = {canonicalize_name(Requirement(line).name) for line in requires("mmc-gym") or []}
    assert needed <= {canonicalize_name(pin.name) for pin in pins}


def test_what_needs_numba_says_how_to_get_it():
    shown = run_strictly(
        "import sys; sys.modules['numba'] = None\n"
        "try: import mmc_gym.body.analytic.arms\n"
        "except ImportError as error: print(error)"
    )
    assert shown.strip().endswith('pip install "mmc-gym[fast]"')


def test_public_names_are_at_the_top_and_loaded_when_they_are_used():
    shown = run_strictly(
        "import gymnasium; gymnasium.make('mmc_gym:MMCReach-v0').close()\n"
        "import sys, mmc_gym\n"
        "assert set(mmc_gym.__all__) <= set(dir(mmc_gym))\n"
        "assert 'mmc_gym.benchmark' not in sys.modules\n"
        "from mmc_gym import *\n"
        "from mmc_gym.benchmark.compare import compare as original\n"
        "assert mmc_gym.compare is compare is original\n"
        "print(len(mmc_gym.measures.MEASURES) > 10, callable(train), list_tasks()[0])\n"
        "print(mmc_gym.__version__)\n"
        "try: mmc_gym.compar\n"
        "except AttributeError as error: print(error)"
    )
    assert shown.splitlines() == [
        "True True random",
        version("mmc-gym"),
        "module 'mmc_gym' has no attribute 'compar'",
    ]


@pytest.mark.parametrize("folder", ["studies", "benchmarks", "examples"])
def test_studies_benchmarks_and_examples_use_public_names_only(folder):
    private = re.compile(r"(?:from|import) mmc_gym[\w.]*\._|from mmc_gym[\w.]* import .*\b_[a-z]")
    files = [*(ROOT / folder).rglob("*.py"), *(ROOT / folder).rglob("*.ipynb")]
    assert files
    assert not [path for path in files if private.search(path.read_text("utf-8"))]


@pytest.mark.slow
def test_the_archives_hold_every_file_of_the_package_and_the_wheel_nothing_else(tmp_path):
    package = {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "mmc_gym").rglob("*")
        if path.is_file() and "__pycache__" not in path.parts and not path.name.startswith(".")
    }
    with zipfile.ZipFile(build("wheel", tmp_path)) as archive:
        wheel = set(archive.namelist())
    assert package <= wheel
    others = {name for name in wheel if not name.startswith("mmc_gym/")}
    assert all(".dist-info/" in name for name in others)
    assert any(name.endswith(".dist-info/licenses/LICENSE") for name in others)
    with tarfile.open(build("sdist", tmp_path)) as archive:
        sdist = {name.partition("/")[2] for name in archive.getnames()}
    needed = {"LICENSE", "README.md", "pyproject.toml", "constraints.txt", "Makefile"}
    needed |= {"SECURITY.md", "tests/test_packaging.py", "docs/compare.png"}
    assert package | needed | {"studies/README.md", "benchmarks/speed.py"} <= sdist
