"""A grid has the same results in one process and in several."""

import os
import subprocess
import sys
import time
from pathlib import Path

import cloudpickle
import pytest

from mmc_gym import _grid
from mmc_gym._grid import CellError, run_grid

# Workers cannot import this module.
cloudpickle.register_pickle_by_value(sys.modules[__name__])

PATIENCE = 60.0  # seconds


def wait_for(condition):
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def square(number):
    return number * number


def refuse_three(number):
    if number == 3:
        raise ValueError("three is refused")
    return number


class Unpicklable(Exception):
    def __init__(self, one, two):
        super().__init__("lost a half")


def raise_unpicklable(number):
    raise Unpicklable(1, 2)


def end(number):
    sys.exit(3)


def die(cell):
    """End this process, unless `cell` is a number, or a file that a first call has made."""
    if isinstance(cell, Path):
        if cell.exists():
            return "computed again"
        cell.touch()
    if not isinstance(cell, int):
        time.sleep(0.2)  # so that another cell is under way
        os._exit(9)
    return cell


def threads(number):
    import torch

    return torch.get_num_threads(), os.environ.get("OMP_NUM_THREADS")


IN_BOTH = pytest.mark.parametrize("jobs", [1, pytest.param(2, marks=pytest.mark.slow)])


@IN_BOTH
def test_results_come_in_the_order_of_the_cells(jobs):
    seen = []
    results = run_grid(square, range(6), jobs=jobs, on_result=lambda *one: seen.append(one))
    assert results == [0, 1, 4, 9, 16, 25]
    assert sorted(seen) == list(enumerate(results))


@pytest.mark.parametrize("jobs", [1, 2])
def test_an_error_names_its_cell_after_the_others_are_handed_over(jobs):
    seen = {}
    with pytest.raises(CellError, match="cell 1, 3, failed: ValueError: three is refused") as info:
        run_grid(refuse_three, [0, 3, *range(4, 90)], jobs=jobs, on_result=seen.__setitem__)
    assert isinstance(info.value.__cause__, ValueError)
    assert seen[0] == 0 and 1 not in seen
    assert len(seen) < 80  # no more are begun


@pytest.mark.parametrize(
    ("function", "cell", "message"),
    [
        (raise_unpicklable, 1, "RuntimeError: Unpicklable: lost a half"),
        (end, 1, "SystemExit: 3"),
        (square, (n for n in ()), "cell 0, .*TypeError: it cannot be pickled: .*generator"),
    ],
)
def test_what_cannot_travel_is_an_error_of_its_cell(function, cell, message):
    with pytest.raises(CellError, match=message):
        run_grid(function, [cell, cell], jobs=2)


def test_a_cell_whose_worker_died_is_computed_again_and_one_that_kills_it_twice_is_named(tmp_path):
    died = {}
    cells = [0, tmp_path / "died", "killer", *range(3, 6)]
    results = run_grid(die, cells, jobs=2, on_failure=died.__setitem__)
    assert results == [0, "computed again", None, 3, 4, 5]
    assert [type(error.__cause__) for error in died.values()] == [_grid.WorkerDied]
    assert run_grid(die, ["killer"], on_failure=died.__setitem__) == [None]
    assert sorted(died) == [0, 2]
    assert run_grid(die, []) == []


def test_workers_end_when_their_parent_is_killed():
    code = (
        "import os, time; from mmc_gym._grid import run_grid\n"
        "def work(cell):\n"
        "    os.write(1, f'{os.getpid()}\\n'.encode())\n"  # a print may be cut in two
        "    time.sleep(60)\n"
        "run_grid(work, range(2), jobs=2)"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as one:
        workers = [int(one.stdout.readline()) for _ in range(2)]
        one.kill()
    for worker in workers:
        wait_for(lambda process=worker: not is_running(process))


def is_running(process):
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@IN_BOTH
def test_a_worker_computes_on_one_thread(jobs):
    torch = pytest.importorskip("torch")
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        assert [count for count, _ in run_grid(threads, range(2), jobs=jobs)] == [1, 1]
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)


def test_no_jobs_are_refused():
    with pytest.raises(ValueError, match=r"jobs must be .*, got 0"):
        run_grid(square, [1], jobs=0)
