"""What long calls return: plain dicts, described for type checkers."""

from __future__ import annotations

from typing import Any, Literal, TypedDict

import numpy as np
from numpy.typing import NDArray


class Errors(TypedDict):
    """The four figures of the paper's Table I; None where no frame counts.

    The error of a frame is |predicted - measured| over all joints, in N·m; relative is that over
    |measured|, on frames of at least 1 N·m.
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
    """What `Mapper.map` learnt, as `palpate map --json` prints it."""

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
    """Measured external torque, or the true one, N·m, (T, n_joints)."""
    half_width: NDArray[np.float64] | None
    """Half-width of the band around `predicted` at 90 %, N·m, (T, n_joints); None with an elastic body."""


class Coverage(TypedDict):
    """How often bands held the torque, and how wide they are."""

    level: float
    torque_share: float
    """Share of the torques inside, of a joint in a frame each."""
    by_level: list[list[float]]
    """The same at other levels: level and share."""
    peak_share: float
    """Share of the joints' largest torques in a touch."""
    half_width_n_m: float
    constant_half_width_n_m: float
    """Of a band of one width that holds as many frames, N·m."""
    classes: list[list[float] | None]
    """Share inside and mean half-width, N·m: no contact, mostly known cells, mostly unseen cells."""


class Score(TypedDict):
    """What `Field.score` found, as `palpate predict --json` prints it."""

    touches: list[ScoredTouch]
    overall: ScoredFrames
    against: str
    bands: Coverage | None
    """None of a field without bands, and against the truth."""


class Place(TypedDict):
    """Where torques were outside of their bands."""

    centre_m: list[float]
    radius_m: float
    """Root mean square distance of the touched cells from it, m."""
    cells: int


class RelativeErrors(TypedDict):
    """Errors relative to those of predicting zero."""

    field: float | None
    scaled: float | None
    """With the best factor in the touches that contradict the field; None where none does."""
    moved: float | None
    """After the best motion; None where nothing contradicts the field."""
    repeated: float | None
    """Of the torque measured in the touches that these repeat; None if they do not."""


class Change(TypedDict, total=False):
    """How far it moved, or by what factor it is softer or harder."""

    factor: float
    shift_m: list[float]
    """After a turn about the vertical through `about_m`."""
    turn_rad: float
    about_m: list[float]


class Comparison(Change):
    """Touches beside a field, as `palpate compare --json` prints it."""

    change: str
    """"unchanged", "moved", "softer", "harder", "other", or "unknown" if the field knows little of what was touched."""
    known: float
    """Share of the contacts that the field knows."""
    contradiction: float
    """Above 1 the touches contradict the field."""
    repeats: list[str]
    """The touches of the field's memory whose paths these repeat, if all of them do."""
    error: RelativeErrors
    place: Place | None


class ComparedTouch(Comparison):
    """One touch beside a field."""

    name: str
    log: str


class Comparisons(TypedDict):
    """What `Field.compare` found."""

    touches: list[ComparedTouch]
    together: Comparison


class Proposal(TypedDict):
    """A motion in the order in which it is best made."""

    name: str
    log: str
    candidate: int
    """Its place among the candidates."""
    variance_left: float
    """Share of the task's variance that is left once it and all before it are made."""
    information_nats: float
    """What it teaches by itself, after those before it."""
    unknown: float
    """Share of what it touches that the field does not know."""
    torque_n_m: float
    """Largest torque of a joint that the field predicts."""
    with_band_n_m: float
    """The same with its band, or twice the springs' standard deviation."""


class BeyondLimit(TypedDict):
    """A motion that may pass the limit."""

    name: str
    with_band_n_m: float


class BeyondJointLimits(TypedDict):
    """A motion in which a joint goes beyond its limits."""

    name: str
    joint: str
    """The joint that goes furthest beyond."""
    position: float
    """Where it is furthest beyond, rad or m."""
    limits: list[float | None]
    """Its lowest and highest position by the URDF, rad or m; None where there is none."""


