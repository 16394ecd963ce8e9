"""What long calls return: plain dicts, described for type checkers."""

from __future__ import annotations

from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray


class Errors(TypedDict):
    """The four figures of the paper's Table I; None where no frame counts.

    The error of a frame is |predicted - felt| over all joints, in N·m; relative is that over |felt|,
    on frames of at least 1 N·m.
    """

    avg_error: float | None
    max_error: float | None
    avg_relative: float | None
    max_relative: float | None


class Beside(Errors):
    """Errors, and those of predicting zero on the same frames."""

    zero: Errors


class MappedTouch(TypedDict):
    """What one touch gave to a map."""

    name: str
    log: str
    frames: int
    tare_frames: int
    frames_in_contact: int


class MapReport(TypedDict):
    """What `Mapper.map` learnt, as `palpate map --json` tells it."""

    robot: str
    estimator: str
    touches: list[MappedTouch]
    frames: int
    tare_frames: int
    frames_in_contact: int
    contacts_median: int
    cells_touched: int
    cells_expected: int
    cells_expected_and_touched: int
    cells_declared: int
    frames_remembered: int
    memory_mib: float
    before_learning: Beside
    """Errors of predicting every frame just before it was learnt from."""


class ScoredFrames(Beside):
    """Errors of some frames, and how many there were."""

    frames: int
    frames_in_log: int
    tare_frames: int
    relative_frames: int
    frames_in_contact: int
    frames_on_known: int


class ScoredTouch(ScoredFrames):
    """One touch of a `Score`, with its torques: T scored frames."""

    name: str
    log: str
    frame: NDArray[np.uint64]
    """Number of each scored frame in its touch, (T,)."""
    time: NDArray[np.float64] | None
    """By the log's clock, s, (T,)."""
    contacts: NDArray[np.uint64]
    """Points touched, (T,)."""
    predicted: NDArray[np.float64]
    """External torque by the field, N·m, (T, n_joints)."""
    external: NDArray[np.float64]
    """External torque that was felt, or the true one, N·m, (T, n_joints)."""


class Score(TypedDict):
    """What `Field.score` found, as `palpate predict --json` tells it."""

    touches: list[ScoredTouch]
    overall: ScoredFrames
    against: str


class MeanStd(TypedDict):
    """Mean and sample standard deviation over touches."""

    mean: float
    std: float


class MethodRow(TypedDict):
    """One row of Table I."""

    name: str
    avg_error: MeanStd | None
    max_error: MeanStd | None
    avg_relative: MeanStd | None
    max_relative: MeanStd | None


class LeftOut(TypedDict):
    """A touch that was predicted but not learnt from: T frames from its tare on."""

    name: str
    fold: int
    time: NDArray[np.float64]
    """Since the first of these frames, s (frame numbers if the log has no clock), (T,)."""
    contacts: NDArray[np.uint32]
    """Points touched, (T,)."""
    known: NDArray[np.uint32]
    """Of these, points that the touches learnt from have met, (T,)."""
    q: NDArray[np.float64]
    """Joint positions, rad, (T, n_joints)."""
    external: NDArray[np.float64]
    """External torque to predict, N·m, (T, n_joints)."""
    predicted: dict[str, NDArray[np.float64]]
    """By method: N·m, (T, n_joints)."""
    errors: dict[str, Errors | None]
    """By method."""


class Evaluation(TypedDict):
    """What `evaluate` found."""

    methods: list[MethodRow]
    touches: list[LeftOut]
    against: str
    joint_names: list[str]
    tuned: list[dict[str, Any]] | None
    """Settings of map and ekf in each fold, if they were tuned."""


class Trial(TypedDict):
    """One candidate of `tune`, and its score after each round that it was in."""

    settings: dict[str, Any]
    scores: list[float]


class Tuned(TypedDict):
    """What `tune` chose."""

    settings: dict[str, dict[str, Any]]
    """Sections, to give as `settings=` to other calls."""
    toml: str
    """The same as a file that `--settings` reads."""
    trials: list[Trial]
