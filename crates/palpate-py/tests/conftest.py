"""What the tests share: the bundled touches, the command, and a map that is made once."""

import sys
from pathlib import Path

import pytest

import palpate
from palpate.results import MapReport

ROOT = Path(__file__).resolve().parents[3]
PLANT = ROOT / "data" / "plant_a"


@pytest.fixture(scope="session")
def plant() -> Path:
    return PLANT


@pytest.fixture(scope="session")
def command() -> Path:
    """The command `palpate` that the package installs."""
    return Path(sys.executable).with_name("palpate")


@pytest.fixture(scope="session")
def robot() -> palpate.Robot:
    return palpate.Robot()


@pytest.fixture(scope="session")
def mapped(robot: palpate.Robot) -> tuple[palpate.Mapper, MapReport]:
    mapper = palpate.Mapper(robot)
    return mapper, mapper.map(PLANT)


@pytest.fixture(scope="session")
def field(mapped: tuple[palpate.Mapper, MapReport]) -> palpate.Field:
    return mapped[0].field()


@pytest.fixture(scope="session")
def touch() -> palpate.Touch:
    """The last touch of the bundled log."""
    return next(iter(palpate.open_log(PLANT / "seq_010")))
