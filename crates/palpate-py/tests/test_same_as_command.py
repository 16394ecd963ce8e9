"""Results in Python are identical to those of the command, and so are the messages."""

import json
import shutil
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import palpate
from palpate.results import MapReport
from palpate.settings import EstimatorSettings

NAMES = {"points": "points", "stiffness": "K", "std": "K_std", "counts": "N_obs", "cells": "cells"}


def run(command: Path, *args: object) -> Any:
    done = subprocess.run([command, "--quiet", *map(str, args)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def said(command: Path, *args: object) -> str:
    """The error that the command prints."""
    done = subprocess.run([command, "--quiet", *map(str, args)], capture_output=True, text=True)
    assert done.returncode != 0
    return done.stderr.removeprefix("error: ").strip()


@pytest.fixture(scope="module")
def of_command(command: Path, plant: Path, tmp_path_factory: pytest.TempPathFactory) -> Any:
    path = tmp_path_factory.mktemp("command") / "field.npz"
    return path, run(command, "map", plant, "--tune=off", "-o", path, "--json")


def test_needs_command_the_field_is_the_same_to_the_bit(
    of_command: Any, mapped: tuple[palpate.Mapper, MapReport], tmp_path: Path
) -> None:
    path, report = of_command
    mapper, ours = mapped
    field = mapper.field()
    with np.load(path) as theirs:
        for name, key in NAMES.items():
            found = getattr(field, name)
            assert found.dtype == theirs[key].dtype and found.tobytes() == theirs[key].tobytes(), name
    printed = {key: value for key, value in report.items() if key in ours and key != "touches"}
    assert printed == {key: value for key, value in ours.items() if key != "touches"}
    assert [t["frames_in_contact"] for t in ours["touches"]] == [
        t["frames_in_contact"] for t in report["touches"]
    ]
    mapper.save(tmp_path / "field.npz")
    assert (tmp_path / "field.npz").read_bytes() == path.read_bytes()


def test_needs_command_settings_chosen_for_learned_touches_give_the_field_of_the_command(
    command: Path, plant: Path, robot: palpate.Robot, tmp_path: Path
) -> None:
    touches = [plant / f"seq_00{number}" for number in range(4)]
    run(command, "map", *touches, "-o", tmp_path / "theirs.npz", "--json")
    mapper = palpate.Mapper(robot)
    mapper.map(touches[:2], progress=False)
    with pytest.raises(palpate.PalpateError, match="needs 3 touches"):
        mapper.choose_settings(progress=False)
    mapper.map(touches[2:], progress=False)
    chosen = mapper.choose_settings(progress=False)
    assert chosen.startswith("chosen by cross-validation on 4 touches"), chosen
    mapper.save(tmp_path / "ours.npz")
    assert (tmp_path / "ours.npz").read_bytes() == (tmp_path / "theirs.npz").read_bytes()
    with pytest.raises(palpate.PalpateError, match="method `map`"):
        palpate.Mapper(robot, "ekf").choose_settings()
    with pytest.raises(palpate.PalpateError, match="for a field that is continued"):
        palpate.Mapper.load(tmp_path / "ours.npz", robot).choose_settings()


def test_samples_that_another_thread_learns_while_settings_are_chosen_are_kept(
    plant: Path, robot: palpate.Robot
) -> None:
    *touches, last = palpate.open_log([plant / f"seq_00{number}" for number in range(4)])
    assert last.time is not None
    samples = list(zip(last.q, last.tau, last.time))

    def begun() -> palpate.Mapper:
        mapper = palpate.Mapper(robot)
        mapper.map(touches, progress=False)
        return mapper

    first_chosen, meanwhile = begun(), begun()
    first_chosen.choose_settings(progress=False)
    first_chosen.begin_touch()
    for sample in samples:
        first_chosen.step(*sample)
    first_chosen.end_touch()
    meanwhile.begin_touch()
    for sample in samples[:100]:
        meanwhile.step(*sample)
    with ThreadPoolExecutor(1) as pool:
        chosen = pool.submit(meanwhile.choose_settings, progress=False)
        for sample in samples[100:]:
            meanwhile.step(*sample)
        meanwhile.end_touch()
        assert chosen.result().startswith("chosen by cross-validation on 3 touches")
    fields = [mapper.field() for mapper in (first_chosen, meanwhile)]
    assert fields[0].stiffness.tobytes() == fields[1].stiffness.tobytes()
    assert fields[0].cells.tobytes() == fields[1].cells.tobytes()


def test_a_map_is_the_same_from_a_path_a_log_touches_or_steps(plant: Path, robot: palpate.Robot) -> None:
    log = palpate.open_log([plant / "seq_000", plant / "seq_001"])
    sources: list[Any] = [log, list(log), log.paths, [log.paths[0], list(log)[1]]]
    fields = []
    for source in sources:
        mapper = palpate.Mapper(robot)
        mapper.map(source)
        fields.append(mapper.field())
    mapper = palpate.Mapper(robot)
    for touch in log:
        mapper.begin_touch()
        assert touch.time is not None
        for q, tau, time in zip(touch.q, touch.tau, touch.time):
            report = mapper.step(q, tau, time)
        mapper.end_touch()
        assert report.predicted is not None and report.predicted.shape == (robot.n_joints,)
    fields.append(mapper.field())
    for field in fields[1:]:
        assert field.stiffness.tobytes() == fields[0].stiffness.tobytes()
        assert field.cells.tobytes() == fields[0].cells.tobytes()


def test_a_saved_and_loaded_mapper_continues_as_if_never_interrupted(
    plant: Path, robot: palpate.Robot, tmp_path: Path
) -> None:
    whole = palpate.Mapper(robot)
    whole.map([plant / "seq_000", plant / "seq_001"])
    first = palpate.Mapper(robot)
    first.map(plant / "seq_000")
    first.save(tmp_path / "first.npz")
    for mapper in (
        palpate.Mapper.load(tmp_path / "first.npz", robot),
        palpate.Mapper.from_field(first.field(), robot),
    ):
        mapper.map(plant / "seq_001")
        assert mapper.field().stiffness.tobytes() == whole.field().stiffness.tobytes()


def test_needs_command_a_score_is_that_of_predict(
    command: Path, of_command: Any, field: palpate.Field, robot: palpate.Robot, plant: Path
) -> None:
    theirs = run(command, "predict", of_command[0], plant / "seq_010", "--truth", "--json")
    ours = field.score(plant / "seq_010", robot, truth=True)
    assert ours["overall"] == theirs["overall"]
    touch = ours["touches"][0]
    error = np.linalg.norm(touch["predicted"] - touch["external"], axis=1).mean()
    assert error == pytest.approx(touch["avg_error"])
    assert touch["zero"]["avg_error"] == pytest.approx(np.linalg.norm(touch["external"], axis=1).mean())


def test_needs_command_changes_the_next_touch_and_forgetting_are_the_same(
    command: Path, plant: Path, robot: palpate.Robot, tmp_path: Path
) -> None:
    path, rest = tmp_path / "field.npz", tmp_path / "rest.npz"
    four = [plant / f"seq_00{k}" for k in range(4)]
    run(command, "map", *four, "-o", path, "--json", "--prior-mean", 0, "--prior-std", 0.76)
    field = palpate.Field.load(path)
    log = plant / "seq_004"

    assert dict(field.compare(log, robot, progress=False)) == run(command, "compare", path, log, "--json")

    numbers = [5, 6, 7]
    paths = [np.load(plant / f"seq_00{k}" / "angles.npy") for k in numbers]
    task = [np.load(log / "angles.npy")]
    # Without times, like paths given as arrays.
    planned = {k: tmp_path / f"planned/{k}" for k in [*numbers, 4]}
    for number, folder in planned.items():
        folder.mkdir(parents=True)
        for name in ("angles.npy", "torques.npy"):
            shutil.copy(plant / f"seq_00{number}" / name, folder)
    ours = field.next(paths, task, count=2, limit=50.0, robot=robot, progress=False)
    logs = [planned[k] for k in numbers]
    given = ("--candidates", *logs, "--task", planned[4], "--count", 2, "--limit", 50, "--json")
    theirs = run(command, "next", path, *given)
    assert len(ours["proposals"]) == 2 and not ours["touch_nothing"]
    for own, other in zip(ours["proposals"], theirs["proposals"]):
        named = {"name", "log"}
        assert {k: v for k, v in own.items() if k not in named} == {
            k: v for k, v in other.items() if k not in named
        }
    with pytest.raises(ValueError, match="information"):
        field.next(paths, by="luck", robot=robot)

    run(command, "forget", path, "-o", rest, "--touch", "seq_002", "--json")
    without, theirs_field = field.without(["seq_002"], robot=robot, progress=False), palpate.Field.load(rest)
    assert len(without) < len(field)
    for name in NAMES:
        assert np.array_equal(getattr(without, name), getattr(theirs_field, name)), name
    with pytest.raises(palpate.PalpateError, match="remembers no touch `seq_009`"):
        field.without(["seq_009"], robot=robot)


def test_the_torque_of_a_planned_path_is_that_of_the_motion(
    field: palpate.Field, robot: palpate.Robot, touch: palpate.Touch
) -> None:
    scored = field.score(touch, robot)["touches"][0]
    planned = field.predict(touch.q, robot)
    assert planned.shape == touch.q.shape
    assert planned[scored["frame"].astype(int)].tobytes() == scored["predicted"].tobytes()


def test_needs_command_an_evaluation_is_the_same(
    command: Path, plant: Path, robot: palpate.Robot, tmp_path: Path
) -> None:
    logs = [plant / f"seq_00{number}" for number in range(3)]
    theirs = run(
        command, "evaluate", *logs, "--methods", "map,knn,zero", "-o", tmp_path / "out", "--json"
    )
    ours = palpate.evaluate(logs, robot, methods=["map", "knn"])
    assert ours["methods"] == theirs["methods"]
    for touch, printed in zip(ours["touches"], theirs["touches"]):
        assert touch["name"] == printed["name"]
        for method in printed["methods"]:
            assert touch["errors"][method.pop("name")] == method
        assert touch["predicted"]["map"].shape == touch["external"].shape
    held_out = palpate.evaluate(logs, robot, methods=["uniform"], test=["seq_002"])
    assert [touch["name"] for touch in held_out["touches"]] == ["seq_002"]
    assert [row["name"] for row in held_out["methods"]] == ["uniform", "zero"]


def test_needs_command_a_field_with_an_elastic_body_is_the_same(
    command: Path, plant: Path, robot: palpate.Robot, tmp_path: Path
) -> None:
    cloud = plant / "object.ply"
    run(command, "map", "--cloud", cloud, "-o", tmp_path / "theirs.npz", "--json")
    ours = palpate.map_elastic(None, cloud, robot=robot)
    ours.save(tmp_path / "ours.npz")
    assert (tmp_path / "ours.npz").read_bytes() == (tmp_path / "theirs.npz").read_bytes()
    again = palpate.Field.load(tmp_path / "ours.npz")
    scores = [field.score(plant / "seq_001", robot)["overall"] for field in (ours, again)]
    assert scores[0] == scores[1]
    error, zero = scores[0]["avg_error"], scores[0]["zero"]["avg_error"]
    assert error is not None and zero is not None and error < 0.95 * zero
    run(command, "map", "--cloud", cloud, "--object-kind", "cushion", "-o", tmp_path / "blocks.npz", "--json")
    palpate.map_elastic(None, cloud, robot=robot, object_kind="cushion").save(tmp_path / "ours.npz")
    assert (tmp_path / "ours.npz").read_bytes() == (tmp_path / "blocks.npz").read_bytes()
    twice = ["--cloud", cloud, "--cloud", cloud, "--root", "0.55,0,0.1"]
    run(command, "map", *twice, "-o", tmp_path / "two.npz", "--json")
    palpate.map_elastic(None, [cloud, cloud], robot=robot, root=(0.55, 0, 0.1)).save(tmp_path / "ours.npz")
    assert (tmp_path / "ours.npz").read_bytes() == (tmp_path / "two.npz").read_bytes()
    with pytest.raises(ValueError, match="`viewpoint` holds 1 places"):
        palpate.map_elastic(None, [cloud, cloud], robot=robot, viewpoint=(0, 0, 1))
    with pytest.raises(ValueError, match="`root` holds NaN"):
        palpate.map_elastic(None, cloud, robot=robot, root=(0.5, 0, float("nan")))
    with pytest.raises(ValueError, match="`object_kind` is \"tree\""):
        palpate.map_elastic(None, cloud, robot=robot, object_kind="tree")  # type: ignore[arg-type]
    with pytest.raises(palpate.SettingsError, match="`live` one with `cloud`"):
        palpate.Mapper(robot, method="elastic")
    with pytest.raises(palpate.PalpateError, match="coloured cloud"):
        palpate.evaluate(plant, robot, methods=["elastic"])


def test_needs_command_tuning_chooses_the_same(
    command: Path, plant: Path, robot: palpate.Robot, tmp_path: Path
) -> None:
    logs = [plant / f"seq_00{number}" for number in range(3)]
    out = tmp_path / "tuned.toml"
    theirs = run(command, "tune", *logs, "--candidates", 3, "-o", out, "--json")
    ours = palpate.tune(logs, robot, candidates=3)
    assert ours["trials"] == theirs["trials"]
    assert out.read_text().endswith(ours["toml"])
    chosen = palpate.Mapper(robot, settings=ours["settings"]).config
    assert chosen == palpate.Mapper(robot, settings=out).config
    assert chosen["contact"] == ours["trials"][0]["settings"]["contact"]


def test_needs_command_quick_tuning_chooses_the_same_in_map_and_evaluate(
    command: Path, plant: Path, robot: palpate.Robot, tmp_path: Path
) -> None:
    logs = [plant / f"seq_00{number}" for number in range(4)]
    out = tmp_path / "field.npz"
    # The default prior, but given explicitly, so that only a sixth of the candidates remain.
    given, flags = EstimatorSettings(prior_mean=0.0, prior_std=0.76), ("--prior-mean", 0, "--prior-std", 0.76)
    run(command, "map", *logs, "-o", out, "--json", *flags)
    chosen = palpate.tune(logs, robot, quick=True, estimator=given)["settings"]
    mapper = palpate.Mapper(robot, settings=chosen)
    mapper.map(logs)
    mapper.save(tmp_path / "ours.npz")
    with np.load(tmp_path / "ours.npz") as own, np.load(out) as theirs:
        assert set(own) == set(theirs)
        assert all(own[name].tobytes() == theirs[name].tobytes() for name in own if name != "palpate")
        own_meta, their_meta = (json.loads(bytes(file["palpate"])) for file in (own, theirs))
    # When it chooses settings, the command also holds out touches, which shows how well they are predicted.
    calibration = their_meta.pop("calibration")
    assert (calibration["touches"], len(calibration["misfits"])) == (4, 4)
    assert own_meta.pop("calibration") == calibration | {"misfits": []}
    assert own_meta == their_meta
    # A field that is loaded, scored and saved keeps its bands.
    field, log = palpate.Field.load(out), plant / "seq_004"
    scored = field.score(log)
    assert scored["bands"] == run(command, "predict", out, log, "--json")["bands"] is not None
    half_width = scored["touches"][0]["half_width"]
    assert half_width is not None and half_width.shape == scored["touches"][0]["predicted"].shape
    field.save(tmp_path / "again.npz")
    with np.load(tmp_path / "again.npz") as again:
        assert json.loads(bytes(again["palpate"]))["calibration"] == calibration
    report = ("-o", tmp_path / "report", "--json")
    theirs = run(command, "evaluate", *logs, "--methods", "map", *report, *flags)
    ours = palpate.evaluate(logs, robot, methods=["map"], estimator=given)
    assert ours["methods"][0]["avg_error"] == theirs["methods"][0]["avg_error"]
    with pytest.raises(ValueError, match='wanted a bool or "quick"'):
        palpate.evaluate(logs, robot, tune="slow")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="leave out `candidates` or `quick`"):
        palpate.tune(logs, robot, quick=True, candidates=3)


def test_needs_command_an_extrapolation_is_the_same(
    command: Path, of_command: Any, plant: Path, field: palpate.Field, robot: palpate.Robot, tmp_path: Path
) -> None:
    out, filled = tmp_path / "seen.npz", tmp_path / "filled.npz"
    run(command, "extrapolate", of_command[0], plant / "object.ply", "-o", out, "--field", filled, "--json")
    ours = palpate.extrapolate(field, plant / "object.ply", robot=robot)
    with np.load(out) as theirs:
        assert ours.stiffness.tobytes() == theirs["K"].tobytes()
        assert ours.points.tobytes() == theirs["points"].tobytes()
        assert (ours.touched == theirs["touched"].astype(bool)).all()
        knn = palpate.extrapolate(field, theirs["points"], theirs["colors"], robot, method="knn")
    assert knn.method == "knn" and knn.features == "rgb" and knn.stiffness.shape == ours.stiffness.shape
    assert ours.field.stiffness.tobytes() == palpate.Field.load(filled).stiffness.tobytes()
    prior = palpate.Mapper(robot, prior=ours.field)
    assert len(prior.field()) == len(ours.field)


@pytest.mark.parametrize(
    ("ask", "args"),
    [
        (lambda plant: palpate.Mapper(palpate.Robot()).map("nothing"), ["map", "nothing"]),
        (lambda plant: palpate.Robot("hal"), ["map", "{plant}", "--robot", "hal"]),
        (lambda plant: palpate.Mapper(estimator={"prior_std": -1}), ["map", "{plant}", "--prior-std", "-1"]),
        (
            lambda plant: palpate.Mapper("kinova_gen3", "ekf", estimator={"prior_mean": 0.0}),
            ["map", "{plant}", "--estimator", "ekf", "--prior-mean", "0"],
        ),
        (lambda plant: palpate.Field.load(plant / "meta.json"), ["predict", "{plant}/meta.json", "{plant}"]),
        (
            lambda plant: palpate.evaluate(plant, test=["seq_99"]),
            ["evaluate", "{plant}", "--test", "seq_99"],
        ),
    ],
)
def test_needs_command_errors_have_the_same_text_with_keywords_for_flags(
    ask: Any, args: list[str], command: Path, plant: Path, tmp_path: Path
) -> None:
    args = [arg.format(plant=plant) for arg in args]
    if args[0] == "map":
        args += ["-o", str(tmp_path / "out.npz")]
    if args[0] == "evaluate":
        args += ["-o", str(tmp_path / "out")]
    with pytest.raises(palpate.PalpateError) as error:
        ask(plant)
    assert str(error.value) == said(command, *args).replace("--test", "`test`")
