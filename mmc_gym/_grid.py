"""Compute one function of many cells, in processes of this machine or on a Ray cluster.

A cell is whatever the function takes, a result whatever it returns.  Both travel pickled, and only
the process that asked for the grid keeps anything: the nodes of a cluster may share no file system.
Every worker computes on one thread, so that results do not depend on the number of processors.
The death of a worker or a node costs time, nothing else.
"""

from __future__ import annotations

import hashlib
import importlib.util
import logging
import os
import pickle
import socket
import sys
import threading
import time
import traceback
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import cloudpickle
import loky
from typing_extensions import override

from mmc_gym._errors import UserError, missing, require, require_whole

Cell = TypeVar("Cell")
Value = TypeVar("Value")

ATTEMPTS = 5  # that a cell has on Ray: four nodes or workers may die under it
_ONE_THREAD = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
_LOCAL_OBJECT_STORE = 256 * 2**20  # bytes; larger results overflow to the disk
_GROWTH_SECONDS = 5.0  # after which a cluster may have got more nodes
_LONGEST_REPR = 200


class CellError(RuntimeError):
    """A cell of a grid failed; the error that the function raised is the `__cause__`.

    Attributes:
        index: number of the cell.
        cell: the cell itself.
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


class WorkerDied(RuntimeError):
    """A process ended again and again while it computed a cell: killed, or out of memory."""


def run_grid(
    function: Callable[[Cell], Value],
    cells: Iterable[Cell],
    *,
    jobs: int | None = None,
    cluster: str | None = None,
    on_result: Callable[[int, Value], None] | None = None,
    on_failure: Callable[[int, CellError], None] | None = None,
) -> list[Value]:
    """Compute `function` of every cell, in many processes at once.

    Args:
        function: takes one cell.  It can be pickled, depends on nothing but its cell, and leaves
            nothing behind but its result: where a worker dies its cell is computed again.
        cells: arguments, which can be pickled.
        jobs: how many cells are computed at once; 1 computes in this process.  By default as many
            as this machine, or the cluster, has processors.
        cluster: None for this machine; "ray" for the Ray cluster that `RAY_ADDRESS` names or this
            machine belongs to, or a local one if there is none; "ray://HOST:PORT" for the one
            whose client server listens there.  Every node needs the same sources of `mmc_gym` as
            this machine, and refuses work if it has others.
        on_result: is called here with (index, result) as soon as a cell is finished.
        on_failure: is called here with (index, error) for a cell whose worker dies each time, and
            the grid goes on without it; so even a single cell gets a process of its own, unless
            `jobs` is 1.  By default a worker's death ends the grid as any error does.

    Returns:
        The results in the order of the cells; None for those that `on_failure` took.

    Raises:
        UserError: if `jobs` or `cluster` is none of those, or Ray is not installed.
        CellError: if `function` raised.  It is raised last: no further cells begin, but those that
            have begun are finished and handed to `on_result`.

    >>> run_grid(abs, [-1, 2, -3], jobs=1)
    [1, 2, 3]
    """
    check_workers(jobs, cluster)
    cells = list(cells)
    results: list[Any] = [None] * len(cells)
    pending, suspects = deque(range(len(cells))), deque[int]()
    running: dict[Any, int] = {}
    alone: int | None = None  # the cell that is computed by itself, since its worker died before
    error: CellError | None = None
    has_own_process = on_failure is not None and jobs != 1
    with _workers(jobs, cluster, len(cells), has_own_process) as workers:
        while pending or suspects or running:
            while pending and not suspects and alone is None and len(running) < workers.room():
                index = pending.popleft()
                running[workers.submit(function, cells[index])] = index
            if suspects and not running:
                alone = suspects.popleft()
                running[workers.submit(function, cells[alone])] = alone
            for call in workers.finished(running):
                index = running.pop(call)
                outcome = workers.outcome(call)
                if outcome is None and index != alone:
                    suspects.append(index)  # it, or one of those beside it, ended its worker
                    continue
                if isinstance(outcome, _Success):
                    results[index] = outcome.value
                    if on_result is not None:
                        on_result(index, outcome.value)
                else:
                    failure = outcome or _Failure(WorkerDied("its process died, twice"))
                    found = failure.of_cell(index, cells[index])
                    if isinstance(failure.error, WorkerDied) and on_failure is not None:
                        on_failure(index, found)
                    else:
                        error = error or found
                        pending.clear()
                        suspects.clear()
                alone = None if index == alone else alone
    if error is not None:
        raise error
    return results


def check_workers(jobs: int | None, cluster: str | None) -> None:
    """Raise a `UserError` unless `run_grid` takes these, as far as this machine knows."""
    if jobs is not None:
        require_whole("jobs", jobs)
    if cluster is None:
        return
    require(isinstance(cluster, str), "cluster", cluster, "'ray' or 'ray://HOST:PORT'")
    host, _, port = cluster.removeprefix("ray://").rpartition(":")
    if cluster != "ray" and not (cluster.startswith("ray://") and host and port.isdecimal()):
        raise UserError(f"cluster must be 'ray' or 'ray://HOST:PORT', got {cluster!r}")
    if importlib.util.find_spec("ray") is None:
        raise missing(f"cluster {cluster!r}", "Ray", "cluster")


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Keep torch on one thread: small networks run faster so, and alike on any number of cores."""
    threads = _set_torch_threads(1)
    try:
        yield
    finally:
        if threads is not None:
            _set_torch_threads(threads)


