"""`evaluate` and `tune` for many logs and settings, in local processes, on a Ray cluster or by an executor.

Results are returned as they are finished. With `keep`, finished work is saved and not repeated after an
interruption. An error ends only its own run. The task of a local process or Ray worker that dies is done again by
another one; executors have their own rules.

    import palpate.ray

    logs = {"plant_a": "data/plant_a", "plant_b": "data/plant_b"}
    settings = {"soft": {"estimator": {"prior_std": 0.4}}, "stiff": {"estimator": {"prior_std": 1.5}}}
    if __name__ == "__main__":
        for run in palpate.ray.evaluate(logs, settings, methods=["map"], keep="results"):
            print(run.log, run.settings, run.get()["methods"][0]["avg_relative"])
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Generic, Literal, TypeAlias, TypeVar, cast

from . import Log, PalpateError, PalpateWarning, Robot, _on_ray, _progress, _workers, default_settings
from ._joined import joined
from ._kept import Kept
from ._palpate import given_settings
from ._progress import Progress
from ._tasks import Maker, Outcome, Task
from ._workers import Submits
from .results import Evaluation, Tuned
from .settings import AnySettings
from .settings import Path as _Path

__all__ = ["Run", "evaluate", "tune"]

Result = TypeVar("Result")

_Logs: TypeAlias = Mapping[str, _Path | Log] | Sequence[_Path | Log]
_Settings: TypeAlias = Mapping[str, AnySettings] | Sequence[AnySettings] | None


@dataclass(frozen=True, eq=False)
class Run(Generic[Result]):
    """Result for one log with one choice of settings."""

    log: str
    """Name of the log."""
    settings: str
    """Name of the settings; their number if they were given in a list."""
    result: Result | None
    """Result of `palpate.evaluate` or `palpate.tune`; None after an error."""
    error: str | None
    """Why there is no result; other runs are not affected."""
    seconds: float
    """Computing time of the result, also if it was kept from an earlier call, s."""

    def get(self) -> Result:
        """The result. Raises PalpateError if there is none."""
        if self.result is None:
            raise PalpateError(f"{self.log}, settings {self.settings}: {self.error}")
        return self.result


def evaluate(
    logs: _Logs,
    settings: _Settings = None,
    robot: Robot | _Path | None = None,
    *,
    methods: Sequence[str] | None = None,
    folds: int | None = None,
    test: Sequence[str] | None = None,
    truth: bool = False,
    tune: bool | Literal["quick"] | None = None,
    shares: int = 1,
    keep: _Path | None = None,
    cluster: str | bool | Submits | None = None,
    workers: int | None = None,
    threads: int = 1,
    timeout: float | None = None,
    progress: Progress = None,
) -> Iterator[Run[Evaluation]]:
    """Evaluates every log with every choice of settings, as `palpate.evaluate` does for one.

    `logs` are one log for each object, and `settings` one dict of sections or TOML file for each choice;
    both by name or in a list. The folds of each run are divided into `shares` tasks; choose more for few
    long logs. `keep` is a folder for finished work, which may also contain that of other calls.

    `cluster` is the address of a Ray cluster, True for the one that Ray is connected to or starts,
    False for `workers` processes of this machine; None takes Ray if it is connected or RAY_ADDRESS
    is set. It may also be an executor, such as those of Dask and submitit: any object with `submit`.
    Files of logs and robots are sent to Ray's workers; workers of an executor must see them at the same
    paths. A task uses `threads` threads. Results do not depend on where or in how many processes they
    are computed.

    Yields runs as they are finished. Raises SettingsError and ValueError at once for invalid arguments,
    TimeoutError if no task ends within `timeout` seconds, and PalpateError if the cluster has no node
    with `threads` CPUs; defects of a log are the `error` of its run.
    """
    if shares < 1 or (test is not None and shares > 1):
        raise ValueError(f"`shares` is {shares}; wanted at least 1, and exactly 1 with `test`, which makes one fold")
    keywords: dict[str, Any] = {
        "methods": None if methods is None else list(methods),
        "folds": folds,
        "test": None if test is None else list(test),
        "truth": truth,
        "tune": tune,
    }
    options = [{**keywords, "share": (number, shares)} for number in range(shares)]
    pool = (cluster, workers, timeout)
    plan = _plan("evaluate", (logs, settings, robot), options, threads, pool)
    runs = _runs(plan, Kept(keep), pool, progress)
    return cast(Iterator[Run[Evaluation]], runs)


def tune(
    logs: _Logs,
    settings: _Settings = None,
    robot: Robot | _Path | None = None,
    *,
    candidates: int | None = None,
    keep: _Path | None = None,
    cluster: str | bool | Submits | None = None,
    workers: int | None = None,
    threads: int = 1,
    timeout: float | None = None,
    progress: Progress = None,
) -> Iterator[Run[Tuned]]:
    """Chooses settings for every log, starting from every given choice, as `palpate.tune` does.

    Arguments are those of `evaluate`; yields runs as they are finished.
    """
    pool = (cluster, workers, timeout)
    plan = _plan("tune", (logs, settings, robot), [{"candidates": candidates}], threads, pool)
    return cast(Iterator[Run[Tuned]], _runs(plan, Kept(keep), pool, progress))


_Pool: TypeAlias = tuple[str | bool | Submits | None, int | None, float | None]
"""Cluster, workers and time-out."""

_Plan: TypeAlias = dict[tuple[str, str], dict[str, Task]]
"""For every run, by log and settings, its tasks by key."""


def _plan(
    what: Literal["evaluate", "tune"],
    given: tuple[_Logs, _Settings, Robot | _Path | None],
    options: list[dict[str, Any]],
    threads: int,
    pool: _Pool,
) -> _Plan:
    if threads < 1:
        raise ValueError(f"`threads` is {threads}; wanted at least 1")
    cluster, _, timeout = pool
    if timeout is not None and not timeout > 0:
        raise ValueError(f"`timeout` is {timeout}; wanted more than 0 s, or None")
    if not (cluster is None or isinstance(cluster, (bool, str)) or callable(getattr(cluster, "submit", None))):
        raise TypeError(
            f"`cluster` is {cluster!r}; wanted an address, a bool, None, or an executor, which has `submit`"
        )
    logs, settings, robot = given
    arm = robot if robot is None or isinstance(robot, Robot) else os.fspath(robot)
    choices = {name: given_settings(choice) for name, choice in _choices(settings).items()}
    plan: _Plan = {}
    maker = Maker(arm)
    for name, log in _named(logs).items():
        for choice, sections in choices.items():
            whole = maker.task(what, log, sections, threads)
            tasks = [replace(whole, options=some) for some in options]
            plan[name, choice] = {task.key(): task for task in tasks}
    return plan


def _named(logs: _Logs) -> dict[str, str | Log]:
    """Logs by name; those in a list are named by the last parts of their paths, as many as make the names unique."""
    if isinstance(logs, (str, os.PathLike, Log)):
        raise TypeError("`logs` is a single log; wanted several, in a list or in a dict by name")
    if isinstance(logs, Mapping):
        return {str(name): _log(log) for name, log in logs.items()}
    found = [_log(log) for log in logs]
    paths = [Path(log.paths[0] if isinstance(log, Log) else log).parts for log in found]
    for length in range(1, max(map(len, paths), default=0) + 1):
        names = ["/".join(parts[-length:]) for parts in paths]
        if len(set(names)) == len(names):
            return dict(zip(names, found, strict=True))
    if not found:
        return {}
    raise ValueError("`logs` names a log twice; give logs in a dict by name")


def _log(log: _Path | Log) -> str | Log:
    return log if isinstance(log, Log) else os.fspath(log)


def _choices(settings: _Settings) -> Mapping[str, AnySettings | None]:
    """Choices of settings by name."""
    if settings is None:
        return {"0": None}
    if isinstance(settings, (str, os.PathLike)):
        raise TypeError("`settings` is a single file; wanted several choices, in a list or by name")
    if not isinstance(settings, Mapping):
        return {str(number): choice for number, choice in enumerate(settings)}
    if sections := settings.keys() & default_settings().keys():
        raise TypeError(
            f"`settings` has the key {min(sections)}, a section; wanted names of choices as keys. Put a "
            "single choice in a list"
        )
    return settings


def _runs(
    plan: _Plan, kept: Kept, pool: _Pool, progress: Progress
) -> Iterator[Run[Any]]:
    """Does the tasks that are not kept; yields every run when its last task is done."""
    shown = _progress.of(progress)
    tasks = {key: task for of_run in plan.values() for key, task in of_run.items()}
    runs: dict[str, list[tuple[str, str]]] = {key: [] for key in tasks}
    for run, of_run in plan.items():
        for key in of_run:
            runs[key].append(run)
    found: dict[tuple[str, str], dict[str, Outcome]] = {run: {} for run in plan}
    try:
        for number, (key, outcome) in enumerate(_outcomes(tasks, kept, pool), 1):
            shown(number, len(tasks), "tasks")
            for run in runs.pop(key):
                found[run][key] = outcome
                if found[run].keys() == plan[run].keys():
                    outcomes = found.pop(run)
                    yield _run(*run, [outcomes[key] for key in plan[run]])
    finally:
        shown.close()


def _outcomes(
    tasks: dict[str, Task], kept: Kept, pool: _Pool
) -> Iterator[tuple[str, Outcome]]:
    """Yields the kept outcomes, then those of the other tasks as they are done."""
    left = dict(tasks)
    for key in tasks:
        if (outcome := kept.get(key)) is not None:
            del left[key]
            yield key, outcome
    places: dict[str, int] = {}  # tasks with the same contacts are done in succession
    for task in left.values():
        places.setdefault(task.contacts(), len(places))
    left = dict(sorted(left.items(), key=lambda item: places[item[1].contacts()]))
    cluster, workers, timeout = pool
    if cluster is None:
        cluster = "RAY_ADDRESS" in os.environ or _is_connected()
    if cluster is False:
        doing = _workers.processes(left, workers, timeout)
    elif cluster is True or isinstance(cluster, str):
        doing = _on_ray.outcomes(left, None if cluster is True else cluster, timeout)
    else:
        doing = _workers.in_executor(left, cluster, timeout)
    for key, outcome in doing:
        kept.put(key, outcome)
        yield key, outcome


def _is_connected() -> bool:
    """Whether this process is connected to Ray."""
    ray = sys.modules.get("ray")
    return ray is not None and bool(ray.is_initialized())


def _run(log: str, settings: str, outcomes: list[Outcome]) -> Run[Any]:
    """Joins the outcomes of the tasks of a run."""
    seconds = sum(outcome.seconds for outcome in outcomes)
    for text in dict.fromkeys(text for outcome in outcomes for text in outcome.warnings):
        warnings.warn(f"{log}: {text}", PalpateWarning, stacklevel=4)
    errors = [outcome.error for outcome in outcomes if outcome.error is not None]
    if errors:
        return Run(log, settings, None, errors[0], seconds)
    results: list[Any] = [outcome.result for outcome in outcomes]
    result = results[0] if len(results) == 1 else joined(results)
    return Run(log, settings, result, None, seconds)
