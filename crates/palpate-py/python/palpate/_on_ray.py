"""Does tasks on a Ray cluster, whose workers may have no access to the files that the tasks read."""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from importlib import import_module
from typing import Any

import numpy as np

from . import PalpateError, _workers
from ._files import File, brought
from ._tasks import Outcome, Task, do

_PATIENCE_S = 30.0
"""Largest time to wait for a node with enough CPUs, s."""


def outcomes(
    tasks: Mapping[str, Task], address: str | None, timeout: float | None
) -> Iterator[tuple[str, Outcome]]:
    """Does tasks, given by key, on a Ray cluster: the one in use, that of `address`, or one started here.

    Files are sent with the first task that reads them. A worker that does not see them keeps copies of one log at
    a time.
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
    # A worker cannot change its number of threads, so each number gets separate workers.
    environment = {"env_vars": {"RAYON_NUM_THREADS": str(threads)}}
    options = {"num_cpus": threads, "max_retries": _workers.TRIES - 1, "runtime_env": environment}
    remote = ray.remote(do_on_ray).options(**options)
    refs: dict[Any, str] = {}
    try:
        stored, clock, size = _Stored(ray, tasks), _workers.Clock(timeout), _Size(ray, threads)
        waiting = iter(tasks.items())
        while True:
            most = max(_workers.QUEUED, 2 * size.tasks())
            while len(refs) < most and (following := next(waiting, None)) is not None:
                key, task = following
                refs[remote.remote(task, stored.of(task))] = key
            if not refs:
                return
            ended, _ = ray.wait(list(refs), timeout=_workers.LOOK_S)
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
    """Does a task in a worker of Ray; `files` are pairs of a file and Ray's reference to its content, or None."""
    ray: Any = import_module("ray")

    def bring() -> str:
        each = [file for file, _ in files]
        contents = (content if content is None else ray.get(content) for _, content in files)
        return brought(each, lambda: contents)

    return do(task, bring)


def _ray_outcome(ray: Any, ref: Any) -> Outcome:
    """The outcome of a task that has ended on Ray."""
    names = ["WorkerCrashedError", "OutOfMemoryError", "NodeDiedError", "ObjectLostError"]
    lost = tuple(getattr(ray.exceptions, name) for name in names)
    try:
        return _workers.outcome_of(lambda: ray.get(ref), lost)
    except lost:
        return Outcome(None, _workers.LOST)


class _Stored:
    """Contents of files in Ray's object store, as long as there are tasks that read them."""

    def __init__(self, ray: Any, tasks: Mapping[str, Task]) -> None:
        self._ray = ray
        self._left = Counter(task.files.digest for task in tasks.values())
        each = {task.files.digest: task.files.each for task in tasks.values()}
        self._users = Counter(file for files in each.values() for file in files)
        self._contents: dict[File, Any] = {}
        self._lists: dict[str, Any] = {}

    def of(self, task: Task) -> Any:
        """Ray's reference to the list of a task's files, each with the reference to its content, or None."""
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
        """Ray's reference to the content of a file; None if it cannot be stored (workers may see the file itself)."""
        try:
            return self._ray.put(np.fromfile(file.path, dtype=np.uint8))
        except (OSError, MemoryError, self._ray.exceptions.RayError):
            return None

    def done(self, task: Task) -> None:
        """Records that a task is done and no longer needs its files."""
        self._left[task.files.digest] -= 1
        if not self._left[task.files.digest]:
            self._lists.pop(task.files.digest, None)
            for file in task.files.each:
                self._users[file] -= 1
                if not self._users[file]:
                    self._contents.pop(file, None)


_SENT_BYTES = 1 << 30
"""Total size up to which files of a task are always sent; larger ones only to a cluster of several computers."""


def _is_far(ray: Any) -> bool:
    """Whether a cluster has several computers."""
    return len({node["NodeManagerHostname"] for node in ray.nodes() if node["Alive"]}) > 1


class _Size:
    """Capacity of a cluster."""

    def __init__(self, ray: Any, threads: int) -> None:
        self._ray = ray
        self._threads = threads
        self._too_small_since: float | None = None

    def tasks(self) -> int:
        """Number of tasks at a time. Raises PalpateError if no node has had enough CPUs for `_PATIENCE_S`."""
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
