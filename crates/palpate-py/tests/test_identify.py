"""A motion for identification, identification of an arm from free motion, and its external torques."""

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import palpate
from palpate.settings import TouchSettings

RATE_HZ = 50.0
TORQUES: TouchSettings = {"torque_sign": "plus", "gravity": "included"}


def free_motion(seed: int) -> palpate.Touch:
    """A motion whose torques are those of gravity, inertia, Coulomb friction and a bias."""
    rng = np.random.default_rng(seed)
    time = np.arange(500) / RATE_HZ
    waves = rng.uniform(-0.4, 0.4, (7, 3))
    omega = 2 * np.pi * 0.1 * np.arange(1, 4)
    q = np.einsum("jk,tk->tj", waves, np.sin(np.outer(time, omega)))
    # Friction changes its direction over 0.02 rad.
    friction = np.zeros(q.shape)
    for k in range(1, len(q)):
        friction[k] = np.clip(friction[k - 1] + (q[k] - q[k - 1]) / 0.01, -1, 1)
    tau = -0.5 * friction + 0.2 + rng.normal(0, 0.02, q.shape)
    # With a measured torque of 0, the external torque is minus the torque of the arm's motion.
    nothing = palpate.Touch(q, np.zeros(q.shape), time=time)
    tau -= palpate.external_torques(nothing, progress=False, touch=TORQUES)[0]["torque"]
    return palpate.Touch(q, tau, time=time, name=f"free {seed}")


@pytest.fixture(scope="module")
def touches() -> list[palpate.Touch]:
    return [free_motion(seed) for seed in range(3)]


def test_friction_and_bias_are_found_and_taken_off(touches: list[palpate.Touch], tmp_path: Path) -> None:
    found = palpate.identify(touches, progress=False, touch=TORQUES)
    for joint in found["joints"]:
        assert abs(joint["coulomb_n_m"]["value"] - 0.5) < 0.05, joint
        assert abs(joint["bias_n_m"]["value"] - 0.2) < 0.1, joint
    assert abs(found["payload"]["mass_kg"]["value"]) < 0.1

    (tmp_path / "arm.toml").write_text(found["text"])
    arm = palpate.Robot(arm=tmp_path / "arm.toml")
    for touch in palpate.external_torques(touches, arm, progress=False):
        assert touch["torque"].shape == touch["std"].shape == (500, 7)
        assert touch["time"] is not None and touch["threshold"] is not None
        assert np.sqrt((touch["torque"] ** 2).mean()) < 0.15
        assert (np.abs(touch["torque"]) < 3 * touch["std"]).mean() > 0.95

    # Sign and gravity of measured torques cannot be determined from single samples: those of the arm's file are used.
    lines = found["text"].splitlines()
    older = "\n".join(line for line in lines if not line.startswith(("torque_sign", "gravity")))
    (tmp_path / "older.toml").write_text(older)
    unspecified = palpate.Mapper(palpate.Robot(arm=tmp_path / "older.toml"))
    unspecified.begin_touch()
    with pytest.raises(palpate.PalpateError, match="torque_sign"):
        unspecified.step(np.zeros(7), np.zeros(7))
    mapper = palpate.Mapper(arm)
    mapper.begin_touch()
    first = touches[0]
    assert first.time is not None
    reports = [mapper.step(*sample) for sample in zip(first.q, first.tau, first.time)]
    external = np.array([report.external for report in reports if report.external is not None])
    assert len(external) > 100 and np.sqrt((external**2).mean()) < 0.3


def test_an_identified_arm_gives_the_sign_of_torques_without_gravity(
    touches: list[palpate.Touch], tmp_path: Path
) -> None:
    (tmp_path / "arm.toml").write_text(palpate.identify(touches, progress=False, touch=TORQUES)["text"])
    free = touches[0]
    # A person leads the arm: the torques do work on it, as only motor torques do otherwise.
    push = 0.2 * RATE_HZ * np.gradient(free.q, axis=0)
    led = palpate.Touch(free.q, push, time=free.time)
    arm = palpate.Robot(arm=tmp_path / "arm.toml")
    for robot, sign in ((arm, 1), (None, -1)):
        found = palpate.external_torques(led, robot, progress=False)[0]["torque"]
        assert np.corrcoef(found.ravel(), push.ravel())[0, 1] * sign > 0.99
    # A mapper reads a log by what the log shows, not by what the arm was identified from.
    mapped = palpate.Mapper(arm).map(palpate.Touch(free.q, push, time=free.time), progress=False)
    assert mapped["before_learning"]["zero"]["max_error"] < 2 * np.abs(push).max() * np.sqrt(7)


