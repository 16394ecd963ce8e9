"""A task on one log, which any process on any machine can do."""

from __future__ import annotations

import hashlib
import os
import platform
import threading
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Literal, TypeAlias

from . import Log, PalpateError, PalpateWarning, Robot, __version__, _palpate, evaluate, open_log, tune
from ._files import Files, digest

_RobotArgument: TypeAlias = str | dict[str, Any] | None
"""Name or URDF of a robot, or its settings."""


_CODE = hashlib.sha256(Path(_palpate.__file__).read_bytes()).hexdigest()[:32]


def build() -> str:
    """The platform for which palpate was compiled, and a digest of the binary."""
    return f"{platform.system()} {platform.machine()} {_CODE}"


@dataclass(frozen=True)
class Task:
    """`evaluate` or `tune` on one log with one choice of settings; for all folds or a share of them."""

    what: Literal["evaluate", "tune"]
    log: tuple[list[str], dict[str, Any] | None]
    """Absolute paths, and options of `open_log`, if any."""
    settings: dict[str, dict[str, Any]]
    robot: _RobotArgument
    options: dict[str, Any]
    """Keyword arguments of the function."""
    files: Files
    """Files of log and robot, as far as the calling process sees them."""
    threads: int
    version: str = __version__
    """A worker of another version refuses the task, since its results could differ."""
    build: str = field(default_factory=lambda: build())

    def key(self) -> str:
        """A digest of everything that the result depends on."""
        parts = {**vars(self), "files": self.files.digest}
        del parts["threads"]
        return digest(parts)

    def contacts(self) -> str:
        """A digest of everything that the contacts of the touches depend on: a worker reuses them for the next task."""
        sections = {name: keys for name, keys in self.settings.items() if name != "estimator"}
        return digest([self.files.digest, self.log, sections, self.robot])


class Maker:
    """Makes tasks with absolute paths; the files that they read are listed once."""

    def __init__(self, robot: Robot | str | None) -> None:
        self._robot: _RobotArgument = None
        if isinstance(robot, Robot):
            self._robot = _absolute(robot.__getnewargs_ex__()[1])
        elif robot is not None:
            self._robot = _absolute({"robot": robot})["robot"]
        self._of_robot: dict[str, list[str]] = {}
        self._files: dict[str, Files] = {}

    def task(
        self,
        what: Literal["evaluate", "tune"],
        log: str | Log,
        settings: dict[str, dict[str, Any]],
        threads: int,
    ) -> Task:
        """A task without keyword arguments."""
        options = None
        named: list[str] = []
        if isinstance(log, Log):
            opened: partial[Log] = log.__reduce__()[0]
            named, options = list(map(os.fspath, opened.args[0])), opened.keywords
        else:
            named = [log]
        paths = list(map(os.path.abspath, named))
        settings = {**settings, "robot": _absolute(settings.get("robot", {}))}
        files = self._seen(paths, settings["robot"])
        return Task(what, (paths, options), settings, self._robot, {}, files, threads)

    def _seen(self, paths: list[str], settings: dict[str, Any]) -> Files:
        robot = digest(settings)
        if robot not in self._of_robot:
            self._of_robot[robot] = _files_of_robot(self._robot, settings)
        all_paths = [*paths, *self._of_robot[robot]]
        key = digest(all_paths)
        if key not in self._files:
            self._files[key] = Files(all_paths)
        return self._files[key]


def _absolute(robot: Mapping[str, Any]) -> dict[str, Any]:
    """Settings of a robot, with absolute paths of existing files."""

    def of(path: str) -> str:
        return os.path.abspath(path) if os.path.exists(path) else path

    return _with_paths(robot, of)


def _with_paths(robot: Mapping[str, Any], of: Callable[[str], str]) -> dict[str, Any]:
    """Settings of a robot, with `of` applied to its paths."""
    given = [key for key in ("robot", "arm") if robot.get(key) is not None]
    changed: dict[str, Any] = {key: of(os.fspath(robot[key])) for key in given}
    if robot.get("package_path") is not None:
        changed["package_path"] = [of(os.fspath(path)) for path in robot["package_path"]]
    return {**robot, **changed}


