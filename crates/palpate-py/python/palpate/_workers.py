"""Who does tasks: processes of this machine, or a Ray cluster. Outcomes come as they are done.

A worker that is lost takes nothing along: what it was doing is done again by another, up to `TRIES`
times, after which the task has an outcome that says so.
"""

from __future__ import annotations

import multiprocessing
import os
from collections import Counter
from collections.abc import Iterator, Mapping
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from importlib import import_module
from typing import Any

from ._tasks import Outcome, Task, do

TRIES = 4

_LOST = f"its worker died {TRIES} times, for want of memory perhaps; see what the system's log says"


def processes(tasks: Mapping[str, Task], workers: int | None) -> Iterator[tuple[str, Outcome]]:
    """In so many processes of this machine, as many as its CPUs allow if None; tasks by key."""
    threads = max((task.threads for task in tasks.values()), default=1)
    workers = workers or max(1, _cpus() // threads)
    tries: Counter[str] = Counter()
    left = dict(tasks)
    while left:
        for key, outcome in _in_a_pool(left, min(workers, len(left)), tries):
            del left[key]
            yield key, outcome
        for key in [key for key in left if tries[key] >= TRIES]:
            del left[key]
            yield key, Outcome(None, _LOST)


def _in_a_pool(
    tasks: Mapping[str, Task], workers: int, tries: Counter[str]
) -> Iterator[tuple[str, Outcome]]:
    """Until all is done or a process dies, which no pool survives; counts who was at work then."""
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"))
    running: dict[Future[Outcome], str] = {}
    try:
        _check(pool)
        # As many at a time as there are workers: all of these are at work.
        waiting = iter(list(tasks.items()))
        while True:
            while len(running) < workers and (following := next(waiting, None)) is not None:
                running[pool.submit(do, following[1])] = following[0]
            if not running:
                return
            done = next(as_completed(running))
            yield running[done], done.result()
            del running[done]
    except BrokenProcessPool:
        tries.update(running.values())
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        for process in set(multiprocessing.active_children()) - others:
            process.terminate()


def _check(pool: ProcessPoolExecutor) -> None:
    """Raises RuntimeError if processes die before they could do anything."""
    try:
        pool.submit(os.getpid).result()
    except BrokenProcessPool as error:
        raise RuntimeError(
            "worker processes die as they start, and print why; a script must call palpate.ray below "
            '`if __name__ == "__main__":`, as every worker imports it'
        ) from error


def _cpus() -> int:
    """CPUs that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on every system
        return os.cpu_count() or 1


def on_ray(tasks: Mapping[str, Task], address: str | None) -> Iterator[tuple[str, Outcome]]:
    """On a Ray cluster: the one in use, that of `address`, or one started here; tasks by key."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        ray: Any = import_module("ray")
    except ImportError as error:
        raise ImportError("a Ray cluster needs Ray: pip install 'palpate[ray]'") from error

    started = not ray.is_initialized()
    if started:
        ray.init(address=address, log_to_driver=False)
    refs: dict[Any, str] = {}
    try:
        waiting = iter(tasks.items())
        while True:
            while len(refs) < _QUEUED and (following := next(waiting, None)) is not None:
                key, task = following
                remote = ray.remote(do).options(num_cpus=task.threads, max_retries=TRIES - 1)
                refs[remote.remote(task)] = key
            if not refs:
                return
            [ref], _ = ray.wait(list(refs))
            try:
                outcome = ray.get(ref)
            except _losses(ray):
                outcome = Outcome(None, _LOST)
            yield refs.pop(ref), outcome
    finally:
        for ref in refs:
            ray.cancel(ref, force=True)
        if started:
            ray.shutdown()


def _losses(ray: Any) -> tuple[type[Exception], ...]:
    """What Ray says when a task has been tried for the last time."""
    names = ["WorkerCrashedError", "OutOfMemoryError", "NodeDiedError", "ObjectLostError"]
    return tuple(getattr(ray.exceptions, name) for name in names)


_QUEUED = 256
"""Tasks that a cluster has at a time, so that it never waits for the one who asks."""
