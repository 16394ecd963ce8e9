"""Many logs and settings at once: results equal those of single calls, wherever they are computed."""

import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import palpate
import palpate.ray
from palpate.results import Evaluation

SETTINGS = {"soft": {"estimator": {"prior_std": 60.0}}, "stiff": {"estimator": {"prior_std": 240.0}}}
METHODS = ["map", "uniform"]

Here = dict[tuple[str, str], Evaluation]
"""Evaluations by log and choice of settings."""


@pytest.fixture(scope="module")
def here(logs: dict[str, Path], robot: palpate.Robot) -> Here:
    """Results of single calls of the function."""
    return {
        (log, choice): palpate.evaluate(path, robot, methods=METHODS, settings=settings)
        for log, path in logs.items()
        for choice, settings in SETTINGS.items()
    }


def same(ours: Any, theirs: Any) -> bool:
    """Whether two results are identical."""
    if isinstance(ours, np.ndarray):
        return ours.dtype == theirs.dtype and bool(ours.tobytes() == theirs.tobytes())
    if isinstance(ours, dict):
        return ours.keys() == theirs.keys() and all(same(ours[key], theirs[key]) for key in ours)
    if isinstance(ours, list):
        return len(ours) == len(theirs) and all(map(same, ours, theirs))
    return bool(ours == theirs)


def all_same(runs: Sequence[palpate.ray.Run[Evaluation]], here: Here) -> bool:
    found = {(run.log, run.settings): run.get() for run in runs}
    return len(runs) == len(found) and same(found, here)


def kill_one(pids: Iterator[int]) -> None:
    os.kill(next(pids), signal.SIGKILL)


def test_processes_find_what_one_call_does_however_folds_are_shared_out(
    logs: dict[str, Path], here: Here
) -> None:
    steps: list[tuple[int, int | None]] = []
    progress = lambda done, of: steps.append((done, of))  # noqa: E731
    runs = palpate.ray.evaluate(logs, SETTINGS, methods=METHODS, shares=2, progress=progress)
    assert all_same(list(runs), here)
    assert steps == [(done, 8) for done in range(1, 9)]


def test_kept_results_are_not_computed_again(
    logs: dict[str, Path], here: Here, tmp_path: Path
) -> None:
    def evaluate() -> Iterator[palpate.ray.Run[Evaluation]]:
        return palpate.ray.evaluate(logs, SETTINGS, methods=METHODS, keep=tmp_path, workers=1)

    broken_off = evaluate()
    first = next(broken_off)
    assert isinstance(first, palpate.ray.Run)
    broken_off.close()  # type: ignore[attr-defined]
    deadline = time.monotonic() + 180.0  # the pool's own thread ends the last processes
    while multiprocessing.active_children():
        assert time.monotonic() < deadline, "processes outlive the one who asked"
        time.sleep(0.05)
    kept = sorted(tmp_path.iterdir())
    assert [path.suffix for path in kept] == [".npz"]
    damaged = tmp_path / f"{'0' * 32}.npz"
    damaged.write_bytes(kept[0].read_bytes()[:-30])

    again = list(evaluate())
    assert all_same(again, here)
    assert again[0].seconds == first.seconds, "the kept run comes first, and took what it took"
    assert {path.stat().st_ino for path in kept} <= {path.stat().st_ino for path in tmp_path.iterdir()}
    third = list(evaluate())
    assert sorted(run.seconds for run in third) == sorted(run.seconds for run in again)

    # Truncated results, or results of files that were changed since, are computed again.
    kept[0].write_bytes(kept[0].read_bytes()[:-30])
    assert all_same(list(evaluate()), here)
    os.utime(logs["two"] / "seq_003" / "torques.npy")
    fourth = {(run.log, run.settings): run.seconds for run in evaluate()}
    before = {(run.log, run.settings): run.seconds for run in third}
    assert all(fourth["two", choice] != before["two", choice] for choice in SETTINGS)


def test_a_process_that_dies_changes_nothing(
    logs: dict[str, Path], here: Here
) -> None:
    runs = palpate.ray.evaluate(logs, SETTINGS, methods=METHODS, workers=2)
    found = [next(runs)]
    kill_one(child.pid for child in multiprocessing.active_children() if child.pid)
    found += runs
    assert all_same(found, here)