def _set_torch_threads(threads: int) -> int | None:
    """Set the number of torch's threads, if it is loaded, and return what it was."""
    torch: Any = sys.modules.get("torch")
    if torch is None:
        return None
    before: int = torch.get_num_threads()
    torch.set_num_threads(threads)
    return before


@dataclass(frozen=True, eq=False)
class _Success:
    value: Any


@dataclass(frozen=True, eq=False)
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


class _Workers(ABC):
    """Something that computes a function of cells, several at once."""

    @abstractmethod
    def room(self) -> int:
        """Return how many calls may be under way."""

    @abstractmethod
    def submit(self, function: Callable[[Any], Any], cell: Any) -> Any:
        """Begin a call, and return a handle of it."""

    @abstractmethod
    def finished(self, calls: Collection[Any]) -> Collection[Any]:
        """Wait for calls, and return those that are finished."""

    @abstractmethod
    def outcome(self, call: Any) -> _Success | _Failure | None:
        """Return what came of a finished call; None if its worker died."""


@contextmanager
def _workers(
    jobs: int | None, cluster: str | None, cells: int, has_own_process: bool
) -> Iterator[_Workers]:
    at_once = min(jobs or loky.cpu_count(), cells)
    if cluster is not None and cells:
        with _ray_connection(cluster, at_once) as ray:
            workers = _Ray(ray, jobs)
            try:
                yield workers
            finally:
                workers.cancel()
    elif at_once > 1 or (cells and has_own_process):
        processes = _Processes(at_once)
        try:
            yield processes
        finally:
            processes.end()
    else:
        with _one_thread_here():
            yield _Here()


class _Here(_Workers):
    """This process."""

    @override
    def room(self) -> int:
        return 1

    @override
    def submit(self, function: Callable[[Any], Any], cell: Any) -> Any:
        try:
            return _Success(function(cell))
        except Exception as error:
            return _Failure(error)

    @override
    def finished(self, calls: Collection[Any]) -> Collection[Any]:
        return tuple(calls)

    @override
    def outcome(self, call: Any) -> _Success | _Failure | None:
        return cast("_Success | _Failure", call)


class _Processes(_Workers):
    """Processes of this machine, which end when this one does, however it ends."""

    def __init__(self, processes: int) -> None:
        self._count = processes
        self._executor = self._start()

    def _start(self) -> Any:
        return loky.ProcessPoolExecutor(
            self._count, env=_ONE_THREAD, initializer=_end_with, initargs=(os.getpid(),)
        )

    @override
    def room(self) -> int:
        return self._count

    @override
    def submit(self, function: Callable[[Any], Any], cell: Any) -> Any:
        packed = _packed(function, cell)
        try:
            return self._executor.submit(_work, packed)
        except BrokenProcessPool:
            self._executor = self._start()
            return self._executor.submit(_work, packed)

    @override
    def finished(self, calls: Collection[Any]) -> Collection[Any]:
        return wait(calls, return_when=FIRST_COMPLETED).done

    @override
    def outcome(self, call: Future[bytes]) -> _Success | _Failure | None:
        try:
            return _unpacked(call.result())
        except BrokenProcessPool:
            return None

    def end(self) -> None:
        self._executor.shutdown(wait=True, kill_workers=True)


