"""A grid has the same results in one process, in several, and on a cluster that loses a node."""

import gc
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import cloudpickle
import numpy as np
import pytest

from mmc_gym import _grid
from mmc_gym._grid import CellError, run_grid

# Workers cannot import this module.
cloudpickle.register_pickle_by_value(sys.modules[__name__])

PATIENCE = 60.0  # seconds
OBJECT_STORE = 100 * 2**20  # bytes


@dataclass(frozen=True)
class Draw:
    """Random numbers; on a cluster, with notes on where they were drawn."""

    seed: int
    size: int = 100
    notes: Path | None = None


def draw(cell):
    note_and_wait(cell.notes, cell.seed, "begun")
    numbers = np.random.default_rng(cell.seed).random(cell.size)
    note_and_wait(cell.notes, cell.seed, "done")
    return numbers


def note_and_wait(notes, seed, stage):
    """Let the victim finish two cells and never its third, and the others none before that."""
    if notes is None:
        return
    import ray

    node, victim = ray.get_runtime_context().get_node_id(), (notes / "victim").read_text()
    if stage == "done" and node != victim:
        wait_for(lambda: (notes / "held").exists())
    note = f"{stage}-{seed}-{node}-{time.monotonic_ns()}"
    (notes / note).touch()
    if stage == "begun" and node == victim and len(list(notes.glob(f"done-*-{victim}-*"))) == 2:
        (notes / "held").write_text(str(seed))
        time.sleep(2 * PATIENCE)


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


def raise_unpicklable(number):
    class Unpicklable(Exception):
        def __init__(self, first, second):
            super().__init__("lost a half")

    raise Unpicklable(1, 2)


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


def double_in_place(array):
    array *= 2
    return array


IN_BOTH = pytest.mark.parametrize("jobs", [1, pytest.param(2, marks=pytest.mark.slow)])


@IN_BOTH
def test_results_come_in_the_order_of_the_cells(jobs):
    seen = []
    results = run_grid(square, range(6), jobs=jobs, on_result=lambda *result: seen.append(result))
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
        (sys.exit, 3, "SystemExit: 3"),
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
    command = [sys.executable, "-c", code]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as parent:
        workers = [int(parent.stdout.readline()) for _ in range(2)]
        parent.kill()
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


def test_other_clusters_and_no_jobs_are_refused_and_without_ray_the_extra_is_named(monkeypatch):
    for cluster in ("", "dask", "ray:", "ray://", "ray://host", "ray:/h:1"):
        with pytest.raises(ValueError, match=rf"cluster must be .*, got '{cluster}"):
            run_grid(square, [1], cluster=cluster)
    with pytest.raises(ValueError, match=r"jobs must be .*, got 0"):
        run_grid(square, [1], jobs=0)
    monkeypatch.setattr(_grid.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r'pip install "mmc-gym\[cluster\]"'):
        run_grid(square, [1], cluster="ray")


def uses_ray(test):
    """Mark a test; Ray leaves some of its files to the garbage collector."""
    ignored = ("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
    return pytest.mark.slow(pytest.mark.filterwarnings(*ignored)(test))


@pytest.fixture
def ray(monkeypatch):
    """Ray, in a temporary folder with a name short enough for sockets."""
    module = pytest.importorskip("ray")
    folder = tempfile.mkdtemp(prefix="ray", dir="/tmp")
    monkeypatch.setenv("RAY_TMPDIR", folder)
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    # Otherwise the client server dies at one start in ten or so (Ray's issue 63202).
    monkeypatch.setenv("GRPC_ENABLE_FORK_SUPPORT", "0")
    yield module
    module.shutdown()
    shutil.rmtree(folder, ignore_errors=True)
    gc.collect()


@pytest.fixture
def cluster(ray):
    from ray.cluster_utils import Cluster

    started = Cluster()
    yield started
    ray.shutdown()
    started.shutdown()


@uses_ray
def test_a_local_ray_gives_what_processes_give_and_names_errors_too(ray, monkeypatch):
    monkeypatch.setenv("RAY_ADDRESS", "local")
    cells = [Draw(seed) for seed in range(4)]
    draws = run_grid(draw, cells, jobs=2, cluster="ray")
    np.testing.assert_array_equal(draws, run_grid(draw, cells, jobs=1))
    assert not ray.is_initialized()  # what was begun is ended

    ray.init("local", num_cpus=2, include_dashboard=False, object_store_memory=OBJECT_STORE)
    array = run_grid(double_in_place, [np.ones(300_000)], cluster="ray")[0]
    assert array.flags.writeable
    assert run_grid(threads, range(2), cluster="ray") == [(1, "1")] * 2
    seen = {}
    with pytest.raises(CellError, match="cell 1, 3, failed: ValueError: three is refused"):
        run_grid(refuse_three, [0, 3, *range(4, 90)], cluster="ray", on_result=seen.__setitem__)
    assert seen[0] == 0 and len(seen) < 80
    with pytest.raises(CellError, match="cell 0, 3, failed: SystemExit: 3"):
        run_grid(sys.exit, [3], cluster="ray")
    monkeypatch.setattr(_grid, "_sources", lambda: "others")
    with pytest.raises(CellError, match="must have the caller's sources of mmc_gym"):
        run_grid(square, [1], cluster="ray")
    assert ray.is_initialized()  # what was there stays


@uses_ray
def test_a_ray_cluster_that_loses_a_node_gives_what_one_process_gives(
    ray, cluster, monkeypatch, tmp_path
):
    cluster.add_node(num_cpus=1, include_dashboard=False, object_store_memory=OBJECT_STORE)
    victim = cluster.add_node(num_cpus=1, object_store_memory=OBJECT_STORE)
    (tmp_path / "victim").write_text(victim.node_id)
    monkeypatch.setenv("RAY_ADDRESS", cluster.address)
    killed = []

    def kill(index, result):
        if not killed:
            wait_for((tmp_path / "held").exists)
            cluster.remove_node(victim, allow_graceful=False)
            killed.append(index)

    # Results of this size stay on the node that made them until they are asked for.
    cells = [Draw(seed, 50_000, tmp_path) for seed in range(12)]
    results = run_grid(draw, cells, jobs=6, cluster="ray", on_result=kill)

    begun = [note.name.split("-")[1:3] for note in tmp_path.glob("begun-*")]
    held = (tmp_path / "held").read_text()
    nodes = [node for seed, node in begun if seed == held]
    assert victim.node_id in nodes  # it was under way there,
    assert len(set(nodes)) == 2  # and was begun again elsewhere
    assert len([node for _, node in begun if node == victim.node_id]) == 3
    expected = run_grid(draw, [Draw(seed, 50_000) for seed in range(12)], jobs=1)
    np.testing.assert_array_equal(results, expected)


@uses_ray
def test_a_ray_client_gives_what_one_process_gives(ray, cluster):
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        port = server.getsockname()[1]
    options = {"object_store_memory": OBJECT_STORE, "ray_client_server_port": port}
    cluster.add_node(num_cpus=2, include_dashboard=False, **options)
    cells = [Draw(seed) for seed in range(4)]
    results = run_grid(draw, cells, cluster=f"ray://127.0.0.1:{port}")
    np.testing.assert_array_equal(results, run_grid(draw, cells, jobs=1))