def test_a_log_that_cannot_be_read_ends_its_own_run_alone(logs: dict[str, Path], tmp_path: Path) -> None:
    shutil.copytree(logs["two"], tmp_path / "broken")
    torques = np.load(tmp_path / "broken/seq_004/torques.npy")
    torques[50, 2] = np.nan
    np.save(tmp_path / "broken/seq_004/torques.npy", torques)
    kept = tmp_path / "kept"
    several = [logs["two"], tmp_path / "broken", tmp_path / "missing"]
    runs = {
        run.log: run for run in palpate.ray.evaluate(several, methods=["uniform"], keep=kept, workers=1)
    }
    assert runs["two"].error is None and runs["two"].get()["against"] == "measured"
    assert "seq_004" in str(runs["broken"].error) and "row 50" in str(runs["broken"].error)
    assert "missing" in str(runs["missing"].error)
    with pytest.raises(palpate.PalpateError, match="broken, settings 0: .*seq_004"):
        runs["broken"].get()
    assert len(list(kept.iterdir())) == 1, "errors are not kept"


def test_tuning_many_is_tuning_each(logs: dict[str, Path], robot: palpate.Robot) -> None:
    [run] = palpate.ray.tune({"one": logs["one"]}, [SETTINGS["soft"]], candidates=2, workers=1)
    alone = palpate.tune(logs["one"], robot, candidates=2, settings=SETTINGS["soft"])
    assert run.get() == alone


@pytest.mark.parametrize(
    ("ask", "error", "words"),
    [
        (lambda: palpate.ray.evaluate("data/plant_a"), TypeError, "single log"),
        (lambda: palpate.ray.evaluate(["a/x", "a/x"]), ValueError, "twice"),
        (
            lambda: palpate.ray.evaluate(["a"], {"estimator": {"prior_std": 1.0}}),  # type: ignore[dict-item]
            TypeError,
            "names of choices",
        ),
        (lambda: palpate.ray.evaluate(["a"], "x.toml"), TypeError, "single file"),
        (
            lambda: palpate.ray.evaluate(["a"], [{"estimator": {"prior_sdt": 1.0}}]),
            palpate.SettingsError,
            "prior_sdt",
        ),
        (lambda: palpate.ray.evaluate(["a"], shares=0), ValueError, "shares"),
        (lambda: palpate.ray.evaluate(["a"], shares=2, test=["seq_000"]), ValueError, "shares"),
        (lambda: palpate.ray.evaluate(["a"], threads=0), ValueError, "threads"),
        (lambda: palpate.ray.evaluate(["a"], cluster=5), TypeError, "has `submit`"),  # type: ignore[arg-type]
        (lambda: palpate.ray.evaluate(["a"], timeout=-1.0), ValueError, "more than 0 s"),
    ],
)
def test_invalid_arguments_are_reported_at_once(ask: Any, error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        ask()


def test_logs_in_a_row_are_named_by_what_differs_in_their_paths(plant: Path) -> None:
    named = palpate.ray._named
    assert list(named(["x/a", "x/b"])) == ["a", "b"]
    assert list(named(["x/a", "y/a"])) == ["x/a", "y/a"]
    assert list(named([palpate.open_log(plant), "y/b"])) == ["plant_a", "b"]


def test_a_script_without_a_guard_ends_with_an_error(logs: dict[str, Path], tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        f"import palpate.ray\nlist(palpate.ray.evaluate([{str(logs['two'])!r}], methods=['zero']))\n"
    )
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=120)
    assert done.returncode == 1, done.stderr
    assert 'RuntimeError: worker processes die as they start' in done.stderr


def ray_workers() -> Iterator[int]:
    """Ray's processes that do a task of palpate."""
    for entry in Path("/proc").iterdir():
        try:
            if entry.name.isdigit() and (entry / "cmdline").read_bytes().startswith(b"ray::do"):
                yield int(entry.name)
        except OSError:
            pass  # the process has ended meanwhile


def test_needs_ray_a_cluster_that_loses_a_worker_and_a_node_finds_the_same(
    cluster: Any, logs: dict[str, Path], here: Here
) -> None:
    assert all_same(list(palpate.ray.evaluate(logs, SETTINGS, methods=METHODS, shares=2)), here)

    runs = palpate.ray.evaluate(logs, SETTINGS, methods=METHODS)
    found = [next(runs)]
    kill_one(ray_workers())
    found += runs
    assert all_same(found, here)

    runs = palpate.ray.evaluate(logs, SETTINGS, methods=METHODS)
    found = [next(runs)]
    cluster.remove_node(cluster.list_all_nodes()[1], allow_graceful=False)
    found += runs
    assert all_same(found, here)
