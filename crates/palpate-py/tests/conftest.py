"""Fixtures of the tests: the bundled touches, the command, a map that is made once, and a Ray cluster."""

import os
import sys
import warnings
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
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


@pytest.fixture(scope="session")
def logs(plant: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Two objects of a few short touches."""
    folder = tmp_path_factory.mktemp("logs")
    for name, numbers in {"one": [0, 1, 2], "two": [3, 4]}.items():
        for number in numbers:
            touch = folder / name / f"seq_{number:03}"
            touch.mkdir(parents=True)
            for array in ("angles", "torques"):
                rows = np.load(plant / touch.name / f"{array}.npy")
                np.save(touch / f"{array}.npy", rows[:160])
    return {name: folder / name for name in ("one", "two")}


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """A Ray cluster of two nodes, one with a CPU and one with two."""
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    os.environ["RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"] = "0"  # keeps the cluster on the loopback interface
    ray: Any = import_module("ray")
    nodes: Any = import_module("ray.cluster_utils").Cluster()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Ray warns of changes in its next version
        for cpus in (2, 1):
            nodes.add_node(num_cpus=cpus, object_store_memory=80 << 20, include_dashboard=False)
        ray.init(address=nodes.address, log_to_driver=False)
    yield nodes
    ray.shutdown()
    nodes.shutdown()
