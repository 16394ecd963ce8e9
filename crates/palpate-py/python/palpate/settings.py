"""Types of the settings: the sections that `settings=` and keywords take, with their keys.

Keys are those of the command's settings file: `palpate settings` prints all of them with their help, and
`default_settings` returns their values. Units are in the names; prior and drift are in N/m, `torque_std`
is in N·m.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any, Literal, TypeAlias, TypedDict

from numpy.typing import ArrayLike

from ._palpate import Lattice

Path: TypeAlias = str | PathLike[str]


class RobotSettings(TypedDict, total=False):
    """The arm, and what it carries."""

    robot: str
    package_path: Sequence[Path]
    cache_dir: Path
    no_cache: bool
    bake_spacing_m: float
    hold: Sequence[str]
    rename: Sequence[str]
    arm: Path
    payload_link: str
    payload_mass_kg: float
    payload_com_m: ArrayLike


class LogSettings(TypedDict, total=False):
    """How logs are read."""

    angle_unit: Literal["auto", "rad", "deg"]
    time_unit: Literal["auto", "s", "ms", "us", "ns"]
    columns: Mapping[str, str | Sequence[str]]
    topic: str
    touch_topic: str
    joints: Sequence[str]
    until_break: bool
    strict: bool
    split_gap_s: float
    split_idle: bool
    idle_s: float


class TouchSettings(TypedDict, total=False):
    """Sign, gravity and tare of logged torques."""

    torque_sign: Literal["auto", "plus", "minus"]
    gravity: Literal["auto", "included", "removed"]
    tare_frames: int | Literal["auto"]
    no_tare: bool
    still_rad: float


class LatticeSettings(TypedDict, total=False):
    """The workspace box and its points: by two corners, or by first point and numbers of points."""

    spacing_m: float
    box_low_m: ArrayLike
    box_high_m: ArrayLike
    origin_m: ArrayLike
    shape: ArrayLike


class ContactSettings(TypedDict, total=False):
    """The contact model."""

    contact_distance_m: float
    friction: float
    coulomb_friction: float
    slip_step_m: float
    slip_iterations: int
    substep_cells: float
    known_empty: bool


class EstimatorSettings(TypedDict, total=False):
    """The estimator, its prior and its memory."""

    estimator: Literal["map", "ekf"]
    prior_mean: float
    prior_std: float
    torque_std: ArrayLike
    drift_std: float
    stiffness_scale: float
    replays: int
    memory_frames: int
    memory_mib: int
    seed: int


class FieldSections(TypedDict, total=False):
    """The sections that a field is made with, beside its arrays."""

    touch: TouchSettings
    contact: ContactSettings


class LearningSections(FieldSections, total=False):
    """The sections that determine what is learnt from a log."""

    lattice: LatticeSettings | Lattice
    estimator: EstimatorSettings


class Sections(LearningSections, total=False):
    """The sections that functions take as keywords, beside the argument `robot`."""

    log: LogSettings


class Settings(Sections, total=False):
    """All sections."""

    robot: RobotSettings


AnySettings: TypeAlias = Path | Settings | Mapping[str, Mapping[str, Any] | Lattice]
"""The path of a TOML file, or a dict of sections."""