class Proposals(TypedDict):
    """What `Field.next` found, as `palpate next --json` prints it."""

    proposals: list[Proposal]
    beyond_limit: list[BeyondLimit]
    beyond_joint_limits: list[BeyondJointLimits]
    touch_nothing: list[str]


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
    coverage: Coverage | None
    """Of map."""
    coverage_of_other_objects: Coverage | None
    """The same under bands as other objects have them."""


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


class Share(Evaluation):
    """What `evaluate` found in a share of the folds."""

    bands: list[dict[str, Any]]
    """By touch and method, what the coverage of all folds together is computed from."""


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


class _Finding(TypedDict):
    level: Literal["warning", "error"]
    """An error is what learning would refuse."""
    code: str
    """A name that stays when the words change."""
    what: str
    """What was seen, with numbers."""
    remedy: str
    """What to do about it."""


class Finding(_Finding, total=False):
    """One thing that looks wrong with a log."""

    touches: list[str]
    """The touches that show it, if not all do."""
    parts: list[str]
    """The joints that show it."""
    flags: list[str]
    """Flags of the command that would set it right."""


class Clock(TypedDict):
    """The clock of a log."""

    period_s: float
    """Median time step."""
    jitter_s: float
    """How far nine steps of ten stay from it."""
    duration_s: float
    """Sum of all touches."""


class Fit(TypedDict):
    """How well a reading of the torques explains them at rest."""

    torque_sign: Literal["plus", "minus"]
    gravity: Literal["included", "removed"]
    left_over: float
    """Residual, N·m over all joints."""
    slope: float
    """Of the torques, in that sign, on those of gravity."""


class Fits(TypedDict):
    """The readings that were compared."""

    set: Fit
    """That of the settings."""
    best: Fit
    """That with the smallest residual."""
    gravity_torque: float
    """Torque of gravity at rest, N·m over all joints."""
    at_rest: bool
    """Whether the arm ever rests; if not, these are figures of any frames."""
    by_work: bool
    """Whether the sign of `best` is that of torques that take work from the arm, and not that of `set`."""


class PayloadEstimate(TypedDict):
    """A weight that would explain what gravity does not."""

    link: str
    mass_kg: float
    com_link_m: list[float]


class Reading(TypedDict):
    """How a log should be read."""

    angle_unit: Literal["rad", "deg"]
    order: list[int] | None
    """Place of each joint of the robot in the log, if that seems not to be the robot's order."""
    torque_sign: Literal["plus", "minus"]
    gravity: Literal["included", "removed"]
    unexplained_share: float | None
    """Unexplained torque at rest, as a part of gravity; None if gravity is too small to determine it."""
    payload: PayloadEstimate | None
    fits: Fits


class LatticeFigures(TypedDict):
    """Where contacts are looked for."""

    origin_m: list[float]
    spacing_m: float
    shape: list[int]
    box_m: list[list[float]]
    """Low and high corner."""
    cells_declared: int


class TouchedFigures(TypedDict):
    """What a log touches of the lattice, as `MapReport` counts it."""

    frames: int
    frames_in_contact: int
    contacts_median: int
    cells_touched: int


class InspectedTouch(TypedDict):
    """One touch of a log; lists are (n_joints,)."""

    name: str
    frames: int
    duration_s: float | None
    start_frames: int
    """Frames from the first on in which the arm is still, or touches no point."""
    frames_in_contact: int
    tare: list[float] | None
    """N·m; None without tare frames."""
    noise_std: list[float] | None
    """Over the start, N·m; None if it is too short."""
    peak_external: float
    """Largest external torque, N·m over all joints."""
    peak_by_joint: list[float]
    """N·m."""
    range: list[list[float]]
    """From where to where each joint moves, (n_joints, 2), rad or m."""
    end_external: list[float] | None
    """At the end, N·m, if the arm is back where it began."""
    work_until_peak_j: float
    """Work that the external torque does on the arm, J."""


