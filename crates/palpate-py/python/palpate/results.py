"""Types of the dicts that long calls return."""

from __future__ import annotations

from typing import Any, Literal, TypedDict

import numpy as np
from numpy.typing import NDArray


class Errors(TypedDict):
    """The four figures of the paper's Table I; None if there is no frame.

    The error of a frame is the norm |predicted - measured| over all joints, N·m; the relative error is
    this divided by |measured|, on frames of at least 1 N·m.
    """

    avg_error: float | None
    max_error: float | None
    avg_relative: float | None
    max_relative: float | None


class Beside(Errors):
    """Errors, with those of predicting zero on the same frames."""

    zero: Errors


class MappedTouch(TypedDict):
    """Figures of one learnt touch."""

    name: str
    log: str
    frames: int
    tare_frames: int
    frames_in_contact: int


class MapReport(TypedDict):
    """Result of `Mapper.map`, as `palpate map --json` prints it."""

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
    """Errors of predicting every frame just before it was learnt."""


class ScoredFrames(Beside):
    """Errors over frames, and numbers of frames."""

    frames: int
    frames_in_log: int
    tare_frames: int
    relative_frames: int
    frames_in_contact: int
    frames_on_known: int
    learnt: bool
    """Whether these are the samples of a touch (of any touch) that the field remembers: then the errors are not those
    of new touches. False also if the field has forgotten the samples, or has no memory."""


class ScoredTouch(ScoredFrames):
    """One touch of a `Score`, with its torques: T scored frames."""

    name: str
    log: str
    frame: NDArray[np.uint64]
    """Number of each scored frame in its touch, (T,)."""
    time: NDArray[np.float64] | None
    """Time by the log's clock, s, (T,)."""
    contacts: NDArray[np.uint64]
    """Number of cells touched, (T,)."""
    predicted: NDArray[np.float64]
    """External torque predicted by the field, N·m, (T, n_joints)."""
    external: NDArray[np.float64]
    """Measured external torque, or the true one, N·m, (T, n_joints)."""
    half_width: NDArray[np.float64] | None
    """Half-width of the band around `predicted` (level as in `Answer`), N·m, (T, n_joints); None without bands."""


class Coverage(TypedDict):
    """Share of torques inside of bands, and widths of the bands."""

    level: float
    torque_share: float
    """Share of the torques (of each joint in each frame) inside of the band at `level`."""
    by_level: list[list[float]]
    """This share at other levels: pairs of level and share."""
    peak_share: float
    """Share of the largest torques (of each joint in each touch) inside of the band for them."""
    half_width_n_m: float
    constant_half_width_n_m: float
    """Half-width of a band of constant width with the same share inside, N·m."""
    classes: list[list[float] | None]
    """Share inside and mean half-width, N·m: no contact, mostly known cells, mostly untouched cells."""


class Score(TypedDict):
    """Result of `Field.score`, as `palpate predict --json` prints it."""

    touches: list[ScoredTouch]
    overall: ScoredFrames
    against: str
    bands: Coverage | None
    """None if the field has no bands, or with `truth`."""


class Place(TypedDict):
    """Region of the cells where torques were outside of their bands."""

    centre_m: list[float]
    radius_m: float
    """Root mean square distance of the touched cells from the centre, m."""
    cells: int


class RelativeErrors(TypedDict):
    """Errors relative to those of predicting zero."""

    field: float | None
    scaled: float | None
    """With the field scaled by the best factor in the touches that contradict it; None if none does."""
    moved: float | None
    """With the field moved in the best way; None if nothing contradicts the field."""
    repeated: float | None
    """Of the torques measured in the earlier touches that these repeat; None if they repeat none."""


class Change(TypedDict, total=False):
    """How far the object has moved, or the factor by which it is softer or harder."""

    factor: float
    shift_m: list[float]
    """Translation after a rotation by `turn_rad` about the vertical through `about_m`, m."""
    turn_rad: float
    about_m: list[float]


