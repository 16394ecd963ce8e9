"""Settings are those of the command, from a file, a dict or keywords."""

from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np
import pytest

import palpate
from palpate.settings import Settings


def test_a_file_a_dict_and_keywords_say_the_same(robot: palpate.Robot, tmp_path: Path) -> None:
    path = tmp_path / "settings.toml"
    path.write_text('[contact]\nfriction = 0.25\n[estimator]\nestimator = "ekf"\ntorque_std = [2.0]\n')
    sections: dict[str, Any] = {
        "contact": {"friction": np.float64(0.25)},
        "estimator": {"estimator": "ekf", "torque_std": np.array([2.0])},
    }
    of_file = palpate.Mapper(robot, settings=path)
    assert of_file.method == "ekf"
    assert palpate.Mapper(robot, settings=sections).config == of_file.config
    assert palpate.Mapper(robot, **sections).config == of_file.config
    over = palpate.Mapper(robot, settings=path, contact={"friction": 1}, method="map").config
    assert over["contact"]["friction"] == 1.0 and over["method"] == "map"


def test_a_lattice_is_its_section(robot: palpate.Robot) -> None:
    lattice = palpate.Lattice([0.0, -0.5, 0.1], 0.02, [40, 50, 30])
    assert palpate.Mapper(robot, lattice=lattice).field().lattice == lattice
    assert palpate.Mapper(robot, settings={"lattice": lattice}).field().lattice == lattice


def test_default_settings_give_the_default_configuration(robot: palpate.Robot) -> None:
    defaults = palpate.default_settings()
    assert palpate.Mapper(robot, settings=defaults).config == palpate.Mapper(robot).config
    assert palpate.default_settings(contact={"friction": 0.5})["contact"]["friction"] == 0.5


def test_the_typed_settings_are_those_of_the_module() -> None:
    typed = {}
    for section, hint in get_type_hints(Settings).items():
        kind = next(iter(get_args(hint)), hint)  # a lattice may be a `Lattice` as well
        typed[section] = sorted(kind.__annotations__)
    assert typed == {section: sorted(keys) for section, keys in palpate.default_settings().items()}


@pytest.mark.parametrize(
    ("settings", "kind", "message"),
    [
        ({"contact": {"frictoin": 1}}, palpate.SettingsError, "did you mean `friction`"),
        ({"contacts": {"friction": 1}}, palpate.SettingsError, r"did you mean \[contact\]"),
        ({"contact": {"friction": "much"}}, palpate.SettingsError, "friction"),
        ({"contact": {"friction": -1.0}}, palpate.SettingsError, "friction"),
        ({"contact": {"friction": object()}}, TypeError, "`settings.contact.friction` holds object"),
        ({3: {}}, TypeError, "has the key 3"),
        ("no_such.toml", palpate.SettingsError, "`no_such.toml` cannot be read"),
        (3, TypeError, "wanted the path of a TOML file"),
    ],
)
def test_unknown_and_invalid_settings_are_refused(
    robot: palpate.Robot, settings: Any, kind: type[Exception], message: str
) -> None:
    with pytest.raises(kind, match=message):
        palpate.Mapper(robot, settings=settings)


def test_a_list_or_dict_that_contains_itself_is_refused(robot: palpate.Robot) -> None:
    settings: dict[str, Any] = {}
    settings["map"] = settings
    with pytest.raises(ValueError, match="does it hold itself"):
        palpate.Mapper(robot, settings=settings)
    several: list[Any] = []
    several.append(several)
    with pytest.raises(ValueError, match="a list of logs"):
        palpate.Mapper(robot).map(several)


def test_unknown_methods_are_refused(robot: palpate.Robot, plant: Path) -> None:
    with pytest.raises(ValueError, match='wanted "map" or "ekf"'):
        palpate.Mapper(robot, "magic")
    with pytest.raises(ValueError, match="wanted one of elastic, map, ekf"):
        palpate.evaluate(plant, robot, methods=["magic"])


def test_a_log_that_looks_wrong_raises_a_warning(robot: palpate.Robot, touch: palpate.Touch) -> None:
    far = palpate.Lattice([5.0, 5.0, 5.0], 0.02, [10, 10, 10])
    with pytest.warns(palpate.PalpateWarning, match=r"no_contact.*nothing to learn"):
        palpate.Mapper(robot, lattice=far).map(touch)