def run(command: Path, *args: object) -> Any:
    done = subprocess.run([command, "--quiet", *map(str, args), "--json"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_needs_command_torques_are_the_commands(
    command: Path, touches: list[palpate.Touch], tmp_path: Path
) -> None:
    log, arm, table = tmp_path / "log", tmp_path / "arm.toml", tmp_path / "torques.csv"
    for number, touch in enumerate(touches):
        folder = log / f"seq_{number:03}"
        folder.mkdir(parents=True)
        np.save(folder / "angles.npy", touch.q)
        np.save(folder / "torques.npy", touch.tau)
        np.save(folder / "time.npy", np.asarray(touch.time))
    flags = ["--torque-sign", "plus", "--gravity", "included"]
    printed = run(command, "identify", log, "-o", arm, *flags)
    found: Any = palpate.identify(log, progress=False, touch=TORQUES)
    for key in ("payload", "joints", "delay_s", "held_out"):
        assert printed[key] == found[key], key

    free, pushed = log / "seq_000", log / "seq_001"
    wrench = ["--free", free, "--wrench-link", "EndEffector_Link", "-o", table]
    printed = run(command, "torque", pushed, "--arm", arm, *wrench, "--bandwidth-hz", 2)
    robot = palpate.Robot(arm=arm)
    (ours,) = palpate.external_torques(
        pushed, robot, free=free, wrench_link="EndEffector_Link", bandwidth_hz=2.0, progress=False
    )
    assert ours["threshold"] == printed["threshold"] and printed["threshold_from"] == "free_logs"
    theirs = np.genfromtxt(table, delimiter=",", names=True, dtype=None, encoding="utf-8")
    assert ours["wrench"] is not None and ours["wrench"].shape == (500, 6)
    np.testing.assert_allclose(ours["wrench"].T, [theirs[name] for name in ("fx", "fy", "fz", "mx", "my", "mz")])
    np.testing.assert_allclose(ours["statistic"], theirs["statistic"])

    # Without `free`, the threshold is that of unfiltered torques.
    with pytest.warns(palpate.PalpateWarning, match="give `free`"):
        (without,) = palpate.external_torques(pushed, robot, bandwidth_hz=2.0, progress=False)
    assert without["threshold"] != ours["threshold"] and without["wrench"] is None


def test_needs_command_an_excitation_is_the_commands(command: Path, tmp_path: Path) -> None:
    start = [0.1, 0.3, 0.0, 1.6, 0.0, 1.2, 0.0]
    flags = ["--start", ",".join(map(str, start)), "--duration", 8, "--rate-hz", 20, "--speed", 0.3, "--torque", 0.5]
    flags += ["--ground-m", "none", "--reach", 0.5, "--slow-down", 2, "--seed", 3]
    wanted: Any = {"start": np.array(start), "duration": 8, "rate_hz": 20, "speed": 0.3, "torque": 0.5}
    wanted |= {"ground_m": None, "reach": 0.5, "slow_down": 2, "seed": 3}
    for given, keywords, kind in ((flags, wanted, "csv"), ([], {}, "yaml")):
        path = tmp_path / f"motion.{kind}"
        printed = run(command, "excite", "-o", path, *given)
        found: Any = palpate.excite(progress=False, **keywords)
        assert found[kind] == path.read_text()
        assert {"output": str(path)} | {key: found[key] for key in printed if key != "output"} == printed


def test_an_excitation_begins_and_ends_at_rest_at_the_start(robot: palpate.Robot) -> None:
    start = np.array([0.1, 0.3, 0.0, 1.6, 0.0, 1.2, 0.0])
    found = palpate.excite(robot, start=start, duration=8.0, progress=False)
    assert found["joint_names"] == robot.joint_names and found["points"] == len(found["time"]) == 801
    for end in (0, -1):
        np.testing.assert_allclose(found["q"][end], start, atol=1e-12)
        np.testing.assert_allclose(found["velocity"][end], 0, atol=1e-12)
    for slope, value in (("velocity", "q"), ("acceleration", "velocity")):
        rows: Any = found
        numeric = np.gradient(rows[value], found["time"], axis=0)
        np.testing.assert_allclose(rows[slope][1:-1], numeric[1:-1], atol=0.02)
    assert np.ptp(found["q"], axis=0).max() > 0.3 and 0 < found["speed_share"] < 0.51


def test_an_excitation_that_is_not_possible_is_refused_with_the_reason() -> None:
    wrong: dict[str, tuple[Any, str]] = {
        "speed": (2.0, "speed is 2; wanted a number from 0.01 to 1"),
        "slow_down": (0.5, "slow_down is 0.5; wanted a number from 1 to 100"),
        "ground_m": (np.inf, "ground_m is inf; wanted a height in m"),
        "start": ([0.0, 0.5], "the start has 2 joint positions; wanted 7, for Actuator1, "),
    }
    for key, (value, text) in wrong.items():
        keywords: Any = {key: value}
        with pytest.raises(palpate.SettingsError, match=text):
            palpate.excite(progress=False, **keywords)
    with pytest.raises(palpate.SettingsError, match="reaches down to"):
        palpate.excite(ground_m=3.0, progress=False)
    with pytest.raises(ValueError, match=r"`start` has shape \(1, 7\); wanted \(N,\)"):
        palpate.excite(start=np.zeros((1, 7)), progress=False)


def test_torques_of_a_link_or_free_log_that_cannot_be_used_are_refused(touches: list[palpate.Touch]) -> None:
    with pytest.raises(palpate.SettingsError, match="no link `nowhere` .*; there are .*EndEffector_Link"):
        palpate.external_torques(touches, wrench_link="nowhere", progress=False, touch=TORQUES)
    first = touches[0]
    assert first.time is not None
    short = palpate.Touch(first.q[:200], first.tau[:200], time=first.time[:200])
    with pytest.raises(palpate.SettingsError, match=r"contact-free logs \(`free`\) last less than 5 s"):
        palpate.external_torques(touches, free=short, progress=False, touch=TORQUES)


def test_logs_that_cannot_be_identified_from_are_refused_with_the_reason(touches: list[palpate.Touch]) -> None:
    still = palpate.Touch(np.zeros((100, 7)), np.ones((100, 7)), time=np.arange(100) / 50.0)
    with pytest.raises(palpate.PalpateError, match="no joint moves"):
        palpate.identify(still, progress=False, touch=TORQUES)
    with pytest.raises(palpate.PalpateError, match="contain no gravity"):
        palpate.identify(touches, progress=False, touch={"torque_sign": "plus", "gravity": "removed"})
    with pytest.raises(palpate.PalpateError, match="no joint moves a link `nowhere`"):
        palpate.identify(touches, tool_link="nowhere", progress=False, touch=TORQUES)
