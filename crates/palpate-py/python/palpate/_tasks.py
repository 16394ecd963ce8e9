"""One piece of work on one log, which any process on any machine can do."""

from __future__ import annotations

import hashlib
import json
import os
import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Literal

from . import Log, PalpateError, PalpateWarning, Robot, __version__, evaluate, tune


@dataclass(frozen=True)
class Task:
    """`evaluate` or `tune` on one log with one choice of settings; of folds, all or a share."""

    what: Literal["evaluate", "tune"]
    log: str | Log
    settings: dict[str, dict[str, Any]]
    robot: Robot | str | None
    options: dict[str, Any]
    """Keywords of the function."""
    files: str
    """Digest of the files of log and robot, as far as whoever asks sees them."""
    threads: int
    folder: str = field(default_factory=os.getcwd)
    """What relative paths start from."""
    version: str = __version__
    """Workers of another version would find other numbers."""

    def key(self) -> str:
        """A digest of all that the result depends on."""
        parts = {**vars(self), "log": _made_from(self.log), "robot": _made_from(self.robot)}
        del parts["threads"], parts["folder"]
        return _digest(parts)


@dataclass(frozen=True)
class Outcome:
    """What came of a task."""

    result: dict[str, Any] | None
    error: str | None = None
    """Why there is no result."""
    seconds: float = 0.0
    """By the worker's clock."""
    warnings: Sequence[str] = ()


def do(task: Task) -> Outcome:
    """Does a task; runs in a worker."""
    os.environ.setdefault("RAYON_NUM_THREADS", str(task.threads))  # read at the first long call
    if os.path.isdir(task.folder):
        os.chdir(task.folder)
    begun = time.perf_counter()
    result, error = None, None
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", PalpateWarning)
        try:
            result = _call(task)
        except (PalpateError, ValueError, TypeError, OSError) as raised:
            error = str(raised)
    told = [str(one.message) for one in caught if issubclass(one.category, PalpateWarning)]
    return Outcome(result, error, time.perf_counter() - begun, told)


def _call(task: Task) -> dict[str, Any]:
    if task.version != __version__:
        raise PalpateError(
            f"a worker has palpate {__version__}, and was asked by palpate {task.version}; install the "
            "same version everywhere"
        )
    call: Any = evaluate if task.what == "evaluate" else tune
    return dict(call(task.log, task.robot, settings=task.settings, progress=False, **task.options))


def files(*things: Log | Robot | str | None) -> str:
    """A digest of names, sizes and times of change of all files that some things are made from."""
    return _digest([list(_files(_made_from(thing))) for thing in things])


def _digest(plain: Any) -> str:
    return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()[:32]


def _made_from(thing: Log | Robot | str | None) -> Any:
    """What a thing was made from, as plain data."""
    if isinstance(thing, Log):
        made: partial[Log] = thing.__reduce__()[0]
        return [*made.args, made.keywords]
    if isinstance(thing, Robot):
        return thing.__getnewargs_ex__()[1]
    return thing


def _files(plain: Any) -> Iterator[tuple[str, int, int]]:
    """Name, size and time of change of every file that plain data names."""
    if isinstance(plain, dict):
        plain = list(plain.values())
    if isinstance(plain, (list, tuple)):
        for part in plain:
            yield from _files(part)
    elif isinstance(plain, str) and Path(plain).exists():
        path = Path(plain)
        for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
            if file.is_file():
                about = file.stat()
                yield str(file), about.st_size, about.st_mtime_ns
