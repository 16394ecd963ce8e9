"""Faults during a long sweep end no more runs than necessary."""

import multiprocessing
import shutil
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import palpate
import palpate.ray
from palpate import _files, _on_ray, _palpate, _tasks, _workers
from palpate._kept import Kept
from palpate.results import Evaluation

Runs = Iterator[palpate.ray.Run[Evaluation]]

SOFT = {"estimator": {"prior_std": 60.0}}


class Here:
    """An executor that makes each call immediately, in this process."""

    def submit(self, call: Callable[..., Any], /, *arguments: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_result(call(*arguments))
        return future


class Never:
    """An executor that never does anything."""

    def submit(self, call: Callable[..., Any], /, *arguments: Any) -> Future[Any]:
        return Future()


def evaluate(logs: Any, cluster: Any = False, **keywords: Any) -> Runs:
    threads = _palpate.threads() if isinstance(cluster, Here) else 1
    keywords = {"methods": ["uniform"], "workers": 1, "threads": threads, "progress": False, **keywords}
    return palpate.ray.evaluate(logs, cluster=cluster, **keywords)


def rows(runs: Runs) -> dict[tuple[str, str], Any]:
    return {(run.log, run.settings): run.get()["methods"] for run in runs}


@pytest.fixture(scope="module")
def found(logs: dict[str, Path]) -> dict[tuple[str, str], Any]:
    return {(name, "0"): palpate.evaluate(path, methods=["uniform"])["methods"] for name, path in logs.items()}


def test_any_executor_does_the_tasks(logs: dict[str, Path], found: Any) -> None:
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as executor:
        assert rows(evaluate(logs, executor)) == found
    assert rows(evaluate(logs, Here())) == found


def test_needs_distributed_dask_does_the_tasks(logs: dict[str, Path], found: Any) -> None:
    distributed: Any = import_module("distributed")
    local = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None, "host": "127.0.0.1"}
    with distributed.LocalCluster(**local) as cluster, distributed.Client(cluster) as client:
        assert rows(evaluate(logs, client.get_executor())) == found


def test_needs_submitit_its_jobs_do_the_tasks(logs: dict[str, Path], found: Any, tmp_path: Path) -> None:
    executor: Any = import_module("submitit").AutoExecutor(folder=tmp_path, cluster="local")
    executor.update_parameters(timeout_min=5)
    assert rows(evaluate(logs, executor)) == found


def test_a_task_that_never_ends_is_an_error_after_the_timeout(
    logs: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_workers, "LOOK_S", 0.1)
    with pytest.raises(TimeoutError, match="none of the 2 tasks under way has ended within 0.3 s"):
        list(evaluate(logs, Never(), timeout=0.3))
    # The time-out restarts with every task that ends; a sweep may take longer.
    assert len(list(evaluate(logs, timeout=60.0))) == 2


