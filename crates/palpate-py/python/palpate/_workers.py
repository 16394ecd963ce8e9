"""Who does tasks: processes of this machine, or an executor; `_on_ray` has Ray. Outcomes come as they are done.

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
from typing import Any, Protocol

from ._palpate import cpus
from ._tasks import Outcome, Task, do


class Submits(Protocol):
    """An executor, if only by its one method, whose results have `done`, `result` and `cancel`."""

    def submit(self, call: Callable[..., Any], /, *arguments: Any) -> Any:
        """Has a call made by a worker."""


TRIES = 4

LOST = f"its worker died {TRIES} times, for want of memory perhaps; see what the system's log says"

LOOK_S = 2.0
"""How often it is looked whether waiting makes sense."""

_BEGIN_S = 300.0
"""How long the first process may take to start."""

QUEUED = 256
"""Tasks that a cluster has at a time at least, so that it never waits for the one who asks."""


class Clock:
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
            yield key, Outcome(None, LOST)


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
        yield from _each(executor, tasks, running, QUEUED, timeout)
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
    """Those that have ended, after a while or as soon as there is one."""
    if all(isinstance(future, Future) for future in running):
        done = wait(running, LOOK_S, FIRST_COMPLETED).done
        return [future for future in running if future in done]
    ended = [future for future in running if future.done()]  # such as jobs of submitit
    if not ended:
        time.sleep(LOOK_S / 10)
    return ended


def outcome_of(result: Callable[[], Outcome], raised: type[Exception] | tuple[()] = ()) -> Outcome:
    """What came of a task, if it was only that its worker could not do it; some errors are `raised`."""
    try:
        return result()
    except raised:
        raise
    except Exception as error:
        return Outcome(None, f"its worker could not do it: {type(error).__name__}: {error}")
