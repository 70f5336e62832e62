"""Build the wheel and the source archive, and try each in an empty virtual environment.

    python .ci/packages.py [FOLDER]

Both are built into FOLDER (default: dist).  Each is installed where nothing else is, and the first
Python example of README.md runs there; what needs an extra says which; the tests of the network run
from the unpacked source archive.  Exit status 0: both work.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tarfile
import tempfile
import time
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
CONSTRAINTS = ROOT / "constraints.txt"
# Whatever is set for the tests of the source tree must not reach the installed package.
ENVIRONMENT = {
    **{name: value for name, value in os.environ.items() if not name.startswith("PYTHON")},
    "PIP_BUILD_CONSTRAINT": str(CONSTRAINTS),
    "PIP_CONSTRAINT": str(CONSTRAINTS),
    "PIP_DISABLE_PIP_VERSION_CHECK": "1",
}

# Code that needs an extra, by the extra.
NEEDS = {
    "fast": "import mmc_gym; mmc_gym.make('random', engine='analytic')",
    "video": "from mmc_gym.record import record; record('film.mp4')",
    "cluster": "import mmc_gym.benchmark.runner as one; one.benchmark(['mmc'], 'x', cluster='ray')",
    "training": "import mmc_gym; mmc_gym.train('sac', steps=1, tensorboard='logs')",
}


def main() -> None:
    """Build both, then try one after the other."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", nargs="?", type=Path, default=Path("dist"))
    folder = parser.parse_args().folder.resolve()
    with tempfile.TemporaryDirectory() as scratch:
        for package in build(folder, Path(scratch) / "build"):
            try_out(package, Path(scratch) / package.suffix.strip("."))


def build(folder: Path, scratch: Path) -> list[Path]:
    """Return the new wheel and source archive in `folder`."""
    python = empty_environment(scratch)
    install(python, "hatchling")
    run(python, "-m", "hatchling", "build", "-t", "wheel", "-t", "sdist", "-d", folder, cwd=ROOT)
    [version] = {path.name.split("-")[1] for path in folder.glob("*.whl")}
    return [*folder.glob("*.whl"), folder / f"mmc_gym-{version}.tar.gz"]


def try_out(package: Path, scratch: Path) -> None:
    """Install `package` into an empty environment; run README's first example in it."""
    started = time.monotonic()
    python = empty_environment(scratch / "environment")
    install(python, package)
    installed = time.monotonic()
    example = scratch / "example.py"
    example.write_text(first_example((ROOT / "README.md").read_text(encoding="utf-8")))
    print(f"{package.name}: README's first example prints", flush=True)
    run(python, "-W", "error", example, cwd=scratch)
    run(python, "-m", "mmc_gym.cli", "--help", cwd=scratch, stdout=subprocess.DEVNULL)
    for extra, code in NEEDS.items():
        done = subprocess.run([python, "-c", code], capture_output=True, text=True, env=ENVIRONMENT)
        if done.returncode == 0 or f'pip install "mmc-gym[{extra}]"' not in done.stderr:
            sys.exit(f"failed: without the extra {extra} {code!r} says {done.stderr}")
    if package.name.endswith(".tar.gz"):
        test(package, python, scratch)
    print(
        f"{package.name}: works; {installed - started:.0f} s to install, "
        f"{time.monotonic() - installed:.0f} s to try",
        flush=True,
    )


def test(archive: Path, python: Path, scratch: Path) -> None:
    """Run the tests of the network from the unpacked source archive."""
    install(python, "pytest", "hypothesis")
    with tarfile.open(archive) as opened:
        opened.extractall(scratch, filter="data")
    tree = scratch / archive.name.removesuffix(".tar.gz")
    run(python, "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests/network", cwd=tree)


def first_example(markdown: str) -> str:
    """Return the first Python block."""
    found = re.search(r"^```python\n(.*?)^```", markdown, re.DOTALL | re.MULTILINE)
    assert found is not None, "no Python block"
    return found[1]


def empty_environment(folder: Path) -> Path:
    """Make a virtual environment with pip alone; return its Python."""
    venv.create(folder, with_pip=True)
    return folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


def install(python: Path, *requirements: str | Path) -> None:
    """Install with the constraints; compile modules only when they are imported."""
    run(python, "-m", "pip", "install", "--quiet", "--no-compile", *requirements)


def run(*command: str | Path, cwd: Path | None = None, stdout: int | None = None) -> None:
    """Run a command; if it fails, say which and end."""
    done = subprocess.run(command, cwd=cwd, stdout=stdout, env=ENVIRONMENT)
    if done.returncode:
        sys.exit(f"failed ({done.returncode}): {' '.join(map(str, command))}")


if __name__ == "__main__":
    main()