def _end_with(parent: int) -> None:
    """In a worker: watch the parent process, and end when it is gone, even if it was killed."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    if os.name == "posix":
        threading.Thread(target=watch, daemon=True).start()


class _Ray(_Workers):
    """A Ray cluster.  It begins calls again by itself where a node or a worker dies."""

    def __init__(self, ray: Any, jobs: int | None) -> None:
        self._ray, self._jobs = ray, jobs
        self._origin = _machine_and_sources()
        # Ray also makes a result anew that was lost with its node.
        self._work = ray.remote(num_cpus=1, max_retries=ATTEMPTS - 1)(_work_on_node)
        self._calls: set[Any] = set()

    @override
    def room(self) -> int:
        # One cell more than there are processors, so that a cluster that can grow has reason to.
        return self._jobs or int(self._ray.cluster_resources().get("CPU", 0)) + 1

    @override
    def submit(self, function: Callable[[Any], Any], cell: Any) -> Any:
        call = self._work.remote(self._origin, _packed(function, cell))
        self._calls.add(call)
        return call

    @override
    def finished(self, calls: Collection[Any]) -> Collection[Any]:
        ready: Collection[Any] = self._ray.wait(list(calls), timeout=_GROWTH_SECONDS)[0]
        return ready

    @override
    def outcome(self, call: Any) -> _Success | _Failure | None:
        self._calls.discard(call)
        try:
            return _unpacked(self._ray.get(call))
        except self._ray.exceptions.RayError as error:
            # A call that raises is an outcome; so here a worker or its node died once too often.
            return _Failure(WorkerDied(f"{type(error).__name__}: {error}"))

    def cancel(self) -> None:
        for call in self._calls:
            with suppress(Exception):  # whatever ended the grid is what is to be seen
                self._ray.cancel(call, force=True)


@contextmanager
def _ray_connection(cluster: str, processors: int) -> Iterator[Any]:
    """Connect to a cluster, or use the one that the caller has connected to already."""
    import ray

    if cluster == "ray" and ray.is_initialized():
        yield ray
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
        yield ray
    finally:
        ray.shutdown()  # ends a cluster only if it was begun here


def _packed(function: Callable[[Any], Any], cell: Any) -> bytes:
    # Bytes, because Ray hands large arrays over as read-only views of shared memory.
    try:
        return _dumps((function, cell))
    except Exception as error:  # to be raised in the worker, as what is wrong with a cell is
        return _dumps((_refuse, f"it cannot be pickled: {error}"))


def _refuse(reason: str) -> None:
    raise TypeError(reason)


def _dumps(content: object) -> bytes:
    # Unlike pickle's own, this takes functions of scripts and notebooks along.
    return cast(bytes, cloudpickle.dumps(content))


def _work(packed: bytes) -> bytes:
    """In a worker: return the packed outcome of a packed call, whatever goes wrong."""
    try:
        function, cell = pickle.loads(packed)
        _set_torch_threads(1)
        return _dumps(_Success(function(cell)))
    except (Exception, SystemExit) as error:
        text = traceback.format_exc()
        try:
            failure = _dumps(_Failure(error, text))
            pickle.loads(failure)
            return failure
        except Exception:  # not every error survives
            return _dumps(_Failure(RuntimeError(f"{type(error).__name__}: {error}"), text))


def _unpacked(outcome: bytes) -> _Success | _Failure:
    try:
        return cast("_Success | _Failure", pickle.loads(outcome))
    except Exception as error:
        return _Failure(error)


def _work_on_node(origin: tuple[str, str], packed: bytes) -> bytes:
    machine, sources = _machine_and_sources()
    # One machine's sources differ from its own only where they are edited meanwhile.
    if machine != origin[0] and sources != origin[1]:
        reason = f"mmc_gym on node {machine} has other sources than on {origin[0]}"
        packed = _packed(_refuse, reason)
    return _work(packed)


@cache
def _machine_and_sources() -> tuple[str, str]:
    """Return this machine's name, and a digest of all in this package that results depend on."""
    folder = Path(__file__).parent
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        if path.suffix in (".py", ".json", ".safetensors", ".yml"):
            digest.update(path.relative_to(folder).as_posix().encode())
            digest.update(hashlib.sha256(path.read_bytes()).digest())
    return socket.gethostname(), digest.hexdigest()


@contextmanager
def _one_thread_here() -> Iterator[None]:
    """Keep torch on one thread, as in a worker, whether it is loaded already or will be."""
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
