"""Call one function on many cells, in processes of this machine (loky) or on a Ray cluster.

A cell is any argument that can be pickled.  Results come back to the calling process, and only that
process stores any, since the nodes of a cluster may share no file system.  Every worker computes on
one thread, so that results do not depend on the number of processors.  If a worker or a node dies,
its cells are computed again.
"""

from __future__ import annotations

import importlib.util
import logging
import os
import pickle
import platform
import re
import signal
import sys
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import cloudpickle
import loky

from mmc_gym._errors import UserError, missing, require, require_whole, shown
from mmc_gym._files import IMPORTED, digest_files, import_modules

CellT = TypeVar("CellT")
Value = TypeVar("Value")

ATTEMPTS = 5  # to compute a cell on Ray, whose node or worker may die
_ONE_THREAD = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
_GROWTH_SECONDS = 5.0  # after which we look whether the cluster has more nodes


class CellError(RuntimeError):
    """A cell of a grid failed; the error that the function raised is the `__cause__`."""

    def __init__(self, index: int, cell: object, error: BaseException) -> None:
        super().__init__(f"cell {index}, {shown(cell)}, failed: {type(error).__name__}: {error}")
        self.__cause__ = error


class WorkerDied(RuntimeError):
    """A process ended twice while it computed a cell: killed, or out of memory."""


def run_grid(
    function: Callable[[CellT], Value],
    cells: Iterable[CellT],
    *,
    jobs: int | None = None,
    cluster: str | None = None,
    on_result: Callable[[int, Value], None] | None = None,
    on_failure: Callable[[int, CellError], None] | None = None,
) -> list[Value]:
    """Call `function` on every cell, in parallel processes; return results in order of cells.

    Args:
        function: takes one cell.  It must be picklable, depend on its cell only, and have no side
            effects, since it is called again if a worker dies.
        cells: arguments, which must be picklable.
        jobs: number of cells computed at once; 1 computes in this process.  The default is the
            number of processors of this machine, or of the cluster.
        cluster: None for this machine; "ray" for the Ray cluster that `RAY_ADDRESS` names or this
            machine belongs to, or else a local one; "ray://HOST:PORT" for the cluster whose client
            server listens there.  A node with other sources of `mmc_gym` refuses work.
        on_result: called here with (index, result) as soon as a cell is finished.
        on_failure: called here with (index, error) for a cell whose worker dies twice; the grid
            continues, and the result is None.  If given, even a single cell is computed in another
            process, unless `jobs` is 1.  By default such a death ends the grid, as any error does.

    Raises:
        CellError: if `function` raised an error, or a worker died twice without `on_failure`.  The
            cells that have begun are first finished and given to `on_result`; no others begin.

    >>> run_grid(abs, [-1, 2, -3], jobs=1)
    [1, 2, 3]
    """
    check_workers(jobs, cluster)
    cells = list(cells)
    results: list[Any] = [None] * len(cells)
    failed: CellError | None = None

    def keep(index: int, value: Value) -> None:
        results[index] = value
        if on_result is not None:
            on_result(index, value)

    at_once = min(jobs or loky.cpu_count(), len(cells))
    if not cells or (cluster is None and at_once == 1 and (jobs == 1 or on_failure is None)):
        with one_torch_thread():
            for index, cell in enumerate(cells):
                try:
                    value = function(cell)
                except Exception as raised:
                    raise CellError(index, cell, raised) from raised
                keep(index, value)
        return results

    calls = [_packed(function, index, cell) for index, cell in enumerate(cells)]
    waiting, running = deque(range(len(cells))), dict[Any, int]()
    suspects = list[int]()  # cells under which a worker died; the first is computed alone
    workers = _Processes(at_once) if cluster is None else _Ray(cluster, jobs)
    try:
        while waiting or suspects or running:
            while (suspects or waiting) and len(running) < (1 if suspects else workers.room):
                index = suspects[0] if suspects else waiting.popleft()
                running[workers.submit(calls[index])] = index
            for call in workers.finished(running):
                index = running.pop(call)
                value, error = _outcome(workers, call)
                has_died = isinstance(error, WorkerDied)
                if has_died and index not in suspects:
                    suspects.append(index)
                    continue
                if index in suspects:
                    suspects.remove(index)
                if error is None:
                    keep(index, value)
                elif has_died and on_failure is not None:
                    on_failure(index, CellError(index, cells[index], error))
                else:
                    failed = failed or CellError(index, cells[index], error)
                    waiting.clear()
                    suspects.clear()
    finally:
        workers.close(running)
    if failed is not None:
        raise failed
    return results