def _files_of_robot(robot: _RobotArgument, settings: dict[str, Any]) -> list[str]:
    """The files of a robot, with the manifests (package.xml) by which its packages are found."""
    if not isinstance(robot, dict):
        robot = settings if robot is None else {**settings, "robot": robot}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", PalpateWarning)  # the worker reports it
            files = Robot(**robot).files
    except (PalpateError, ValueError, TypeError, OSError):
        return []  # the worker reports the error
    manifests = {above / "package.xml" for file in files for above in file.absolute().parents}
    return [os.path.abspath(file) for file in [*files, *sorted(manifests)]]


@dataclass(frozen=True)
class Outcome:
    """Outcome of a task."""

    result: dict[str, Any] | None
    error: str | None = None
    """Why there is no result."""
    seconds: float = 0.0
    """Computing time, s."""
    warnings: Sequence[str] = ()


_alone = threading.Lock()
"""One task at a time, since warnings are recorded for the whole process."""


def do(task: Task, bring: Callable[[], str] = str) -> Outcome:
    """Does a task, in a worker. `bring` returns the prefix of paths under which files are found on this machine."""
    with _alone:
        os.environ["RAYON_NUM_THREADS"] = str(task.threads)  # read at the first long call
        begun = time.perf_counter()
        result, error, before = None, None, ""
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", PalpateWarning)
            try:
                before = _brought(bring)
                result = _call(task, before)
            except (KeyboardInterrupt, SystemExit):
                raise
            except (PalpateError, ValueError, TypeError, OSError) as raised:
                error = str(raised)
            except MemoryError:
                error = "its worker has not enough memory for this task"
            except BaseException as raised:  # a panic of the compiled part is not an Exception
                error = f"a defect of palpate; report this line: {type(raised).__name__}: {raised}"
        messages = [str(one.message) for one in caught if issubclass(one.category, PalpateWarning)]
        if error is None and (threads := _palpate.threads()) != task.threads:
            messages.append(
                f"a worker works with {threads} threads, not {task.threads}: this number is fixed "
                "when its process starts"
            )
        if before:  # show the original paths
            error = None if error is None else error.replace(before, "")
            messages = [text.replace(before, "") for text in messages]
        return Outcome(result, error, time.perf_counter() - begun, messages)


def _brought(bring: Callable[[], str]) -> str:
    try:
        return bring()
    except (OSError, MemoryError):
        raise
    except Exception as error:  # an exception of Ray
        raise PalpateError(f"its worker could not get the files: {type(error).__name__}: {error}") from error


def _call(task: Task, before: str) -> dict[str, Any]:
    if task.version != __version__:
        raise PalpateError(
            f"a worker has palpate {__version__}, and was asked by palpate {task.version}; install the "
            "same version everywhere"
        )
    machine, here = (text.rpartition(" ")[0] for text in (task.build, build()))
    if machine == here and task.build != build():
        raise PalpateError(
            f"a worker has another build of palpate {__version__} than the one that asked; install the "
            "same wheel everywhere"
        )

    def moved(path: str) -> str:
        return before + path if os.path.isabs(path) else path

    (paths, options), robot = task.log, task.robot
    log: Any = list(map(moved, paths))
    if options is not None:
        log = open_log(log, **options)
    settings = {**task.settings, "robot": _with_paths(task.settings["robot"], moved)}
    arm: Robot | str | None = moved(robot) if isinstance(robot, str) else None
    if isinstance(robot, dict):
        arm = Robot(**_with_paths(robot, moved))
    keywords = {**task.options, "settings": settings, "progress": False}
    if task.what == "tune":
        return dict(tune(log, arm, **keywords))
    seen = Files(map(moved, paths)).digest  # the calling process may not see these files
    reuse = digest([before, task.files.digest, seen, task.log, task.robot])
    return dict(evaluate(log, arm, reuse=reuse, **keywords))