class Columns(TypedDict):
    """Names of the columns that were read of a table."""

    q: list[str]
    tau: list[str]
    joints: list[str] | None
    time: str | None
    touch: str | None


class InspectedLog(TypedDict):
    """What a log holds."""

    format: str
    columns: Columns | None
    """None if it is no table."""
    robot: str
    frames: int
    clock: Clock | None
    joints: list[str]
    matching: Literal["unnamed", "in_order", "reordered", "unmatched"]
    """How the joints of the log became those of the robot."""
    reading: Reading | None
    """None if the joints are not the robot's."""
    lattice: LatticeFigures
    touched: TouchedFigures | None
    """None if the joints are not the robot's."""
    touches: list[InspectedTouch]


class Inspection(TypedDict):
    """What `inspect` found out about a log."""

    log: InspectedLog | None
    """None if nothing of it can be read."""
    findings: list[Finding]
    """Errors first."""


class Uncertain(TypedDict):
    """A value with its standard deviation."""

    value: float
    std: float


class IdentifiedPayload(TypedDict):
    """What an arm carries beyond its URDF."""

    link: str
    mass_kg: Uncertain
    com_m: list[Uncertain]
    inertia_kg_m2: list[list[float]]
    is_significant: bool
    """Whether the mass is more than twice its standard deviation."""


class IdentifiedJoint(TypedDict):
    """What was found out about a joint."""

    name: str
    moved: float
    coulomb_n_m: Uncertain
    asymmetry_n_m: Uncertain
    breakaway_n_m: Uncertain
    viscous_n_m_s: Uncertain
    rotor_inertia_kg_m2: Uncertain
    bias_n_m: Uncertain
    gain: Uncertain
    presliding_rad: float
    ripple_orders: list[float]
    hysteresis_n_m: float


class IdentifiedBody(TypedDict):
    """Links that move together: ten inertial parameters, and how much of the URDF's uncertainty each lost."""

    link: str
    parameters: list[Uncertain]
    variance_reduction: list[float]


class ReadTimes(TypedDict):
    """Stamps that are not the times at which the joints were read."""

    corrected: int
    """Number of touches whose times were corrected."""
    rms_s: float
    """By how much, s, root mean square, but for what all samples of a touch share."""


class FewSamples(TypedDict):
    """Samples with a far larger residual than usual: at most a hundredth, with at least half of the squares."""

    samples: int
    of: int
    """Number of samples that were held out."""
    share: float
    """Of the sum of squares, 0 to 1."""
    largest: float
    """Norm over the joints, N·m."""
    touch: int
    """Number of the touch in which they have most."""
    rows: list[int]
    """First and last of them there, from 0."""
    without: list[float]
    """Residual of all others, N·m over all joints: after gravity of the URDF, and after the identified arm."""


class HeldOutTorque(TypedDict):
    """Root mean squares of the residual on motion that was not used, N·m by joint."""

    gravity: list[float]
    urdf: list[float]
    identified: list[float]
    slow: list[list[float]]
    """The same three of means over the time window of speeds."""
    few: FewSamples | None


class Identified(TypedDict):
    """What `identify` found out about an arm."""

    payload: IdentifiedPayload
    joints: list[IdentifiedJoint]
    bodies: list[IdentifiedBody]
    base_parameters: int
    base_parameters_identified: int
    delay_s: Uncertain
    touched: float
    """The part of the samples that is left out, since something is touched in them, 0 to 1."""
    read_times: ReadTimes
    held_out: HeldOutTorque
    misfit: str | None
    notes: list[str]
    text: str
    """The file for `Robot(..., arm=...)`."""


class TouchTorques(TypedDict):
    """External torques of a touch of T frames."""

    name: str
    time: NDArray[np.float64] | None
    q: NDArray[np.float64]
    torque: NDArray[np.float64]
    std: NDArray[np.float64]
    statistic: NDArray[np.float64]
    threshold: float | None
