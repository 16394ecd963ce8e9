"""Who does tasks: processes of this machine, an executor, or a Ray cluster. Outcomes come as they are done.

A worker that is lost takes nothing along: what it was doing is done again by another, up to `TRIES`
times, after which the task has an outcome that says so. What an executor does then is its own affair.
"""

from __future__ import annotations

import multiprocessing
import os
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from importlib import import_module
from typing import Any, Protocol

import numpy as np

from . import PalpateError
from ._files import File, brought
from ._palpate import cpus
from ._tasks import Outcome, Task, do

class Submits(Protocol):
    """An executor, if only by its one method, whose results have `done`, `result` and `cancel`."""

    def submit(self, call: Callable[..., Any], /, *arguments: Any) -> Any:
        """Has a call made by a worker."""


TRIES = 4

_LOST = f"its worker died {TRIES} times, for want of memory perhaps; see what the system's log says"

_LOOK_S = 2.0
"""How often it is looked whether waiting makes sense."""

_BEGIN_S = 300.0
"""How long the first process may take to start."""

_PATIENCE_S = 30.0
"""How long a cluster may take to get a node that is large enough."""


class _Clock:
    """Ends a wait in which no task ends."""

    def __init__(self, timeout: float | None) -> None:
        self._timeout = timeout
        self._since = time.monotonic()

    def done(self) -> None:
        """A task has ended."""
        self._since = time.monotonic()

    def look(self, under_way: int) -> None:
        """Raises TimeoutError if no task has ended for too long."""
        if self._timeout is not None and time.monotonic() - self._since > self._timeout:
            raise TimeoutError(
                f"none of the {under_way} tasks under way has ended within {self._timeout:g} s; what was "
                "done before is kept if `keep` names a folder. Give more time (`timeout`), or look at what "
                "the workers do"
            )