class Comparison(Change):
    """Touches compared with a field, as `palpate compare --json` prints it."""

    change: str
    """"unchanged", "moved", "softer", "harder", "other", or "unknown" if few of these cells were touched before."""
    known: float
    """Share of the contacts at cells that were touched when the field was learnt."""
    contradiction: float
    """Above 1, the touches contradict the field."""
    repeats: list[str]
    """The remembered touches whose paths these touches repeat; of several touches, some may repeat none."""
    error: RelativeErrors
    place: Place | None


class ComparedTouch(Comparison):
    """One touch compared with a field."""

    name: str
    log: str


class Comparisons(TypedDict):
    """Result of `Field.compare`."""

    touches: list[ComparedTouch]
    together: Comparison


class Proposal(TypedDict):
    """A proposed motion, in the order in which the motions should be made."""

    name: str
    log: str
    candidate: int
    """Index among the candidates."""
    variance_left: float
    """Remaining share of the variance of the task after this and all earlier proposals."""
    information_nats: float
    """Information that this motion adds after the earlier proposals, nats."""
    unknown: float
    """Share of its contacts at cells never touched."""
    torque_n_m: float
    """Largest predicted torque of a joint, N·m."""
    with_band_n_m: float
    """This torque plus the half-width of its band, or plus two standard deviations of the springs, N·m."""


class BeyondLimit(TypedDict):
    """A motion whose torque may exceed the limit."""

    name: str
    with_band_n_m: float


class BeyondJointLimits(TypedDict):
    """A motion in which a joint exceeds its limits."""

    name: str
    joint: str
    """The joint that is furthest beyond its limits."""
    position: float
    """Its position there, rad or m."""
    limits: list[float | None]
    """Its lower and upper limit in the URDF, rad or m; None for no limit."""


class Proposals(TypedDict):
    """Result of `Field.next`, as `palpate next --json` prints it."""

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
    """Coverage of the bands; None for a method without bands."""
    coverage_of_other_objects: Coverage | None
    """Coverage of bands that were calibrated on other objects."""


class HeldOutTouch(TypedDict):
    """A held-out touch: T frames, beginning after its tare."""

    name: str
    fold: int
    time: NDArray[np.float64]
    """Time since the first of these frames, s (frame numbers if the log has no clock), (T,)."""
    contacts: NDArray[np.uint32]
    """Number of cells touched, (T,)."""
    known: NDArray[np.uint32]
    """Number of these cells that were touched in the training touches, (T,)."""
    q: NDArray[np.float64]
    """Joint positions, rad, (T, n_joints)."""
    external: NDArray[np.float64]
    """External torque to predict, N·m, (T, n_joints)."""
    predicted: dict[str, NDArray[np.float64]]
    """Predicted external torque by method, N·m, (T, n_joints)."""
    errors: dict[str, Errors | None]
    """Errors by method."""


class Evaluation(TypedDict):
    """Result of `evaluate`."""

    methods: list[MethodRow]
    touches: list[HeldOutTouch]
    against: str
    joint_names: list[str]
    tuned: list[dict[str, Any]] | None
    """Settings of map and ekf in each fold; None if they were not tuned."""


class Share(Evaluation):
    """Result of `evaluate` for a share of the folds."""

    bands: list[dict[str, Any]]
    """By touch and method, the data from which the coverage over all folds is computed."""


class Trial(TypedDict):
    """One candidate of `tune`, with its score after each round in which it took part."""

    settings: dict[str, Any]
    scores: list[float]


class Tuned(TypedDict):
    """Result of `tune`."""

    settings: dict[str, dict[str, Any]]
    """Sections, to give as `settings=` to other calls."""
    toml: str
    """The same settings, as the content of a file for `--settings`."""
    trials: list[Trial]


class _Finding(TypedDict):
    level: Literal["warning", "error"]
    """An error makes learning refuse the log."""
    code: str
    """An identifier that stays the same between versions."""
    what: str
    """Description, with numbers."""
    remedy: str
    """How to correct it."""