@pytest.mark.parametrize("raised", [MemoryError(), RuntimeError("x"), type("PanicException", (BaseException,), {})("index")])
def test_other_tasks_go_on_whatever_exception_a_task_raises(
    logs: dict[str, Path], found: Any, raised: BaseException, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails_once(*arguments: Any, **keywords: Any) -> Evaluation:
        monkeypatch.undo()
        raise raised

    monkeypatch.setattr(_tasks, "evaluate", fails_once)
    first, second = evaluate(logs, Here())
    assert first.result is None and first.error
    wanted = "not enough memory" if isinstance(raised, MemoryError) else f"report this line: {type(raised).__name__}"
    assert wanted in first.error
    assert second.get()["methods"] == found["two", "0"]


def test_a_log_that_is_gone_ends_its_own_run_alone(logs: dict[str, Path], found: Any, tmp_path: Path) -> None:
    shutil.copytree(logs["one"], tmp_path / "gone")
    opened = palpate.open_log(tmp_path / "gone")
    shutil.rmtree(tmp_path / "gone")
    gone, there = evaluate({"gone": opened, "two": logs["two"]})
    assert gone.error is not None and str(tmp_path / "gone") in gone.error
    assert there.get()["methods"] == found["two", "0"]


def test_a_kept_file_damaged_anywhere_is_recognised_and_computed_again(tmp_path: Path) -> None:
    result: dict[str, Any] = {"a": np.arange(50.0), "b": ["x", 1.5]}
    outcome = _tasks.Outcome(result, None, 1.0, ["w"])
    kept, path = Kept(tmp_path), tmp_path / "key.npz"
    kept.put("key", outcome)
    whole = path.read_bytes()
    lost = 0
    for place in range(len(whole)):
        for damaged in (whole[:place], whole[:place] + bytes([whole[place] ^ 0xFF]) + whole[place + 1 :]):
            path.write_bytes(damaged)
            again = kept.get("key")
            if again is None:
                lost += 1
            else:  # some bytes, such as those of dates, have no effect
                assert again.result is not None and again.result["b"] == result["b"]
                assert np.array_equal(np.asarray(again.result["a"]), result["a"])
    assert lost > len(whole)


def test_another_build_does_not_use_kept_results_and_refuses_tasks(
    logs: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def seconds() -> list[float]:
        return [run.seconds for run in evaluate([logs["two"]], Here(), keep=tmp_path)]

    task = _tasks.Maker(None).task("evaluate", str(logs["two"]), {}, _palpate.threads())
    first = seconds()
    assert seconds() == first
    machine, _, code = _tasks.build().rpartition(" ")
    monkeypatch.setattr(_tasks, "build", lambda: f"{machine} {code[::-1]}")
    assert seconds() != first
    refused = _tasks.do(task)
    assert refused.error is not None and "another build" in refused.error
    monkeypatch.setattr(_tasks, "build", lambda: f"elsewhere {code[::-1]}")
    assert _tasks.do(task).error is None, "a wheel for another machine is another build"


def test_a_worker_with_another_number_of_threads_reports_it(logs: dict[str, Path]) -> None:
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as executor:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            list(evaluate([logs["two"]], executor))
        with pytest.warns(palpate.PalpateWarning, match="works with 1 threads, not 2"):
            list(evaluate([logs["two"]], executor, threads=2))


def test_as_many_processes_as_the_control_group_has_cpus() -> None:
    group = Path("/sys/fs/cgroup/cpu/palpate-test")
    try:
        group.mkdir()
        (group / "cpu.cfs_quota_us").write_text("100000")  # of 100 ms: one CPU
    except OSError as error:
        pytest.skip(f"no control group can be made here: {error}")
    try:
        code = (
            f"import os; open({str(group / 'cgroup.procs')!r}, 'w').write(str(os.getpid()));"
            "from palpate._palpate import cpus; print(cpus())"
        )
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        assert done.stdout.strip() == "1"
    finally:
        group.rmdir()


def test_a_log_is_read_and_processed_once_for_many_settings(logs: dict[str, Path], tmp_path: Path) -> None:
    log = tmp_path / "log"
    shutil.copytree(logs["two"], log)
    keywords: dict[str, Any] = {"methods": ["map"], "tune": False}
    alone = [palpate.evaluate(log, settings=some, **keywords)["methods"] for some in ({}, SOFT)]
    assert alone[0] != alone[1]
    assert palpate.evaluate(log, reuse="a", **keywords)["methods"] == alone[0]
    shutil.rmtree(log)  # reading it again would fail
    assert palpate.evaluate(log, reuse="a", settings=SOFT, **keywords)["methods"] == alone[1]
    for other in ({"contact": {"friction": 0.5}}, {"lattice": {"spacing_m": 0.02}}, {"touch": {"torque_sign": "plus"}}):
        with pytest.raises(palpate.LogError):
            palpate.evaluate(log, reuse="a", settings=other, **keywords)
    with pytest.raises(palpate.LogError):
        palpate.evaluate(log, reuse="b", **keywords)


@pytest.mark.parametrize("is_far", [True, False])
def test_needs_ray_large_files_are_sent_to_other_computers_only(
    cluster: Any, logs: dict[str, Path], found: Any, is_far: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(logs["two"], tmp_path / "two")
    monkeypatch.setattr(_on_ray, "_SENT_BYTES", 100)
    monkeypatch.setattr(_on_ray, "_is_far", lambda ray: is_far)
    of = _on_ray._Stored.of

    def of_and_remove(self: Any, task: Any) -> Any:
        listed = of(self, task)
        shutil.rmtree(tmp_path / "two")
        return listed

    monkeypatch.setattr(_on_ray._Stored, "of", of_and_remove)
    [run] = evaluate([tmp_path / "two"], True)
    if is_far:
        assert run.get()["methods"] == found["two", "0"]
    else:
        assert run.error is not None and "was not sent to it" in run.error


def test_a_log_is_reused_only_with_the_same_options_and_the_same_robot(
    logs: dict[str, Path], robot: palpate.Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = {"rad": palpate.open_log(logs["two"]), "deg": palpate.open_log(logs["two"], angle_unit="deg")}
    coarse = palpate.Robot(bake_spacing_m=0.01)
    alone = [
        palpate.evaluate(log, arm, methods=["map"], tune=False)["methods"]
        for log, arm in ((opened["rad"], robot), (opened["deg"], robot), (opened["rad"], coarse))
    ]
    assert alone[0] != alone[1] != alone[2] != alone[0]
    several: dict[str, Any] = {"methods": ["map"], "tune": False}
    runs = rows(evaluate(opened, Here(), robot=robot, **several))
    assert [runs["rad", "0"], runs["deg", "0"]] == alone[:2]
    assert rows(evaluate({"rad": opened["rad"]}, Here(), robot=coarse, **several)) == {("rad", "0"): alone[2]}
    # Of logs that only workers see, the calling process knows only the paths.
    monkeypatch.setattr(_tasks, "Files", lambda paths: _files.Files([]))
    unseen = rows(evaluate(logs, Here()))
    assert unseen["one", "0"] != unseen["two", "0"]


def test_a_log_in_linked_folders_is_seen_whole(logs: dict[str, Path], tmp_path: Path) -> None:
    (tmp_path / "log").mkdir()
    for touch in logs["one"].iterdir():
        (tmp_path / "log" / touch.name).symlink_to(touch)
    (tmp_path / "log" / "loop").symlink_to(tmp_path / "log")
    seen = {file.path for file in _files.Files([str(tmp_path / "log")]).each}
    assert len(seen) == 6 and all(path.startswith(str(tmp_path / "log" / "seq_")) for path in seen)


def test_needs_ray_files_come_to_workers_that_do_not_have_them(
    cluster: Any, logs: dict[str, Path], found: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    put = _on_ray._Stored._put

    def put_and_remove(self: Any, file: Any) -> Any:
        stored = put(self, file)
        Path(file.path).unlink()
        return stored

    urdf = Path(__file__).resolve().parents[2] / "palpate/src/robot/kinova_gen3.urdf"
    if not urdf.is_file():
        pytest.fail(f"{urdf} is not there")
    (tmp_path / "arm").mkdir()
    shutil.copy(urdf, tmp_path / "arm/arm.urdf")
    for name, log in logs.items():
        shutil.copytree(log, tmp_path / name)
    torques = np.load(tmp_path / "one/seq_001/torques.npy")
    shutil.copytree(tmp_path / "one", tmp_path / "broken")
    torques[50, 2] = np.nan
    np.save(tmp_path / "broken/seq_001/torques.npy", torques)
    monkeypatch.setattr(_on_ray._Stored, "_put", put_and_remove)
    runs = {
        run.log: run
        for run in evaluate([tmp_path / name for name in ("one", "broken")], True, robot=tmp_path / "arm/arm.urdf")
    }
    assert not list((tmp_path / "one").rglob("*.npy")), "no worker can have seen them"
    assert runs["one"].get()["methods"] == found["one", "0"]
    error = str(runs["broken"].error)
    assert str(tmp_path / "broken/seq_001") in error and "palpate-" not in error.replace(str(tmp_path), "")


def test_needs_ray_one_function_and_as_many_tasks_as_a_cluster_can_do(
    cluster: Any, logs: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    ray: Any = import_module("ray")
    made, waited = [], []
    remote, wait = ray.remote, ray.wait

    def counted(*arguments: Any, **keywords: Any) -> Any:
        made.append(arguments)
        return remote(*arguments, **keywords)

    def seen(refs: Sequence[Any], **keywords: Any) -> Any:
        waited.append(len(refs))
        return wait(refs, **keywords)

    monkeypatch.setattr(ray, "remote", counted)
    monkeypatch.setattr(ray, "wait", seen)
    monkeypatch.setattr(_workers, "QUEUED", 1)
    settings = [{"estimator": {"prior_std": float(std)}} for std in range(50, 60)]
    assert len(list(palpate.ray.evaluate([logs["two"]], settings, methods=["zero"], cluster=True))) == 10
    assert len(made) == 1
    assert max(waited) == 2 * 3


def test_needs_ray_every_number_of_threads_has_its_own_workers(cluster: Any, logs: dict[str, Path]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error", palpate.PalpateWarning)
        for threads in (1, 2, 1):
            list(evaluate(logs, True, threads=threads))


def test_needs_ray_more_threads_than_any_node_has_is_an_error(
    cluster: Any, logs: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_on_ray, "_PATIENCE_S", 0.5)
    monkeypatch.setattr(_workers, "LOOK_S", 0.3)
    begun = time.monotonic()
    with pytest.raises(palpate.PalpateError, match="wants 64 CPUs at a time, and the largest node of the cluster has 2"):
        list(evaluate(logs, True, threads=64))
    assert time.monotonic() - begun < 30.0

