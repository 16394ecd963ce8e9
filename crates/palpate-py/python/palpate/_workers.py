"""Does tasks in processes of this machine or by an executor (`_on_ray`: on Ray). Outcomes come as they are done.

If a worker dies, its task is done again by another one, up to `TRIES` times; then the outcome is an error.
Executors handle this themselves.
"""

from __future__ import annotations

import multiprocessing
import os
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Any, Protocol

from ._palpate import cpus
from ._tasks import Outcome, Task, do


class Submits(Protocol):
    """An executor: any object with this method, which returns futures with `done`, `result` and `cancel`."""

    def submit(self, call: Callable[..., Any], /, *arguments: Any) -> Any:
        """Lets a worker make a call."""


TRIES = 4

LOST = f"its worker died {TRIES} times, perhaps because memory ran out; see the log of the system"

LOOK_S = 2.0
"""Interval at which time-out and size of the cluster are checked, s."""

_BEGIN_S = 300.0
"""Largest time for the first process to start, s."""

QUEUED = 256
"""Number of tasks submitted at a time, on Ray the smallest, so that workers never wait for new tasks."""


class Clock:
    """Time-out of a wait in which no task ends."""

    def __init__(self, timeout: float | None) -> None:
        self._timeout = timeout
        self._since = time.monotonic()

    def done(self) -> None:
        """Records that a task has ended."""
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
    """Does tasks, given by key, in processes of this machine; as many as its CPUs allow if `workers` is None."""
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
            yield key, Outcome(None, LOST)


def _in_a_pool(
    tasks: Mapping[str, Task], workers: int, tries: Counter[str], timeout: float | None
) -> Iterator[tuple[str, Outcome]]:
    """Does tasks until all are done or a process dies, which ends the pool; `tries` counts the tasks under way then."""
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"))
    running: dict[Any, str] = {}
    try:
        _check(pool)
        # Submits no more tasks than there are workers, so that all submitted tasks are under way.
        yield from _each(pool, tasks, running, workers, timeout)
    except BrokenProcessPool:
        tries.update(running.values())
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        for process in set(multiprocessing.active_children()) - others:
            process.terminate()


def _check(pool: ProcessPoolExecutor) -> None:
    """Raises RuntimeError if processes die at their start."""
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
    """Does tasks, given by key, with an executor, whose workers see the files."""
    running: dict[Any, str] = {}
    try:
        yield from _each(executor, tasks, running, QUEUED, timeout)
    except BrokenExecutor as error:
        raise RuntimeError(
            f"the executor is broken and takes no more tasks ({error}); what was done before is kept if `keep` names "
            "a folder"
        ) from error
    finally:
        for future in running:
            future.cancel()


def _each(
    executor: Submits, tasks: Mapping[str, Task], running: dict[Any, str], most: int, timeout: float | None
) -> Iterator[tuple[str, Outcome]]:
    """Submits tasks, at most `most` at a time, and yields their outcomes. `running`: keys of the submitted tasks."""
    clock, waiting = Clock(timeout), iter(list(tasks.items()))
    while True:
        while len(running) < most and (following := next(waiting, None)) is not None:
            running[executor.submit(do, following[1])] = following[0]
        if not running:
            return
        for future in _ended(running):
            outcome = outcome_of(future.result, BrokenExecutor)
            yield running.pop(future), outcome
            clock.done()
        clock.look(len(running))


def _ended(running: Mapping[Any, str]) -> list[Any]:
    """The futures that have ended; waits a while if there is none."""
    if all(isinstance(future, Future) for future in running):
        done = wait(running, LOOK_S, FIRST_COMPLETED).done
        return [future for future in running if future in done]
    ended = [future for future in running if future.done()]  # for example jobs of submitit
    if not ended:
        time.sleep(LOOK_S / 10)
    return ended


def outcome_of(result: Callable[[], Outcome], raised: type[Exception] | tuple[()] = ()) -> Outcome:
    """The outcome of a task; an error of its worker becomes an outcome with an error, except those in `raised`."""
    try:
        return result()
    except raised:
        raise
    except Exception as error:
        return Outcome(None, f"its worker could not run it: {type(error).__name__}: {error}")
