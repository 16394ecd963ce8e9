"""`palpate.inspect` returns what `palpate inspect --json` prints, also for touches in memory."""

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

import palpate
from palpate.results import Inspection
from palpate.settings import LatticeSettings, LogSettings, TouchSettings


def of_command(command: Path, *args: object) -> Any:
    done = subprocess.run(
        [command, "--quiet", "inspect", "--json", *map(str, args)], capture_output=True, text=True
    )
    report = json.loads(done.stdout)["paths"][0]
    return {key: value for key, value in report.items() if key not in ("path", "kind")}


def as_command(inspection: Inspection) -> Any:
    return {**(inspection["log"] or {}), "findings": inspection["findings"]}


def codes(inspection: Inspection) -> list[str]:
    return [finding["code"] for finding in inspection["findings"]]


def test_needs_command_an_inspection_is_the_same(
    command: Path, plant: Path, robot: palpate.Robot
) -> None:
    assert as_command(palpate.inspect(plant, robot)) == of_command(command, plant)
    box: LatticeSettings = {"spacing_m": 0.02, "box_low_m": [0.2, -0.4, 0.0], "box_high_m": [0.9, 0.4, 0.9]}
    flags = ["--spacing-m", 0.02, "--box-low-m", "0.2,-0.4,0", "--box-high-m", "0.9,0.4,0.9"]
    flags += ["--torque-sign", "minus"]
    ours = palpate.inspect(plant, robot, lattice=box, touch={"torque_sign": "minus"})
    assert as_command(ours) == of_command(command, plant, *flags)
    assert codes(ours) == ["torque_sign"]


def test_figures_are_those_of_the_map(plant: Path, robot: palpate.Robot) -> None:
    box = palpate.Lattice.filling([0.2, -0.4, 0.0], [0.9, 0.4, 0.9], 0.02)
    log = palpate.inspect(plant / "seq_000", robot, lattice=box)["log"]
    assert log is not None and log["touched"] is not None and log["reading"] is not None
    assert log["reading"]["torque_sign"] == "plus" and log["reading"]["gravity"] == "included"
    assert log["reading"]["unexplained_share"] == pytest.approx(0.0, abs=0.1)
    report = palpate.Mapper(robot, lattice=box).map(plant / "seq_000")
    touched = log["touched"]
    assert touched["frames_in_contact"] == report["frames_in_contact"]
    assert touched["contacts_median"] == report["contacts_median"]
    assert touched["cells_touched"] == report["cells_touched"]


def test_touches_in_memory_are_inspected(touch: palpate.Touch, robot: palpate.Robot) -> None:
    turned = palpate.Touch(touch.q, -touch.tau, touch.name, touch.time, touch.joint_names)
    found = palpate.inspect(turned, robot)
    assert codes(found) == [] and found["log"] is not None and found["log"]["reading"] is not None
    assert found["log"]["reading"]["torque_sign"] == "minus"
    inspection = palpate.inspect(turned, robot, touch={"torque_sign": "plus"})
    assert codes(inspection) == ["torque_sign"]
    assert inspection["findings"][0]["flags"] == ["--torque-sign", "minus"]
    assert inspection["log"] is not None and inspection["log"]["reading"] is not None
    assert inspection["log"]["reading"]["torque_sign"] == "minus"


def test_a_log_that_looks_wrong_raises_a_warning_and_if_strict_an_error(
    touch: palpate.Touch, robot: palpate.Robot
) -> None:
    turned = palpate.Touch(touch.q, -touch.tau, touch.name, touch.time, touch.joint_names)
    with pytest.warns(palpate.PalpateWarning, match=r"looks wrong \(torque_sign\)"):
        palpate.Mapper(robot).map(turned)
    with pytest.raises(palpate.LogError, match=r"looks wrong \(torque_sign\)"):
        palpate.Mapper(robot, log={"strict": True}).map(turned)
    with pytest.raises(palpate.LogError, match=r"looks wrong \(torque_sign\)"):
        strict: LogSettings = {"strict": True}
        touch_settings: TouchSettings = {"torque_sign": "plus"}
        palpate.evaluate([turned, turned], robot, methods=["zero"], log=strict, touch=touch_settings)


def test_a_touch_of_another_robot_among_others_is_an_error(
    touch: palpate.Touch, robot: palpate.Robot
) -> None:
    other = palpate.Touch(touch.q[:, :6], touch.tau[:, :6])
    unnamed = palpate.Touch(touch.q, touch.tau)
    assert codes(palpate.inspect([unnamed, other], robot)) == ["joint_count"]


def test_a_box_elsewhere_is_a_finding(touch: palpate.Touch, robot: palpate.Robot) -> None:
    box = palpate.Lattice.filling([2, 2, 2], [2.5, 2.5, 2.5], 0.02)
    inspection = palpate.inspect(touch, robot, lattice=box)
    assert codes(inspection) == ["no_contact"]
    assert inspection["findings"][0]["level"] == "warning"


def test_a_log_that_cannot_be_read_is_a_finding(tmp_path: Path, robot: palpate.Robot) -> None:
    inspection = palpate.inspect(tmp_path, robot)
    assert inspection["log"] is None
    assert [finding["level"] for finding in inspection["findings"]] == ["error"]
    with pytest.raises(palpate.SettingsError):
        palpate.inspect(tmp_path, robot, settings={"lattice": {"spacing": 0.02}})