class Finding(_Finding, total=False):
    """One thing that looks wrong with a log."""

    touches: list[str]
    """The touches concerned, if not all."""
    parts: list[str]
    """The joints concerned."""
    flags: list[str]
    """Flags of the command that would correct it."""


class Clock(TypedDict):
    """The clock of a log."""

    period_s: float
    """Median time step, s."""
    jitter_s: float
    """90 % quantile of the deviation of time steps from the median, s."""
    duration_s: float
    """Total duration of all touches, s."""


class Fit(TypedDict):
    """How well gravity explains the torques at rest, for one choice of sign and gravity."""

    torque_sign: Literal["plus", "minus"]
    gravity: Literal["included", "removed"]
    left_over: float
    """Residual, N·m over all joints."""
    slope: float
    """Slope of the regression of the torques, with this sign, on those of gravity."""


class Fits(TypedDict):
    """Comparison of the choices of sign and gravity."""

    set: Fit
    """The choice of the settings."""
    best: Fit
    """The choice with the smallest residual."""
    gravity_torque: float
    """Torque of gravity at rest, N·m over all joints."""
    at_rest: bool
    """Whether some touch begins at rest; if not, the figures are from any frames."""
    by_work: bool
    """Whether the sign of `best` was found from the work of torques without gravity, and differs from that of `set`."""


class PayloadEstimate(TypedDict):
    """A payload that would explain the residual after gravity."""

    link: str
    mass_kg: float
    com_link_m: list[float]


class Reading(TypedDict):
    """How a log should be read."""

    angle_unit: Literal["rad", "deg"]
    order: list[int] | None
    """Index of each joint of the robot in the log, if the order seems to differ from the robot's."""
    torque_sign: Literal["plus", "minus"]
    gravity: Literal["included", "removed"]
    unexplained_share: float | None
    """Unexplained torque at rest, as a share of gravity; None if gravity is too small to determine it."""
    payload: PayloadEstimate | None
    fits: Fits


class LatticeFigures(TypedDict):
    """The lattice in which contacts are computed."""

    origin_m: list[float]
    spacing_m: float
    shape: list[int]
    box_m: list[list[float]]
    """Low and high corner."""
    cells_declared: int


class TouchedFigures(TypedDict):
    """Figures of the contacts of a log, counted as in `MapReport`."""

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
    """Number of frames from the first on in which the arm is at rest or without contact."""
    frames_in_contact: int
    tare: list[float] | None
    """Tare, N·m; None without tare frames."""
    noise_std: list[float] | None
    """Standard deviation of the torque at the start, N·m; None if the start is too short."""
    peak_external: float
    """Largest external torque, N·m over all joints."""
    peak_by_joint: list[float]
    """Largest external torque of each joint, N·m."""
    range: list[list[float]]
    """Lowest and highest position of each joint, (n_joints, 2), rad or m."""
    end_external: list[float] | None
    """External torque at the end, N·m, if the arm is back at its start."""
    work_until_peak_j: float
    """Work that the external torque does on the arm, J."""


class Columns(TypedDict):
    """Names of the columns read from a table."""

    q: list[str]
    tau: list[str]
    joints: list[str] | None
    time: str | None
    touch: str | None


class InspectedLog(TypedDict):
    """Content of a log."""

    format: str
    columns: Columns | None
    """None if the log is not a table."""
    robot: str
    frames: int
    clock: Clock | None
    joints: list[str]
    matching: Literal["unnamed", "in_order", "reordered", "unmatched"]
    """How the joints of the log were matched to those of the robot."""
    reading: Reading | None
    """None if the joints do not match the robot's."""
    lattice: LatticeFigures
    touched: TouchedFigures | None
    """None if the joints do not match the robot's."""
    touches: list[InspectedTouch]


class Inspection(TypedDict):
    """Result of `inspect`."""

    log: InspectedLog | None
    """None if nothing can be read."""
    findings: list[Finding]
    """Errors first."""


class Uncertain(TypedDict):
    """A value with its standard deviation."""

    value: float
    std: float


