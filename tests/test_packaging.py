"""What an installed mmc-gym is: light to import, complete in its wheel and its source archive."""

from __future__ import annotations

import fnmatch
import re
import subprocess
import sys
import tarfile
import zipfile
from importlib.metadata import requires, version
from pathlib import Path, PurePosixPath

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]

# As `fnmatch` reads them: a star crosses folders.
SHIPPED = {
    "mmc_gym/py.typed",
    "mmc_gym/network/weights/*.safetensors",
    "mmc_gym/training/hyperparams/*.yml",
    "mmc_gym/agents/pretrained/*.json",
    "mmc_gym/agents/pretrained/*.safetensors",
    "mmc_gym/report/templates/*.css",
    "mmc_gym/report/templates/*.html.j2",
    "mmc_gym/report/templates/*.js",
}

HEAVY = {
    "matplotlib",
    "numba",
    "pandas",
    "pydantic",
    "pygame",
    "rich",
    "scipy",
    "stable_baselines3",
    "torch",
}


def run_python(code: str) -> str:
    """Return what a fresh interpreter prints."""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, cwd=ROOT
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def package_files() -> set[str]:
    """Return every file of the package as an archive names it: `mmc_gym/cli.py`."""
    files = (path for path in (ROOT / "mmc_gym").rglob("*") if path.is_file())
    relative = (path.relative_to(ROOT) for path in files)
    return {
        path.as_posix()
        for path in relative
        if "__pycache__" not in path.parts and not path.name.startswith(".")
    }


def build(kind: str, folder: Path) -> Path:
    """Build the wheel or sdist of the source tree with the installed hatchling."""
    hook = f"import hatchling.build as b; print(b.build_{kind}({str(folder)!r}))"
    return folder / run_python(hook).split()[-1]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> set[str]:
    """Return the paths in the wheel."""
    with zipfile.ZipFile(build("wheel", tmp_path_factory.mktemp("wheel"))) as archive:
        return set(archive.namelist())


@pytest.fixture(scope="module")
def sdist(tmp_path_factory: pytest.TempPathFactory) -> set[str]:
    """Return the paths in the source archive, below its one top folder."""
    with tarfile.open(build("sdist", tmp_path_factory.mktemp("sdist"))) as archive:
        return {name.partition("/")[2] for name in archive.getnames()}


def test_import_loads_no_heavy_library():
    loaded = run_python("import sys, mmc_gym; print(*{name.split('.')[0] for name in sys.modules})")
    assert HEAVY.isdisjoint(loaded.split())


def test_all_that_people_reach_for_is_at_the_top_and_loaded_when_it_is_asked_for():
    shown = run_python(
        "import sys, mmc_gym\n"
        "assert set(mmc_gym.__all__) <= set(dir(mmc_gym))\n"
        "assert 'mmc_gym.measures' not in sys.modules\n"
        "from mmc_gym import *\n"
        "from mmc_gym.benchmark.compare import compare as original\n"
        "assert mmc_gym.compare is compare is original\n"
        "print(len(mmc_gym.measures.MEASURES) > 20, callable(train), list_tasks()[0])\n"
        "try: mmc_gym.compar\n"
        "except AttributeError as error: print(error)"
    )
    assert shown == "True True random\nmodule 'mmc_gym' has no attribute 'compar'\n"


def test_gymnasium_finds_the_environment_by_module_and_name():
    run_python("import gymnasium; gymnasium.make('mmc_gym:MMCReach-v0').close()")


def test_the_default_engine_needs_no_numba():
    blocked = "import sys; sys.modules['numba'] = None; import gymnasium, mmc_gym"
    run_python(f"{blocked}; gymnasium.make('MMCReach-v0').reset()")


def test_the_tests_need_no_peer_of_the_benchmarks():
    requirements = [Requirement(line) for line in requires("mmc-gym") or []]
    dev, benchmark = (
        {one.name for one in requirements if one.marker and one.marker.evaluate({"extra": extra})}
        for extra in ("dev", "benchmark")
    )
    assert "gymnasium" in benchmark
    assert benchmark.isdisjoint(dev)


def test_the_version_is_the_distribution_s():
    assert run_python("import mmc_gym; print(mmc_gym.__version__)").strip() == version("mmc-gym")


@pytest.mark.slow
@pytest.mark.parametrize("archive", ["wheel", "sdist"])
def test_archive_holds_every_file_of_the_package(archive, request):
    assert package_files() <= request.getfixturevalue(archive)


@pytest.mark.slow
@pytest.mark.parametrize("archive", ["wheel", "sdist"])
@pytest.mark.parametrize("pattern", sorted(SHIPPED))
def test_archive_ships_the_data(archive, pattern, request):
    assert fnmatch.filter(request.getfixturevalue(archive), pattern)


@pytest.mark.slow
def test_wheel_holds_the_licence_and_nothing_beside_the_package(wheel):
    tops = {PurePosixPath(name).parts[0] for name in wheel}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"mmc_gym"}
    assert any(name.endswith(".dist-info/licenses/LICENSE") for name in wheel)


@pytest.mark.slow
def test_sdist_holds_what_a_rebuild_and_its_tests_need(sdist):
    needed = {"LICENSE", "README.md", "pyproject.toml", "constraints.txt", "Makefile"}
    needed |= {"SECURITY.md", "tests/test_packaging.py", "docs/contact-sheet.png"}
    assert needed <= sdist


def test_every_requirement_is_pinned_exactly():
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pins = {}
    for line in lines:
        if line and not line.startswith("#"):
            pin = Requirement(line)
            pins[canonicalize_name(pin.name)] = str(pin.specifier)
    assert all(re.fullmatch(r"==[\w.]+", version) for version in pins.values())
    needed = {canonicalize_name(Requirement(line).name) for line in requires("mmc-gym") or []}
    assert needed <= pins.keys()
