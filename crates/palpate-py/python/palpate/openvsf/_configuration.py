"""Converts a configuration of OpenVSF to palpate's settings.

| OpenVSF                                  | palpate                                              |
|------------------------------------------|------------------------------------------------------|
| `world`: the robot's `file_name`         | robot                                                |
| `dataset`, `train_sequences`, `test_…`   | logs, in the order of OpenVSF's sequence numbers     |
| `calibrators`: `num_samples`             | `touch.tare_frames`                                  |
| `simulator`: `friction_mu`, `slide_step` | `contact.friction`, `slip_step_m`                    |
| `geometry_padding1` + `2`                | `contact.contact_distance_m`                         |
| `bbox`, `voxel_size`, or the points      | `lattice`                                            |
| `estimator`: `optimizer`                 | `estimator.estimator`, `map` or `ekf`                |
| `num_replay_update`, `max_buffer_length` | `replays`, `memory_frames`                           |
| `prior`: `mu`, `var`                     | `prior_mean`, `prior_std`, for a cell of 1 cm        |

Keys that the file leaves out keep palpate's defaults.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from .._palpate import FileError, Lattice, Mapper, Robot, SettingsError
from .._palpate import default_settings, given_settings
from ..settings import Path as _Path
from . import _include
from ._arrays import read as read_field
from ._dataset import Touches, open_dataset
from ._lattice import lattice_of
from ._section import Section

_BY_REPLAY = "`map` finds the same optimum, by replay"
_METHODS = {
    "quad_prog": ("map", _BY_REPLAY),
    "sgd": ("map", _BY_REPLAY),
    "dense_ekf": ("map", "there is no filter with full covariances; `map` is the exact optimum"),
    "diag_ekf": ("ekf", None),
}
"""The estimator for each optimizer, and a note about it, if any."""

_SECTIONS = ("world", "simulator", "sensors", "calibrators", "dataset", "estimator", "prior")
_SEQUENCES = ("train_sequences", "test_sequences")
_DATASET = ("type", "path", "keys", "cache", "sensor_keys", "control_keys")


@dataclass(frozen=True)
class Configuration:
    """Result of `read_config`."""

    path: Path
    """The file."""
    robot: Robot
    """The arm."""
    settings: dict[str, Mapping[str, Any] | Lattice]
    """Sections, to give as `settings=` to `Mapper`, `evaluate` and others."""
    train: Touches
    """The touches of `train_sequences`, all if it names none."""
    test: Touches | None
    """The touches of `test_sequences`, None if it names none."""
    notes: tuple[str, ...]
    """Keys without a counterpart in palpate, or with a different one: one sentence each."""


def read_config(
    path: _Path,
    *,
    data_dir: _Path | None = None,
    robot: Robot | _Path | None = None,
    lattice: Lattice | None = None,
) -> Configuration:
    """Reads a configuration of OpenVSF, YAML (with PyYAML) or JSON, with the files that it includes.

    The file may also contain only the section of a data set, or only its keys. `data_dir` is the
    data set's folder, as OpenVSF's `--data_dir`; if left out, `dataset.path`, relative to the working
    directory or else to the file. `robot` and `lattice` override those of the file.

    Raises FileError, which names the file and the key, for invalid keys and values; LogError and
    SettingsError for a data set and values that palpate refuses; ValueError if there is no data set.
    """
    return _Reading(Path(path)).configuration(data_dir, robot, lattice)


@dataclass
class _Reading:
    """State while a configuration is read."""

    path: Path
    settings: defaultdict[str, dict[str, Any]] = field(default_factory=lambda: defaultdict(dict))
    """Settings by section; None for keys that the file leaves out."""
    notes: list[str] = field(default_factory=list)

    def configuration(
        self, data_dir: _Path | None, robot: Robot | _Path | None, lattice: Lattice | None
    ) -> Configuration:
        top = self.top()
        dataset = top.section("dataset")
        controlled = dataset.section("control_keys")
        name, arm = self.robot(top.section("world"), controlled.keys(), robot)
        sensor = self.sensor(top.section("sensors"), dataset.section("sensor_keys").keys(), name, arm)
        lattice = self.simulator(top.section("simulator"), lattice)
        self.calibrators(top.section("calibrators"), sensor)
        spacing = lattice.spacing if lattice else default_settings()["lattice"]["spacing_m"]
        method = self.estimator(top.section("estimator"))
        self.prior(top.section("prior"), method, spacing)
        angles, torques = self.keys(dataset, name, sensor, arm)
        root = self.data(dataset, data_dir)
        train, test = (top.items(key, int, "whole numbers") for key in _SEQUENCES)
        top.done()
        try:
            settings: dict[str, Mapping[str, Any] | Lattice] = {**given_settings(self.settings)}
            if lattice is not None:
                settings["lattice"] = lattice
            Mapper(arm, settings=settings)  # checks the range of every value
        except SettingsError as error:
            raise SettingsError(f"`{self.path}`, as settings of palpate: {error}") from None

        def touches(sequences: list[int] | None) -> Touches:
            return open_dataset(root, sequences=sequences, angles=angles, torques=torques)

        learnt, tested = touches(train or None), touches(test) if test else None
        return Configuration(self.path, arm, settings, learnt, tested, tuple(self.notes))

    def top(self) -> Section:
        """The file's sections; a data set's section or keys alone are taken as `dataset`."""
        held = _include.read(self.path)
        if isinstance(held, dict) and not set(held) & {*_SECTIONS, *_SEQUENCES}:
            alone = bool(set(held) & set(_DATASET))
            held = {"dataset": held if alone else {"keys": held}}
        return Section(self.path, "", held)

    def ignored(self, section: Section, *keys: str) -> None:
        """Adds a note for each of `keys` that is given, since palpate ignores it."""
        for key in keys:
            if section.value(key) is not None:
                self.notes.append(f"`{section.named(key)}` has no counterpart and is ignored.")

    def robot(
        self, world: Section, controlled: list[str], given: Robot | _Path | None
    ) -> tuple[str | None, Robot]:
        """The arm that moves in the data set: its name in the world, and the robot."""
        files: dict[str, str] = {}
        others: dict[str, str | None] = {}
        for name, thing in world.sections():
            kind, file, parent = thing.text("type"), thing.text("file_name"), thing.text("parent_name")
            thing.done("parent_relative_transform", "initial_config")
            if kind == "robot" and file is not None:
                files[name] = file
            elif kind in ("rigid", "deformable"):
                others[name] = parent
            else:
                wanted = "wanted a robot, rigid or deformable with a `file_name`"
                raise world.error(name, f"is of type {kind!r}; {wanted}")
        moved = [name for name in files if name in controlled] or list(files)
        if len(moved) > 1:
            raise world.error("", f"has the robots {', '.join(moved)}; name one in control_keys")
        robot = moved[0] if moved else None
        arm = self.arm(given, files[robot] if robot else None)
        for other, parent in others.items():
            where = f"moves with `{parent}`: add it to the URDF" if parent else "stands in the world"
            self.notes.append(f"`world.{other}` {where}; in palpate, only links of the robot touch the object.")
        return robot, arm

    def arm(self, given: Robot | _Path | None, file: str | None) -> Robot:
        if given is None and file is None:
            self.notes.append("The file names no robot: palpate's kinova_gen3 is taken.")
        if given is None and file is not None:
            missing = FileError(f"`{self.path}`: the robot's file_name `{file}` is not there")
            given = self.found(file, missing)
        return given if isinstance(given, Robot) else Robot(given)

    def found(self, name: str, missing: FileError) -> Path:
        """A file or folder relative to the working directory, as in OpenVSF, or relative to the configuration."""
        for place in (Path(name), self.path.parent / name):
            if place.exists():
                return place
        raise missing

    def sensor(
        self, sensors: Section, recorded: list[str], robot: str | None, arm: Robot
    ) -> str | None:
        """The name of the sensor of joint torques."""
        measuring = []
        for name, sensor in sensors.sections():
            kind = sensor.text("type")
            sensor.text("name")
            at, links = sensor.text("attachment_name"), sensor.items("link_names", str, "names of links")
            sensor.done()
            if kind != "JointTorqueSensor" or (robot is not None and at != robot):
                remark = f"({kind} of `{at}`) has no counterpart and is ignored"
                self.notes.append(f"Sensor `{name}` {remark}.")
                continue
            self.links(sensor, links, arm)
            measuring.append(name)
        named = [name for name in measuring if name in recorded] or measuring
        if sensors.keys() and len(named) != 1:
            found = f"has {len(named)} sensors of the robot's joint torques"
            raise sensors.error("", f"{found}; palpate learns from exactly one JointTorqueSensor")
        return named[0] if named else None

    def links(self, sensor: Section, links: list[str], arm: Robot) -> None:
        """Checks that the torques are those of all joints, from base to tip."""
        unknown = [link for link in links if link not in arm.link_names]
        order = [arm.link_names.index(link) for link in links if link not in unknown]
        if links and (unknown or len(links) != arm.n_joints or order != sorted(order)):
            raise sensor.error(
                "link_names",
                f"is {links}; palpate needs the torques of all {arm.n_joints} joints, base to tip, of "
                f"{arm.link_names}",
            )

    def simulator(self, simulator: Section, given: Lattice | None) -> Lattice | None:
        """Reads the contact settings, and the lattice of the field's points."""
        self.ignored(simulator, "world_pcd_samples", "world_sdf_resolution")
        if simulator.text("type") not in (None, "quasistatic"):
            raise simulator.error("type", "is not `quasistatic`, as palpate is")
        lattice, taken = given, False
        deformables = simulator.section("deformables")
        for _, body in deformables.sections():
            model, contact, pose = body.section("model"), body.section("config"), body.value("pose")
            body.done()
            if model.text("type") == "neural" or taken:
                self.notes.append(f"`{body.named('model')}` has no counterpart and is ignored.")
                continue
            taken = True
            self.contact(contact)
            found = self.points(model, pose, read=given is None)
            lattice = lattice or found
        simulator.done()
        return lattice

    def contact(self, config: Section) -> None:
        contact = self.settings["contact"]
        contact["friction"] = config.number("friction_mu")
        slides, step = config.flag("sim_slide"), config.positive("slide_step")
        paddings = [config.number(f"geometry_padding{which}") for which in (1, 2)]
        config.done()
        if slides is False:
            contact["slip_iterations"] = 0
            why = "palpate's contact model is made for points that slip, and slip costs little time"
            self.notes.append(f"`{config.named('sim_slide')}` is false, so points stick; {why}.")
        else:
            contact["slip_step_m"] = step
        if any(padding is not None for padding in paddings):
            contact["contact_distance_m"] = sum(0.003 if one is None else one for one in paddings)

    def points(self, model: Section, pose: Any, *, read: bool) -> Lattice | None:
        """The lattice of a model's points in the frame of the robot; None if the model determines none."""
        way, path = model.text("init_method") or "file", model.text("path")
        config = model.section("point_vsf_config")
        model.done("neural_vsf_config", "factory_config", "rgbd_factory_config")
        corners, size = config.value("bbox"), config.positive("voxel_size")
        self.ignored(config, "rest_points", "axis_mode", "features")
        config.done()
        if not read:
            return None
        if way == "config" and corners is not None and size is not None:
            low, high = self.box(config, corners, pose)
            return Lattice.filling(low, high, size)
        if way != "file" or path is None:
            self.notes.append(
                f"`{model.named('init_method')}` is {way!r}, from which palpate makes no points: "
                "its own lattice is used, unless you give `lattice`."
            )
            return None
        missing = model.error("path", f"`{path}` is not there; give `lattice` to do without this file")
        points = read_field(self.found(path, missing)).points
        lattice = lattice_of(points @ _turned(pose)[:3, :3].T + _turned(pose)[:3, 3])
        self.notes.append(
            f"The lattice covers the points of `{path}`, with a spacing of {lattice.spacing:.6g} m."
        )
        return lattice

    def box(self, config: Section, corners: Any, pose: Any) -> tuple[list[float], list[float]]:
        """Low and high corner, in the frame of the robot, of the bounding box of a box with a pose."""
        try:
            box = np.array(corners, dtype=float).reshape(2, 3)
            turned = _turned(pose)
        except (TypeError, ValueError) as error:
            raise config.error("bbox", f"is not a box of 2 x 3 numbers, or the pose is not 4 x 4: {error}") from None
        picks = np.array(np.meshgrid(*[[0, 1]] * 3)).reshape(3, -1).T
        posed = box[picks, range(3)] @ turned[:3, :3].T + turned[:3, 3]
        return posed.min(axis=0).tolist(), posed.max(axis=0).tolist()

    def calibrators(self, calibrators: Section, sensor: str | None) -> None:
        for name, calibrator in calibrators.sections():
            kind, samples = calibrator.text("type"), calibrator.whole("num_samples")
            calibrator.done("output_key")
            if kind != "tare":
                raise calibrator.error("type", f"is {kind!r}; wanted `tare`")
            if name != sensor and sensor is not None:
                self.notes.append(f"The tare of `{name}` is ignored, as its sensor is.")
            elif samples is not None:
                self.settings["touch"] = {"tare_frames": samples}

    def estimator(self, estimator: Section) -> str:
        settings = self.settings["estimator"]
        settings["replays"] = estimator.whole("num_replay_update")
        settings["memory_frames"] = estimator.whole("max_buffer_length")
        optimizer = estimator.text("optimizer")
        self.ignored(estimator, "batch_size")
        if estimator.value("down_sample_rate") != 1:
            self.ignored(estimator, "down_sample_rate")
        estimator.done()
        if optimizer is None:
            return "map"
        if optimizer not in _METHODS:
            raise estimator.error("optimizer", f"is {optimizer!r}; wanted {', '.join(_METHODS)}")
        method, why = _METHODS[optimizer]
        if why is not None:
            self.notes.append(f"`{optimizer}` becomes `{method}`: {why}.")
        settings["estimator"] = method
        return method

    def prior(self, prior: Section, method: str, spacing: float) -> None:
        """Reads the prior and converts it from the spacing of the file's points to palpate's cells of 1 cm."""
        kind, mean, variance = prior.text("type"), prior.number("mu"), prior.positive("var")
        self.ignored(prior, "feature_keys")
        prior.done("diag", "c_dim")
        if kind not in (None, "gaussian"):
            self.notes.append(f"The prior `{kind}` depends on features; palpate uses one prior for all points.")
        cells = spacing / 0.01
        estimator = self.settings["estimator"]
        if mean == 0.0 and method == "ekf":
            own = default_settings(estimator={"estimator": "ekf"})["estimator"]["prior_mean"]
            why = f"its `ekf` keeps a prior mean of {own} N/m, for it learns nothing from 0"
            self.notes.append(f"`prior.mu` is 0 N/m; {why}.")
        elif mean is not None:
            estimator["prior_mean"] = mean / cells**3
        if variance is not None:
            estimator["prior_std"] = math.sqrt(variance) / cells**1.5

    def keys(
        self, dataset: Section, robot: str | None, sensor: str | None, arm: Robot
    ) -> tuple[str, str]:
        """The names of the arrays of joint positions and torques."""
        keys = dataset.section("keys")

        def named(section: str, name: str | None, default: str) -> str:
            by_name = dataset.section(section)
            if name is not None and name in by_name:
                return by_name.text(name) or default
            texts = [by_name.text(one) or "" for one in by_name.keys()]
            fitting = [text for text in texts if _width(keys.value(text)) == arm.n_joints]
            return fitting[0] if len(fitting) == 1 else default

        angles = named("control_keys", robot, "angles")
        torques = named("sensor_keys", sensor, "torques")
        for key, what in ((angles, "positions"), (torques, "torques")):
            if not keys.keys():
                continue
            if key not in keys:
                raise keys.error(key, f"is missing; it must hold the {what}")
            if _width(keys.value(key)) != arm.n_joints:
                found = f"is {keys.value(key)}; wanted {arm.n_joints}, the {what} of all joints"
                raise keys.error(key, found)
        unread = ", ".join(f"`{key}`" for key in keys.keys() if key not in (angles, torques))
        if unread:
            self.notes.append(f"Of the data set, {unread} are not read.")
        return angles, torques

    def data(self, dataset: Section, data_dir: _Path | None) -> Path:
        kind, path = dataset.text("type"), dataset.text("path")
        dataset.done("cache")
        if kind == "file_loader":
            found = "is `file_loader`, a file for each frame; wanted an array for each sequence: stack"
            raise dataset.error("type", f"{found} them into angles.npy and torques.npy")
        if data_dir is not None:
            return Path(data_dir)
        if not path:
            raise ValueError(f"`{self.path}` has no `dataset.path`: give `data_dir`")
        missing = dataset.error("path", f"is `{path}`, which is not there; give `data_dir`")
        return self.found(path, missing)


def _turned(pose: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
    """A pose as a matrix, world_from_vsf; the identity if there is none."""
    return np.eye(4) if pose is None else np.array(pose, dtype=float).reshape(4, 4)


def _width(spec: Any) -> Any:
    """Number of values of a key in a frame, if they are one-dimensional."""
    shape = spec[0] if isinstance(spec, list) and spec else spec
    return shape[0] if isinstance(shape, list) and len(shape) == 1 else shape