def check_workers(jobs: int | None, cluster: str | None) -> None:
    """Raise a `UserError` unless `run_grid` accepts the arguments; do not connect to a cluster."""
    if jobs is not None:
        require_whole("jobs", jobs)
    if cluster is None:
        return
    is_known = isinstance(cluster, str) and re.fullmatch(r"ray|ray://.+:\d+", cluster) is not None
    require(is_known, "cluster", cluster, "'ray' or 'ray://HOST:PORT'")
    if importlib.util.find_spec("ray") is None:
        raise missing(f"cluster {cluster!r}", "Ray", "cluster")


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Keep torch on one thread, if it is loaded.

    Small networks are faster on one thread, and give the same numbers on any number of cores.
    """
    torch: Any = sys.modules.get("torch")
    if torch is None:
        yield
        return
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


class _Processes:
    """Worker processes on this machine; they end when this process does, even if it is killed."""

    def __init__(self, count: int) -> None:
        self.room = count  # most calls that may run at once
        self._executor = self._start()

    def _start(self) -> Any:
        return loky.ProcessPoolExecutor(
            self.room, env=_ONE_THREAD, initializer=_end_with, initargs=(os.getpid(),)
        )

    def submit(self, packed: bytes) -> Any:
        mask = getattr(signal, "pthread_sigmask", lambda *_: ())  # Windows has none
        before = mask(signal.SIG_BLOCK, {signal.SIGINT})  # of workers that start: we end them
        try:
            with suppress(BrokenProcessPool):
                return self._executor.submit(_run_packed, packed)
            self._executor = self._start()
            return self._executor.submit(_run_packed, packed)
        finally:
            mask(signal.SIG_SETMASK, before)

    def finished(self, calls: Collection[Any]) -> Collection[Any]:
        return wait(calls, return_when=FIRST_COMPLETED).done

    def result(self, call: Any) -> Any:
        """Return the result of a finished call; raise whatever ended its worker."""
        return call.result()

    def close(self, calls: Collection[Any]) -> None:
        self._executor.shutdown(wait=True, kill_workers=True)


def _end_with(parent: int) -> None:
    """End this worker when its parent process has ended, even if that was killed."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    if os.name == "posix":
        threading.Thread(target=watch, daemon=True).start()


class _Ray:
    """A Ray cluster, with the methods of `_Processes`; it repeats calls that die with a node."""

    def __init__(self, cluster: str, jobs: int | None) -> None:
        """Connect to `cluster`, see `run_grid`; "ray" keeps the caller's connection, if any."""
        import ray

        self._ray: Any = ray
        self._jobs = jobs
        self._connects = cluster != "ray" or not ray.is_initialized()
        if self._connects:
            address = None if cluster == "ray" else cluster  # None: Ray looks for one itself
            ray.init(address, log_to_driver=False, logging_level=logging.ERROR)
        self._remote = self._ray.remote(num_cpus=1, max_retries=ATTEMPTS - 1)(_run_packed)

    @property
    def room(self) -> int:
        # One call more than there are processors, so that a cluster that can grow does.
        return self._jobs or int(self._ray.cluster_resources().get("CPU", 0)) + 1

    def submit(self, packed: bytes) -> Any:
        return self._remote.remote(packed, _sources())

    def finished(self, calls: Collection[Any]) -> Collection[Any]:
        ready: Collection[Any] = self._ray.wait(list(calls), timeout=_GROWTH_SECONDS)[0]
        return ready

    def result(self, call: Any) -> Any:
        return self._ray.get(call)

    def close(self, calls: Collection[Any]) -> None:
        for call in calls:
            with suppress(Exception):  # the error that ended the grid is the one to show
                self._ray.cancel(call, force=True)
        if self._connects:
            self._ray.shutdown()  # ends a cluster only if it was begun here


def _packed(function: Callable[[Any], Any], index: int, cell: object) -> bytes:
    """Pickle a call, even if its function is defined in a script or notebook.

    Ray gets bytes because arrays that it hands over are read-only views of shared memory.
    """
    try:
        call = cloudpickle.dumps((function, cell))
        return pickle.dumps(([*IMPORTED], call))
    except Exception as error:
        raise CellError(index, cell, TypeError(f"it cannot be pickled: {error}")) from error


def _run_packed(packed: bytes, sources: str | None = None) -> bytes:
    """Run a packed call in a worker.

    `sources` is the caller's `_sources()`, which the worker's must equal; None skips this check.
    Return the pickled pair (value, None) or (None, error).
    """
    try:
        if sources not in (None, _sources()):
            raise RuntimeError(f"node {platform.node()} must have the caller's sources of mmc_gym")
        modules, call = pickle.loads(packed)
        with suppress(UserError):  # a node of a cluster may do without them
            import_modules(modules)
        function, cell = pickle.loads(call)
        with one_torch_thread():
            return bytes(cloudpickle.dumps((function(cell), None)))
    except (Exception, SystemExit) as error:
        error.add_note(f"in a worker:\n{traceback.format_exc()}")  # tracebacks cannot be pickled
        try:
            failure = bytes(cloudpickle.dumps((None, error)))
            pickle.loads(failure)
            return failure
        except Exception:  # not every error can be pickled and read again
            return pickle.dumps((None, RuntimeError(f"{type(error).__name__}: {error}")))


def _outcome(workers: _Processes | _Ray, call: Any) -> tuple[Any, BaseException | None]:
    """Return (value, None) of a finished call, or (None, error)."""
    try:
        packed = workers.result(call)
    except Exception as error:  # the worker died: an error of the function is in the result
        return None, WorkerDied(f"its process died, twice ({type(error).__name__})")
    value, failure = pickle.loads(packed)
    return value, failure


@cache
def _sources() -> str:
    """Return the SHA-256 of all files of this package that results depend on."""
    kinds = ("**/*.py", "**/*.json", "**/*.safetensors", "**/*.yml")
    return digest_files(Path(__file__).parent, *kinds)
