"""Grids: one function of many cells, computed in processes of this machine or on a Ray cluster.

A cell is whatever the function takes, a result whatever it returns; both travel pickled, and the
process that asked for the grid is the only one that keeps anything, since the nodes of a cluster
may share no file system.  Every worker computes on one thread, so that results do not depend on
the number of processors.
"""

from __future__ import annotations

import hashlib
import importlib.util
import logging
import os
import pickle
import socket
import sys
import time
import traceback
import warnings
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, TypeAlias, TypeVar, cast

import cloudpickle
from joblib import Parallel, cpu_count, delayed, parallel_config


def set_torch_threads(threads: int) -> int | None:
    """Set the number of torch's threads, if it is loaded, and return what it was."""
    torch: Any = sys.modules.get("torch")
    if torch is None:
        return None
    before: int = torch.get_num_threads()
    torch.set_num_threads(threads)
    return before


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Torch on one thread: small networks run faster so, and the same with any number of cores."""
    threads = set_torch_threads(1)
    try:
        yield
    finally:
        if threads is not None:
            set_torch_threads(threads)


Cell = TypeVar("Cell")
Value = TypeVar("Value")

ATTEMPTS = 5  # that a cell has on Ray: four nodes or workers may die under it
_LOCAL_OBJECT_STORE = 256 * 2**20  # bytes; larger results overflow to the disk
_HANDOVER_SECONDS = 0.2  # a thread of this process needs to pass on a call; microseconds, if idle
_GROWTH_SECONDS = 5.0  # after which a cluster may have got more nodes
_LONGEST_REPR = 200


class CellError(RuntimeError):
    """The function raised in one cell of a grid; the error it raised is the `__cause__`.

    Attributes:
        index: of the cell.
        cell: itself.
    """

    def __init__(self, index: int, cell: object, reason: str) -> None:
        super().__init__(index, cell, reason)
        self.index = index
        self.cell = cell

    def __str__(self) -> str:
        index, cell, reason = self.args
        text = repr(cell)
        if len(text) > _LONGEST_REPR:
            text = f"{text[:_LONGEST_REPR]}..."
        return f"cell {index}, {text}, failed: {reason}"


def check_cluster(cluster: str | None) -> None:
    """Raise a `ValueError` unless `run_grid` could use `cluster`, as far as this machine knows."""
    if cluster is None:
        return
    host, _, port = cluster.removeprefix("ray://").rpartition(":")
    if cluster != "ray" and not (cluster.startswith("ray://") and host and port.isdecimal()):
        raise ValueError(f"cluster must be 'ray' or 'ray://HOST:PORT', got {cluster!r}")
    if importlib.util.find_spec("ray") is None:
        raise ValueError(
            f'cluster {cluster!r} needs Ray, which is not installed: pip install "mmc-gym[cluster]"'
        )


def run_grid(
    function: Callable[[Cell], Value],
    cells: Iterable[Cell],
    *,
    jobs: int | None = None,
    cluster: str | None = None,
    on_result: Callable[[int, Value], None] | None = None,
) -> list[Value]:
    """Compute `function` of every cell, in many processes at once.

    Args:
        function: of one cell.  It can be pickled, depends on nothing but its cell, and leaves
            nothing behind but its result: a cell is computed again where a node dies.
        cells: arguments, which can be pickled.
        jobs: how many cells are computed at once; 1 is in this process.  By default as many as
            this machine, or the cluster, has processors.
        cluster: `None` for this machine; `"ray"` for the Ray cluster that `RAY_ADDRESS` names or
            this machine belongs to, and a local one if there is none; `"ray://HOST:PORT"` for
            the one whose client server listens there.  Every node needs the very
            sources of `mmc_gym` that this machine has, and refuses work if it has others.
        on_result: is called here with (index, result) of each cell as soon as it is finished, to
            show progress and to keep results.

    Returns:
        The results, in the order of the cells.

    Raises:
        ValueError: if `jobs` or `cluster` is none of those, or Ray is not installed.
        CellError: if `function` raised.  It is raised last: no further cells are handed out, but
            those that are go to their end, and to `on_result`.

    >>> run_grid(abs, [-1, 2, -3], jobs=1)
    [1, 2, 3]
    """
    check_cluster(cluster)
    if jobs is not None and jobs < 1:
        raise ValueError(f"jobs must be at least 1, got {jobs}")
    cells = list(cells)
    if not cells:
        return []
    pending = deque(range(len(cells)))
    if cluster is not None:
        outcomes = _outcomes_on_ray(function, cells, pending, jobs, cluster)
    elif (processes := min(jobs or cpu_count(), len(cells))) > 1:
        outcomes = _outcomes_of_processes(function, cells, pending, processes)
    else:
        outcomes = _outcomes_here(function, cells, pending)
    results: dict[int, Value] = {}
    error: CellError | None = None
    with closing(outcomes):
        for index, outcome in outcomes:
            if isinstance(outcome, _Failure):
                pending.clear()
                error = error or outcome.of_cell(index, cells[index])
            else:
                results[index] = outcome.value
                if on_result is not None:
                    on_result(index, outcome.value)
    if error is not None:
        raise error
    return [results[index] for index in range(len(cells))]


@dataclass(frozen=True)
class _Success:
    value: Any


@dataclass(frozen=True)
class _Failure:
    error: BaseException  # an Exception, or SystemExit
    traceback: str = ""  # the worker's; tracebacks cannot be pickled

    def of_cell(self, index: int, cell: object) -> CellError:
        failed = CellError(index, cell, f"{type(self.error).__name__}: {self.error}")
        if self.traceback:
            self.error.__cause__ = _WorkerTraceback(f"\n{self.traceback}")
        failed.__cause__ = self.error
        return failed


class _WorkerTraceback(Exception):
    """The traceback of an error in another process, to be printed above it."""


# (index of a cell, what came of it), in the order in which cells finish.  Cells are taken from
# the left of `pending`, which the caller empties when no more shall begin.
_Outcomes: TypeAlias = "Generator[tuple[int, _Success | _Failure], None, None]"


def _outcomes_here(
    function: Callable[[Any], Any], cells: Sequence[Any], pending: deque[int]
) -> _Outcomes:
    with _one_thread_here():
        while pending:
            index = pending.popleft()
            yield index, _outcome(function, cells[index])


def _outcome(function: Callable[[Any], Any], cell: Any) -> _Success | _Failure:
    try:
        return _Success(function(cell))
    except Exception as error:
        return _Failure(error)


def _outcomes_of_processes(
    function: Callable[[Any], Any], cells: Sequence[Any], pending: deque[int], jobs: int
) -> _Outcomes:
    def calls() -> Iterator[Any]:  # one at a time is asked for, whenever a process is free
        with suppress(IndexError):  # in another thread than that which may empty `pending`
            while True:
                index = pending.popleft()
                yield delayed(_numbered_work)(index, _packed(function, cells[index]))

    with parallel_config(backend="loky", inner_max_num_threads=1):
        parallel = Parallel(jobs, return_as="generator_unordered", pre_dispatch=jobs, batch_size=1)
    packed = parallel(calls())
    try:
        for index, outcome in packed:
            yield index, _unpacked(outcome)
    except GeneratorExit:  # of the caller, who wants no more
        # loky (in joblib 1.6) kills its workers, and then its thread dies of a KeyError if it has
        # a call in hand that it has not yet passed on: let it have none.
        pending.clear()
        time.sleep(_HANDOVER_SECONDS)
        raise
    finally:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that cells under way are cancelled is what is meant
            packed.close()


def _numbered_work(index: int, packed: bytes) -> tuple[int, bytes]:
    return index, _work(packed)


def _work(packed: bytes) -> bytes:
    """In a worker: the packed outcome of a packed call, whatever goes wrong."""
    try:
        function, cell = pickle.loads(packed)
        set_torch_threads(1)
        return _dumps(_Success(function(cell)))
    except (Exception, SystemExit) as error:
        text = traceback.format_exc()
        try:
            failure = _dumps(_Failure(error, text))
            pickle.loads(failure)
            return failure
        except Exception:  # not every error survives
            return _dumps(_Failure(RuntimeError(f"{type(error).__name__}: {error}"), text))


def _packed(function: Callable[[Any], Any], cell: Any) -> bytes:
    # Bytes, because joblib and Ray hand large arrays over as read-only views of shared memory.
    try:
        return _dumps((function, cell))
    except Exception as error:  # to be raised in the worker, as what is wrong with a cell is
        return _dumps((_refuse, f"it cannot be pickled: {error}"))


def _refuse(reason: str) -> None:
    raise TypeError(reason)


def _dumps(content: object) -> bytes:
    # Unlike pickle's own, this takes functions of scripts and notebooks along.
    return cast(bytes, cloudpickle.dumps(content))


def _unpacked(outcome: bytes) -> _Success | _Failure:
    try:
        return cast("_Success | _Failure", pickle.loads(outcome))
    except Exception as error:
        return _Failure(error)


def _outcomes_on_ray(
    function: Callable[[Any], Any],
    cells: Sequence[Any],
    pending: deque[int],
    jobs: int | None,
    cluster: str,
) -> _Outcomes:
    import ray

    # Those that mean: not the cell's fault, or only perhaps.
    deaths = (
        *(ray.exceptions.WorkerCrashedError, ray.exceptions.NodeDiedError),
        *(ray.exceptions.ObjectLostError, ray.exceptions.OutOfMemoryError),
        *(ray.exceptions.LocalRayletDiedError,),
    )
    origin = _machine_and_sources()
    begun: Counter[int] = Counter()
    with _connection(ray, cluster, min(jobs or cpu_count(), len(cells))):
        # Ray's own retries are off: they do not cover a result that is lost between the end of
        # its cell and its way here, and two ways to do one thing cannot count attempts.
        work = ray.remote(num_cpus=1, max_retries=0)(_work_on_node)
        running: dict[Any, int] = {}
        try:
            while pending or running:
                room = jobs or _room(ray)
                while pending and len(running) < room:
                    index = pending.popleft()
                    begun[index] += 1
                    call = work.remote(origin, _packed(function, cells[index]))
                    running[call] = index
                ready, _ = ray.wait(list(running), timeout=_GROWTH_SECONDS)
                for call in ready:
                    index = running.pop(call)
                    try:
                        outcome = _unpacked(ray.get(call))
                    except deaths as error:
                        if begun[index] < ATTEMPTS:
                            pending.appendleft(index)
                            continue
                        outcome = _Failure(error)
                    except ray.exceptions.RayError as error:
                        outcome = _Failure(error)
                    yield index, outcome
        finally:
            for call in running:
                with suppress(Exception):  # whatever ended the grid is what is to be seen
                    ray.cancel(call, force=True)


def _room(ray: Any) -> int:
    """One cell more than the cluster has processors, so that one that can grow has reason to."""
    return int(ray.cluster_resources().get("CPU", 0)) + 1


@contextmanager
def _connection(ray: Any, cluster: str, processors: int) -> Iterator[None]:
    """Connected to a cluster, or to the one that the caller has connected to already."""
    if cluster == "ray" and ray.is_initialized():
        yield
        return
    address = cluster if cluster != "ray" else os.environ.get("RAY_ADDRESS") or "auto"
    quiet = {"log_to_driver": False, "logging_level": logging.ERROR}
    local = {
        "num_cpus": processors,
        "include_dashboard": False,
        "object_store_memory": _LOCAL_OBJECT_STORE,
    }
    try:
        ray.init(address, **quiet, **(local if address == "local" else {}))
    except ConnectionError:
        if address != "auto":
            raise
        ray.init("local", **quiet, **local)
    try:
        yield
    finally:
        ray.shutdown()  # ends a cluster only if it was begun here


def _work_on_node(origin: tuple[str, str], packed: bytes) -> bytes:
    machine, sources = _machine_and_sources()
    # One machine's sources differ from its own only where they are edited meanwhile.
    if machine != origin[0] and sources != origin[1]:
        reason = f"mmc_gym on node {machine} has other sources than on {origin[0]}"
        packed = _packed(_refuse, reason)
    return _work(packed)


@cache
def _machine_and_sources() -> tuple[str, str]:
    """Name, and digest of all in this package that results may depend on: code and numbers."""
    folder = Path(__file__).parent
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        if path.suffix in (".py", ".json", ".safetensors", ".yml"):
            digest.update(path.relative_to(folder).as_posix().encode())
            digest.update(hashlib.sha256(path.read_bytes()).digest())
    return socket.gethostname(), digest.hexdigest()


@contextmanager
def _one_thread_here() -> Iterator[None]:
    """Torch on one thread, as in a worker, whether it is loaded already or will be."""
    before = os.environ.get("OMP_NUM_THREADS")
    os.environ["OMP_NUM_THREADS"] = "1"
    try:
        with one_torch_thread():
            yield
    finally:
        if before is None:
            del os.environ["OMP_NUM_THREADS"]
        else:
            os.environ["OMP_NUM_THREADS"] = before