class IdentifiedPayload(TypedDict):
    """Payload of an arm beyond its URDF."""

    link: str
    mass_kg: Uncertain
    com_m: list[Uncertain]
    inertia_kg_m2: list[list[float]]
    is_significant: bool
    """Whether the mass is more than twice its standard deviation."""


class IdentifiedJoint(TypedDict):
    """Identified parameters of a joint."""

    name: str
    moved: float
    coulomb_n_m: Uncertain
    asymmetry_n_m: Uncertain
    breakaway_n_m: Uncertain
    is_breakaway_separable: bool
    """Whether breakaway is distinguished from how friction changes in reversals."""
    viscous_n_m_s: Uncertain
    rotor_inertia_kg_m2: Uncertain
    bias_n_m: Uncertain
    gain: Uncertain
    presliding_rad: float
    ripple_orders: list[float]
    hysteresis_n_m: float
    at_zero: list[str]
    """Names of the values above that would be negative, and are held at zero; their `std` says nothing."""


class IdentifiedBody(TypedDict):
    """Links that move together: ten inertial parameters, and by how much the variance of each was reduced."""

    link: str
    parameters: list[Uncertain]
    variance_reduction: list[float]


class ReadTimes(TypedDict):
    """Correction of stamps that differ from the times at which the joints were read."""

    corrected: int
    """Number of touches whose times were corrected."""
    rms_s: float
    """Root mean square of the correction, s, without the part common to all samples of a touch."""


class FewSamples(TypedDict):
    """Outliers of the residual: at most 1 % of the samples, with at least half of the sum of squares."""

    samples: int
    of: int
    """Number of held-out samples."""
    share: float
    """Their share of the sum of squares, 0 to 1."""
    largest: float
    """Largest residual, norm over the joints, N·m."""
    touch: int
    """Number of the touch with the largest part of their squares."""
    rows: list[int]
    """Rows of the first and the last of them in this touch, from 0."""
    without: list[float]
    """Residual without them, N·m over all joints: after gravity of the URDF, and after the identified arm."""


class HeldOutTorque(TypedDict):
    """Root mean square of the residual on held-out motion, N·m by joint."""

    gravity: list[float]
    urdf: list[float]
    identified: list[float]
    slow: list[list[float]]
    """The same three, for residuals averaged over the time window of speeds."""
    few: FewSamples | None


class Identified(TypedDict):
    """Result of `identify`."""

    payload: IdentifiedPayload
    joints: list[IdentifiedJoint]
    bodies: list[IdentifiedBody]
    base_parameters: int
    base_parameters_identified: int
    delay_s: Uncertain
    touched: float
    """Share of the samples that is left out because of contact, 0 to 1."""
    read_times: ReadTimes
    held_out: HeldOutTorque
    misfit: str | None
    notes: list[str]
    text: str
    """Content of the file for `Robot(..., arm=...)`."""


class Excited(TypedDict):
    """Result of `excite`: a motion of T points."""

    joint_names: list[str]
    time: NDArray[np.float64]
    q: NDArray[np.float64]
    velocity: NDArray[np.float64]
    acceleration: NDArray[np.float64]
    points: int
    condition: float
    condition_of_first: float
    """Condition number of the first motion that kept to the limits."""
    speed_share: float
    torque_share: float
    lowest_m: float | None
    """Lowest point of the moving arm in the frame of the base, if its links have shapes."""
    nearest_m: float | None
    """Least distance between links that are not neighbours, if there are any with shapes."""
    csv: str
    """Content of the file of a table."""
    yaml: str
    """Content of the file of a trajectory_msgs/JointTrajectory."""


class TouchTorques(TypedDict):
    """External torques of a touch of T frames."""

    name: str
    time: NDArray[np.float64] | None
    q: NDArray[np.float64]
    torque: NDArray[np.float64]
    std: NDArray[np.float64]
    statistic: NDArray[np.float64]
    threshold: float | None
    wrench: NDArray[np.float64] | None
    """Force, N, and moment, N·m, at the origin of `wrench_link`, (T, 6)."""