def processes(
    tasks: Mapping[str, Task], workers: int | None, timeout: float | None
) -> Iterator[tuple[str, Outcome]]:
    """In so many processes of this machine, as many as its CPUs allow if None; tasks by key."""
    threads = max((task.threads for task in tasks.values()), default=1)
    workers = workers or max(1, cpus() // threads)
    tries: Counter[str] = Counter()
    left = dict(tasks)
    while left:
        for key, outcome in _in_a_pool(left, min(workers, len(left)), tries, timeout):
            del left[key]
            yield key, outcome
        for key in [key for key in left if tries[key] >= TRIES]:
            del left[key]
            yield key, Outcome(None, _LOST)


def _in_a_pool(
    tasks: Mapping[str, Task], workers: int, tries: Counter[str], timeout: float | None
) -> Iterator[tuple[str, Outcome]]:
    """Until all is done or a process dies, which no pool survives; counts who was at work then."""
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"))
    running: dict[Any, str] = {}
    try:
        _check(pool)
        # As many at a time as there are workers: all of these are at work.
        yield from _each(pool, tasks, running, workers, timeout)
    except BrokenProcessPool:
        tries.update(running.values())
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        for process in set(multiprocessing.active_children()) - others:
            process.terminate()


def _check(pool: ProcessPoolExecutor) -> None:
    """Raises RuntimeError if processes die before they could do anything."""
    try:
        pool.submit(os.getpid).result(_BEGIN_S)
    except TimeoutError as error:
        raise TimeoutError(f"worker processes have not started within {_BEGIN_S:.0f} s") from error
    except BrokenProcessPool as error:
        raise RuntimeError(
            "worker processes die as they start, and print why; a script must call palpate.ray below "
            '`if __name__ == "__main__":`, as every worker imports it'
        ) from error


def in_executor(
    tasks: Mapping[str, Task], executor: Submits, timeout: float | None
) -> Iterator[tuple[str, Outcome]]:
    """By an executor's `submit`, whose workers see the files; tasks by key."""
    running: dict[Any, str] = {}
    try:
        yield from _each(executor, tasks, running, _QUEUED, timeout)
    except BrokenExecutor as error:
        raise RuntimeError(
            f"the executor can do nothing more ({error}); what was done before is kept if `keep` names a folder"
        ) from error
    finally:
        for future in running:
            future.cancel()


def _each(
    executor: Submits, tasks: Mapping[str, Task], running: dict[Any, str], most: int, timeout: float | None
) -> Iterator[tuple[str, Outcome]]:
    """Submits tasks, at most so many at a time, and gives out what is done. `running` has the others' keys."""
    clock, waiting = _Clock(timeout), iter(list(tasks.items()))
    while True:
        while len(running) < most and (following := next(waiting, None)) is not None:
            running[executor.submit(do, following[1])] = following[0]
        if not running:
            return
        for future in _ended(running):
            outcome = _outcome(future.result, BrokenExecutor)
            yield running.pop(future), outcome
            clock.done()
        clock.look(len(running))


def _ended(running: Mapping[Any, str]) -> list[Any]:
    """Those that have ended, after a while or as soon as there is one."""
    if all(isinstance(future, Future) for future in running):
        done = wait(running, _LOOK_S, FIRST_COMPLETED).done
        return [future for future in running if future in done]
    ended = [future for future in running if future.done()]  # such as jobs of submitit
    if not ended:
        time.sleep(_LOOK_S / 10)
    return ended


def _outcome(result: Callable[[], Outcome], raised: type[Exception] | tuple[()] = ()) -> Outcome:
    """What came of a task, if it was only that its worker could not do it; some errors are `raised`."""
    try:
        return result()
    except raised:
        raise
    except Exception as error:
        return Outcome(None, f"its worker could not do it: {type(error).__name__}: {error}")


def on_ray(
    tasks: Mapping[str, Task], address: str | None, timeout: float | None
) -> Iterator[tuple[str, Outcome]]:
    """On a Ray cluster: the one in use, that of `address`, or one started here; tasks by key.

    Files go there with the first task that reads them, and a worker that does not see them has copies of one
    log at a time.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        ray: Any = import_module("ray")
    except ImportError as error:
        raise ImportError("a Ray cluster needs Ray: pip install 'palpate[ray]'") from error

    started = not ray.is_initialized()
    if started:
        ray.init(address=address, log_to_driver=False)
    threads = max((task.threads for task in tasks.values()), default=1)
    # A worker has as many threads for good, so that each number gets workers of its own.
    environment = {"env_vars": {"RAYON_NUM_THREADS": str(threads)}}
    options = {"num_cpus": threads, "max_retries": TRIES - 1, "runtime_env": environment}
    remote = ray.remote(do_on_ray).options(**options)
    refs: dict[Any, str] = {}
    try:
        stored, clock, size = _Stored(ray, tasks), _Clock(timeout), _Size(ray, threads)
        waiting = iter(tasks.items())
        while True:
            most = max(_QUEUED, 2 * size.tasks())
            while len(refs) < most and (following := next(waiting, None)) is not None:
                key, task = following
                refs[remote.remote(task, stored.of(task))] = key
            if not refs:
                return
            ended, _ = ray.wait(list(refs), timeout=_LOOK_S)
            if ended:
                ended, _ = ray.wait(list(refs), num_returns=len(refs), timeout=0)
            for ref in ended:
                outcome = _ray_outcome(ray, ref)
                key = refs.pop(ref)
                stored.done(tasks[key])
                yield key, outcome
                clock.done()
            clock.look(len(refs))
    finally:
        for ref in refs if ray.is_initialized() else ():
            ray.cancel(ref, force=True)
        if started:
            ray.shutdown()


def do_on_ray(task: Task, files: list[tuple[File, Any]]) -> Outcome:
    """Does a task in a worker of Ray; `files` with where Ray has what is in them."""
    ray: Any = import_module("ray")

    def bring() -> str:
        each = [file for file, _ in files]
        contents = (content if content is None else ray.get(content) for _, content in files)
        return brought(each, lambda: contents)

    return do(task, bring)


def _ray_outcome(ray: Any, ref: Any) -> Outcome:
    """What came of a task that has ended on Ray."""
    names = ["WorkerCrashedError", "OutOfMemoryError", "NodeDiedError", "ObjectLostError"]
    lost = tuple(getattr(ray.exceptions, name) for name in names)
    try:
        return _outcome(lambda: ray.get(ref), lost)
    except lost:
        return Outcome(None, _LOST)


class _Stored:
    """What is in files, in Ray's object store as long as there are tasks that read them."""

    def __init__(self, ray: Any, tasks: Mapping[str, Task]) -> None:
        self._ray = ray
        self._left = Counter(task.files.digest for task in tasks.values())
        each = {task.files.digest: task.files.each for task in tasks.values()}
        self._users = Counter(file for files in each.values() for file in files)
        self._contents: dict[File, Any] = {}
        self._lists: dict[str, Any] = {}

    def of(self, task: Task) -> Any:
        """Where Ray has the list of a task's files, each with where it has what is in it, or None."""
        if task.files.digest not in self._lists:
            each = task.files.each
            sent = sum(file.size for file in each) <= _SENT_BYTES or _is_far(self._ray)
            files = [(file, self._content(file) if sent else None) for file in each]
            self._lists[task.files.digest] = self._ray.put(files)
        return self._lists[task.files.digest]

    def _content(self, file: File) -> Any:
        if file not in self._contents:
            self._contents[file] = self._put(file)
        return self._contents[file]

    def _put(self, file: File) -> Any:
        """Where Ray has what is in a file; None if it cannot have it, which matters only to who does not see it."""
        try:
            return self._ray.put(np.fromfile(file.path, dtype=np.uint8))
        except (OSError, MemoryError, self._ray.exceptions.RayError):
            return None

    def done(self, task: Task) -> None:
        """A task is done, and does not need its files any more."""
        self._left[task.files.digest] -= 1
        if not self._left[task.files.digest]:
            self._lists.pop(task.files.digest, None)
            for file in task.files.each:
                self._users[file] -= 1
                if not self._users[file]:
                    self._contents.pop(file, None)


_SENT_BYTES = 1 << 30
"""Files of a task that are sent in any case."""


def _is_far(ray: Any) -> bool:
    """Whether a cluster has several computers."""
    return len({node["NodeManagerHostname"] for node in ray.nodes() if node["Alive"]}) > 1


class _Size:
    """How much a cluster can do."""

    def __init__(self, ray: Any, threads: int) -> None:
        self._ray = ray
        self._threads = threads
        self._too_small_since: float | None = None

    def tasks(self) -> int:
        """Tasks that it can do at a time. Raises PalpateError if it could never do one."""
        nodes = [node for node in self._ray.nodes() if node["Alive"]]
        on_nodes = [int(node["Resources"].get("CPU", 0)) for node in nodes]
        tasks = sum(number // self._threads for number in on_nodes)
        if tasks:
            self._too_small_since = None
            return tasks
        now = time.monotonic()
        self._too_small_since = self._too_small_since or now
        if now - self._too_small_since > _PATIENCE_S:
            raise PalpateError(
                f"a task wants {self._threads} CPUs at a time, and the largest node of the cluster has "
                f"{max(on_nodes, default=0)}; ask for fewer `threads`, or start a larger node"
            )
        return 0


_QUEUED = 256
"""Tasks that a cluster has at a time at least, so that it never waits for the one who asks."""
