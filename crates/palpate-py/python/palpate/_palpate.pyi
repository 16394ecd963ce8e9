"""The compiled part of `palpate`."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Literal, TypeAlias, final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from typing_extensions import Unpack

from ._progress import Progress
from .results import (
    Comparisons,
    Errors,
    Evaluation,
    Excited,
    Identified,
    Inspection,
    MapReport,
    MethodRow,
    Proposals,
    Score,
    TouchTorques,
    Tuned,
)
from .settings import (
    AnySettings,
    ContactSettings,
    FieldSections,
    LearningSections,
    LogSettings,
    RobotSettings,
    Sections,
    Settings,
)
from .settings import Path as _Path

__all__ = [
    "Answer",
    "Extrapolation",
    "Field",
    "FileError",
    "Lattice",
    "Log",
    "LogError",
    "Mapper",
    "PalpateError",
    "PalpateWarning",
    "PathPredictor",
    "Robot",
    "SettingsError",
    "StepReport",
    "Touch",
    "TouchError",
    "TouchIterator",
    "command",
    "cpus",
    "default_settings",
    "evaluate",
    "excite",
    "external_torques",
    "extrapolate",
    "given_settings",
    "identify",
    "inspect",
    "map_elastic",
    "open_log",
    "summarised",
    "threads",
    "tune",
    "unpickled_field",
]

_Logs: TypeAlias = _Path | Log | Touch | Sequence[_Path | Log | Touch]

class PalpateError(Exception):
    """Base class of the errors of palpate."""

class SettingsError(PalpateError):
    """Settings or arguments that are invalid or contradict each other."""

class LogError(PalpateError):
    """A log that cannot be read, or that looks wrong while `strict` is set."""

class FileError(PalpateError):
    """A robot, field or other file that is missing or invalid, or cannot be written."""

class TouchError(PalpateError):
    """A sample, a touch or a path that cannot be used."""

class PalpateWarning(UserWarning):
    """Something looks wrong, though it did not stop the work."""

@final
class Robot:
    """A robot arm with the surfaces of its links.

    `name_or_urdf` is the path of a URDF or the name of a built-in robot, `kinova_gen3` if left out;
    `packages` are folders of ROS packages for `package://` paths of meshes. `options` are the other
    keys of `palpate.settings.RobotSettings`, such as a payload. Meshes are converted to grids of signed
    distances at the first use; these are cached.

    Raises FileError if there is no such robot or its files are broken.
    """

    def __new__(
        cls,
        name_or_urdf: _Path | None = None,
        packages: Sequence[_Path] | None = None,
        **options: Unpack[RobotSettings],
    ) -> Robot: ...
    @property
    def name(self) -> str:
        """Name of the robot in its URDF."""
    @property
    def joint_names(self) -> list[str]:
        """Names of the moving joints, in the order of all joint positions and torques."""
    @property
    def link_names(self) -> list[str]:
        """Names of the links."""
    @property
    def n_joints(self) -> int:
        """Number of moving joints."""
    @property
    def files(self) -> list[Path]:
        """Files that it was read from: URDF and meshes, unless it is built in, and the arm file, if any."""
    @property
    def limits(self) -> NDArray[np.float64]:
        """Lowest and highest position of each joint, (n_joints, 2), rad (m where prismatic); infinite if unlimited."""
    def gravity(self, q: ArrayLike) -> NDArray[np.float64]:
        """Torque of gravity on the joints at positions `q` (n_joints,) rad: (n_joints,) N·m."""
    def forward(self, q: ArrayLike, link: str) -> NDArray[np.float64]:
        """Pose of a link at positions `q` (n_joints,) rad: `world_from_link`, (4, 4), m."""
    def __getnewargs_ex__(self) -> tuple[tuple[()], dict[str, Any]]: ...

@final
class Lattice:
    """Points at equal spacing in a box, in the frame of the robot's base.

    `origin` is the first point (3,) m, `spacing` the distance between neighbours in m, `shape` the
    number of points along x, y and z. The cell number of a point runs fastest along x.
    """

    def __new__(cls, origin: ArrayLike, spacing: float, shape: ArrayLike) -> Lattice: ...
    @staticmethod
    def filling(low: ArrayLike, high: ArrayLike, spacing: float) -> Lattice:
        """The lattice that fills the box from corner `low` to `high` (3,) m, every `spacing` m."""
    @property
    def origin(self) -> list[float]:
        """First point, m."""
    @property
    def spacing(self) -> float:
        """Distance between neighbouring points, m."""
    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of points along x, y and z."""
    @property
    def n_cells(self) -> int:
        """Number of points."""
    def cells(self, points: ArrayLike, /) -> NDArray[np.int64]:
        """The cell nearest to each of `points` (M, 3) m: (M,), -1 outside the box."""
    def points(self, cells: ArrayLike, /) -> NDArray[np.float64]:
        """The rest point of each of `cells` (M,): (M, 3) m."""
    def __eq__(self, other: object, /) -> bool: ...
    def __hash__(self) -> int: ...
    def __getnewargs__(self) -> tuple[list[float], float, list[int]]: ...

@final
class Touch:
    """One touch: an approach, a push and a retreat, T frames.

    `q` are joint positions (T, n_joints) rad, `tau` joint torques as logged (T, n_joints) N·m,
    `time` (T,) s. `joint_names` are the joints of the columns; in the robot's order if left out.
    """

    def __new__(
        cls,
        q: ArrayLike,
        tau: ArrayLike,
        name: str = "touch",
        time: ArrayLike | None = None,
        joint_names: Sequence[str] | None = None,
    ) -> Touch: ...
    @property
    def name(self) -> str:
        """Name of the touch."""
    @property
    def q(self) -> NDArray[np.float64]:
        """Joint positions, (T, n_joints), rad (m where prismatic)."""
    @property
    def tau(self) -> NDArray[np.float64]:
        """Joint torques as logged, (T, n_joints), N·m."""
    @property
    def time(self) -> NDArray[np.float64] | None:
        """Time by the log's clock, (T,), s; None if the log has no clock."""
    @property
    def joint_names(self) -> list[str] | None:
        """Names of the joints in the order of the columns; None if the log does not contain them."""
    def __len__(self) -> int: ...
    def __getnewargs__(self) -> tuple[Any, ...]: ...

@final
class Log:
    """Touches in files, read as a stream: iterating yields one `Touch` after another.

    `open_log` returns it. Only the current touch is in memory; each `for` begins with the first.
    """

    @property
    def paths(self) -> list[str]:
        """Paths of the log."""
    def __iter__(self) -> TouchIterator: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

@final
class TouchIterator:
    """The touches of a log, one after another."""

    def __iter__(self) -> TouchIterator: ...
    def __next__(self) -> Touch: ...

def command(arguments: Sequence[str], call: Sequence[str]) -> int:
    """Runs the command `palpate` in this process, and returns its exit code.

    `arguments`: the command's name and its arguments. `call`: the command line that starts this process
    again, without the arguments of the command.
    """

def cpus() -> int:
    """Number of CPUs that this process may use, by its affinity and its control group."""

def threads() -> int:
    """Number of threads of long calls in this process: RAYON_NUM_THREADS at the time of the first one."""

def open_log(path: _Path | Log | Sequence[_Path | Log], **options: Unpack[LogSettings]) -> Log:
    """Opens one or more logs, which are read as one.

    A log is a folder of one touch (angles.npy, torques.npy), a folder of such folders, a .csv file
    or a folder of them, a bag of ROS 2 (MCAP, SQLite) or Parquet. `options` are the keys of
    `palpate.settings.LogSettings`; splitting at pauses (`split_idle`) needs a robot, and is done by
    the function that uses the log.

    Raises LogError, which names the file and the remedy.
    """

@final
class StepReport:
    """Result of one sample."""

    @property
    def contacts(self) -> int:
        """Number of cells touched."""
    @property
    def external(self) -> NDArray[np.float64] | None:
        """External torque, with gravity and tare subtracted, (n_joints,) N·m; None while taring."""
    @property
    def predicted(self) -> NDArray[np.float64] | None:
        """External torque predicted before the sample was learnt, (n_joints,) N·m; None while taring."""

@final
class PathPredictor:
    """A copy of a field and of the arm's contacts, to predict the torque of motions.

    `Field.path_predictor` and `Mapper.path_predictor` return it. It never changes, and threads may share it.
    """

    @property
    def n_joints(self) -> int:
        """Number of joints: columns of a path."""
    def ask(
        self,
        path: ArrayLike,
        resolution_cells: float | None = None,
        start_cells: float | None = None,
        inside: bool = False,
    ) -> Answer:
        """Predicts the external torque along a motion: `path` is (P, n_joints) rad.

        Arguments are those of `Mapper.ask`. A path that does not continue from the contacts of the arm starts
        free of contact: cells that the links cover at its first point count as empty. With `inside`, these cells
        are pushed out to the nearest surface instead: for a posture, or a piece of a path, in the object.

        Raises TouchError if the path cannot be followed.
        """
    def ask_all(
        self,
        paths: Iterable[ArrayLike],
        resolution_cells: float | None = None,
        start_cells: float | None = None,
        inside: bool = False,
    ) -> list[Answer]:
        """Predicts the external torque along several motions in parallel; results are identical to those of `ask`.

        Raises TouchError, with the number of the path, if one cannot be followed.
        """

@final
class Answer:
    """Predicted torques along a path of P points."""

    @property
    def torque(self) -> NDArray[np.float64]:
        """Predicted external torque, (P, n_joints), N·m."""
    @property
    def torque_std(self) -> NDArray[np.float64]:
        """Standard deviation of `torque` from the uncertainty of the springs alone, (P, n_joints), N·m.

        Use it to rank paths by how well their torque is known; it is no bound of the error.
        """
    @property
    def half_width(self) -> NDArray[np.float64] | None:
        """Half-width of the band around `torque`, (P, n_joints), N·m; None if the field has no bands.

        Its level is 90 %, or the highest level of the field if that is lower.
        """
    @property
    def peak_half_width(self) -> NDArray[np.float64] | None:
        """As `half_width`, of the band for the largest torque of a joint along the path, (P, n_joints), N·m."""
    @property
    def contacts(self) -> NDArray[np.uint64]:
        """Number of cells touched, (P,)."""
    @property
    def known(self) -> NDArray[np.uint64]:
        """Number of these cells that were touched when the field was learnt, (P,)."""
    @property
    def goes_on(self) -> bool:
        """Whether the path continued from the arm's contacts, rather than free of contact."""
    @property
    def stops(self) -> int:
        """Number of points at which contacts were computed; torques at the others are interpolated."""

@final
class Mapper:
    """Learns a stiffness field from touches.

    `robot` is a `Robot`, a name or a path; `method` is `map`, the exact maximum a posteriori, or
    `ekf`, the paper's filter. `settings` are those of the command: the path of a TOML file or a dict
    of its sections; `sections` override them, such as `contact={"friction": 0.3}` or
    `lattice=Lattice(...)`; `palpate.settings` has all keys. `prior` is a field whose prior means, or else
    learnt stiffness, are the prior means of the cells. Threads that use the same mapper wait for each other.

    Raises SettingsError if a setting is unknown or out of its range.
    """

    def __new__(
        cls,
        robot: Robot | _Path | None = None,
        method: str | None = None,
        settings: AnySettings | None = None,
        prior: Field | None = None,
        **sections: Unpack[Sections],
    ) -> Mapper: ...
    @staticmethod
    def load(
        path: _Path,
        robot: Robot | _Path | None = None,
        settings: AnySettings | None = None,
        **sections: Unpack[Sections],
    ) -> Mapper:
        """Resumes mapping from a field that `save` or `palpate map` wrote, as if it had not been interrupted.

        Settings, if given, must agree with those of the field. Raises PalpateError if the field was saved
        without its memory or learnt with another robot.
        """
    @staticmethod
    def from_field(
        field: Field,
        robot: Robot | _Path | None = None,
        settings: AnySettings | None = None,
        **sections: Unpack[Sections],
    ) -> Mapper:
        """Resumes mapping from a field with memory, as `load` does from a file."""
    @property
    def robot(self) -> Robot:
        """The arm."""
    @property
    def method(self) -> str:
        """`map` or `ekf`."""
    @property
    def config(self) -> dict[str, Any]:
        """The complete configuration, in the form that the field's file contains."""
    def begin_touch(self, name: str = "") -> None:
        """Starts a touch: the next samples belong to it, and the first of them give the tare.

        `Field.without` can forget the touch by its name.
        """
    def step(self, q: ArrayLike, tau: ArrayLike, time: float | None = None) -> StepReport:
        """Learns from one sample: `q` (n_joints,) rad, `tau` (n_joints,) N·m as logged, `time` in s. A sample
        within 45 ms of the last learnt one is only predicted. Without times, samples between which the fastest
        joint moves less than 2 mrad are thinned out.

        Raises TouchError if the sample cannot be used; nothing is then learnt from it.
        """
    def end_touch(self) -> None:
        """Ends the touch. Raises TouchError if it had fewer samples than the tare of the settings."""
    def map(self, log: _Logs, progress: Progress = None) -> MapReport:
        """Learns the touches of logs, given by path, as `Log` or as `Touch`, in their order.

        The field is identical to that of `palpate map --tune=off`. `progress` is None for a bar if a terminal
        or notebook shows it, True, False, or a callable that gets the numbers of frames done and in total.
        Ctrl-C raises KeyboardInterrupt; the mapper has then learnt all earlier samples and can continue.
        """
    def choose_settings(self, progress: Progress = None) -> str:
        """Chooses the settings that were not given, by cross-validation on the touches in memory as `palpate map` does, and
        learns these touches again with them.

        This takes about ten seconds for eleven touches. Meanwhile other threads can use the mapper; what they learn is
        kept. Returns what was chosen, in one line. `progress` is as in `map`. Raises PalpateError, and changes nothing, if
        the method is `ekf`, the mapper continues a field, cells have their own prior means, fewer than three touches meet
        something, touches hardly predict each other or follow the arm's own motion, or some are no longer in memory.
        """
    def field(self) -> Field:
        """A copy of the present field with its memory; later samples do not change it."""
    def ask(
        self,
        path: ArrayLike,
        resolution_cells: float | None = None,
        start_cells: float | None = None,
    ) -> Answer:
        """Predicts the external torque along a motion: `path` is (P, n_joints) rad.

        Joints move linearly from point to point. During a touch, a path continues from the present contacts
        if no point of the arm is further than `start_cells` cells from its place at the start of the path; any
        other path starts free of contact. Contacts are computed at stops at most `resolution_cells` cells
        apart, and torques between them are interpolated; with 0, every point is a stop.

        Raises TouchError if the path cannot be followed.
        """
    def path_predictor(self, coarse: bool = False) -> PathPredictor:
        """A copy of the present field and contacts, to predict the torque of many motions.

        With `coarse`, each cluster of cells is one spring: this is several times faster, and torques differ
        by some percent.
        """
    def save(self, path: _Path, memory: bool = True) -> None:
        """Writes the field as .npz, never partially; without `memory`, mapping cannot be resumed from it."""

@final
class Field:
    """The stiffness of N cells that were touched or have a prior of their own.

    Arrays are read-only and share the memory of the field; each access returns the same object.
    """

    @staticmethod
    def load(path: _Path) -> Field:
        """Reads a field that `save` or `palpate map` wrote. Raises FileError."""
    def save(self, path: _Path, memory: bool = True) -> None:
        """Writes the field as .npz, never partially; `memory` is whether to include its memory, if it has one."""
    @staticmethod
    def from_arrays(
        points: ArrayLike,
        stiffness: ArrayLike,
        std: ArrayLike | None = None,
        counts: ArrayLike | None = None,
        *,
        lattice: Lattice,
        untouched: float = 0.0,
        robot: str = "kinova_gen3",
        settings: AnySettings | None = None,
        **sections: Unpack[FieldSections],
    ) -> Field:
        """A field from arrays: `points` (N, 3) m, `stiffness` (N,) N/m, `std` (N,) N/m, `counts` (N,).

        Points must be points of `lattice`, each at most once; `Lattice.cells` finds the nearest.
        `std` is 0 and `counts` 1 if left out; a count of 0 means that a stiffness is only a prior.
        `untouched` is the stiffness of all other cells, N/m. The contact model, and sign, gravity and
        tare of torques, are those of the settings. Raises ValueError, which names the array and the row.
        """
    @property
    def points(self) -> NDArray[np.float64]:
        """Rest points, (N, 3), m, frame of the robot's base."""
    @property
    def stiffness(self) -> NDArray[np.float64]:
        """K of each point, (N,), N/m, never negative."""
    @property
    def std(self) -> NDArray[np.float64]:
        """Standard deviation of K, (N,), N/m."""
    @property
    def counts(self) -> NDArray[np.uint32]:
        """Number of frames that touched each cell, (N,); 0 if its stiffness is only a prior."""
    @property
    def cells(self) -> NDArray[np.uint32]:
        """Cell number of each point in the lattice, (N,)."""
    @property
    def prior(self) -> NDArray[np.float64] | None:
        """Prior mean of K, (N,), N/m; None if it is the same for all cells."""
    @property
    def lattice(self) -> Lattice:
        """The lattice that contains the cells."""
    @property
    def contact(self) -> ContactSettings:
        """Settings of the contact model with which it was learnt, in the form of `contact=`."""
    @property
    def robot_name(self) -> str:
        """Name of the robot with which it was learnt."""
    @property
    def untouched(self) -> float:
        """K of all other cells, N/m."""
    @property
    def has_memory(self) -> bool:
        """Whether the field has its memory, so that mapping can be resumed and touches can be forgotten."""
    def query(
        self, points: ArrayLike
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.uint32]]:
        """Stiffness (M,) N/m, its std (M,) N/m and counts (M,) of the cells at `points` (M, 3) m.

        Cells never touched have stiffness and std of the prior (std NaN if the field has no memory) and a
        count of 0; outside of the lattice, stiffness and std are NaN.
        """
    def predict(
        self, q_path: ArrayLike, robot: Robot | _Path | None = None, progress: Progress = None
    ) -> NDArray[np.float64]:
        """Predicts the external torque along a motion: `q_path` (T, n_joints) rad gives (T, n_joints) N·m.

        The motion starts free of contact, and every row is a step, as in `palpate predict`. If `robot` is
        left out, it is loaded by `robot_name`.
        """
    def path_predictor(
        self, robot: Robot | _Path | None = None, *, coarse: bool = False
    ) -> PathPredictor:
        """A copy of the field, to predict the torque of many motions of an arm.

        If `robot` is left out, it is loaded by `robot_name`. With `coarse`, each cluster of cells is one
        spring: this is several times faster, and torques differ by some percent.
        """
    def score(
        self,
        log: _Logs,
        robot: Robot | _Path | None = None,
        *,
        truth: bool = False,
        settings: AnySettings | None = None,
        progress: Progress = None,
        **sections: Unpack[FieldSections],
    ) -> Score:
        """Predicts the touches of logs and compares with the measured torque, as `palpate predict` does.

        `truth` compares with the true torques that are stored beside simulated touches. The settings may
        change how the log is read (`log`), and sign, gravity and tare of its torques (`touch`).
        """
    def compare(
        self,
        log: _Logs,
        robot: Robot | _Path | None = None,
        *,
        settings: AnySettings | None = None,
        progress: Progress = None,
        **sections: Unpack[FieldSections],
    ) -> Comparisons:
        """Tests whether touches of logs contradict the field, and what has changed, as `palpate compare` does.

        The settings may change how the log is read (`log`), and sign, gravity and tare of its torques
        (`touch`). Raises FileError if no touches were held out when the field was learned.
        """
    def next(
        self,
        candidates: Sequence[ArrayLike],
        task: Sequence[ArrayLike] | None = None,
        *,
        box: Sequence[Sequence[float]] | None = None,
        by: str = "variance",
        count: int = 5,
        limit: float | None = None,
        robot: Robot | _Path | None = None,
        progress: Progress = None,
    ) -> Proposals:
        """Ranks candidate motions by how much they would teach, the best first, as `palpate next` does.

        Each is ranked as if those before it were already made. `candidates` are the possible motions,
        (T, n_joints) rad each; `task` are the motions whose torques are to be predicted, by default the
        candidates. With `box`, a pair of corners, m, the stiffness in this box is to be known instead. `by`
        is the criterion, "variance" or "information". Motions are excluded if their predicted torque may
        exceed `limit`, N·m, or if a joint exceeds its limits. With an elastic body, `limit` needs bands.
        """
    def without(
        self,
        touches: Sequence[str] | None = None,
        *,
        older_than: int | None = None,
        box: Sequence[Sequence[float]] | None = None,
        robot: Robot | _Path | None = None,
        progress: Progress = None,
    ) -> Field:
        """A copy of the field in which some of its touches were never learnt, as `palpate forget` makes it.

        Forgotten are the `touches` with these names or numbers (such as "#3"), all touches before the last
        `older_than`, and those that touched a cell in `box`, a pair of corners, m. Raises PalpateError if the
        field has no memory, or the other touches cannot all be learnt again.
        """
    def __len__(self) -> int: ...
    def __reduce__(self) -> tuple[Any, tuple[bytes]]: ...

def evaluate(
    logs: _Logs,
    robot: Robot | _Path | None = None,
    *,
    methods: Sequence[str] | None = None,
    cloud: _Path | ArrayLike | Sequence[_Path] | Sequence[ArrayLike] | None = None,
    colours: ArrayLike | Sequence[ArrayLike] | None = None,
    viewpoint: ArrayLike | None = None,
    object_kind: Literal["plant", "cushion"] | None = None,
    root: ArrayLike | None = None,
    folds: int | None = None,
    test: Sequence[str] | None = None,
    truth: bool = False,
    tune: bool | Literal["quick"] | None = None,
    share: tuple[int, int] | None = None,
    reuse: str | None = None,
    settings: AnySettings | None = None,
    progress: Progress = None,
    **sections: Unpack[Sections],
) -> Evaluation:
    """Compares methods on held-out touches, as `palpate evaluate` does.

    `methods` are some of elastic, map, ekf, mlp, gp, knn, uniform and zero, all if left out; zero is
    always added. elastic needs a `cloud` of the object, with `colours`, `viewpoint`, `object_kind` and
    `root` as for `map_elastic`. The touches are divided into `folds`, one for each touch if left out;
    those of a fold are predicted from all others. With `test`, only the touches of these names are
    predicted, from all others. `truth` compares with true torques.

    `tune` chooses settings in every fold: "quick", also if left out, those of map that are not given,
    among few candidates; True those of map and ekf, among many; False none. `share` is a number from 0
    and the number of shares: only this share of the folds is computed, and the result is a
    `palpate.results.Share`. `reuse` is a name for logs and robot in their present state: data that was
    read by the last call with the same name is used again, if the settings allow it.
    """

def map_elastic(
    logs: _Logs | None,
    cloud: _Path | ArrayLike | Sequence[_Path] | Sequence[ArrayLike],
    colours: ArrayLike | Sequence[ArrayLike] | None = None,
    robot: Robot | _Path | None = None,
    *,
    viewpoint: ArrayLike | None = None,
    object_kind: Literal["plant", "cushion"] | None = None,
    root: ArrayLike | None = None,
    settings: AnySettings | None = None,
    progress: Progress = None,
    **sections: Unpack[Sections],
) -> Field:
    """Learns a field with an elastic body from a cloud, as `palpate map --cloud` does.

    `cloud` is the path of a PLY or PCD file with colours, or points (N, 3) m, world frame, with
    `colours` (N, 3) from 0 to 255. `viewpoint` is the position of the camera, (3,) m, estimated from the
    cloud if left out. `object_kind` is "plant" (stems, branches, leaves) or "cushion" (any other soft
    object), also found from the cloud if left out. `root` is the point where a plant is fixed, (3,) m, or
    one for each tree, (R, 3); if left out, where it meets the ground. Clouds of several cameras are a list
    of paths, or lists of arrays for `cloud` and `colours`, with `viewpoint` (C, 3).

    If `logs` is None, the body has the typical stiffness of other plants. A cloud in which nothing
    stands above its lowest point gives a field without a body.
    """

def tune(
    logs: _Logs,
    robot: Robot | _Path | None = None,
    *,
    candidates: int | None = None,
    quick: bool = False,
    settings: AnySettings | None = None,
    progress: Progress = None,
    **sections: Unpack[Sections],
) -> Tuned:
    """Chooses settings by cross-validation on at least three touches, as `palpate tune` does.

    `candidates` is the number of candidates, 2 to 1000, 24 if left out (12 for ekf); `quick` uses only
    few, as `palpate map` does. Other calls take the `settings` of the result.
    """

@final
class Extrapolation:
    """Stiffness estimated at each of N points of a cloud."""

    @property
    def points(self) -> NDArray[np.float64]:
        """Points of the cloud, (N, 3), m."""
    @property
    def stiffness(self) -> NDArray[np.float64]:
        """K of a cell at each point, (N,), N/m."""
    @property
    def std(self) -> NDArray[np.float64]:
        """Standard deviation of K: of the regression over features, not of single points, (N,), N/m."""
    @property
    def touched(self) -> NDArray[np.bool_]:
        """Whether the cell that contains the point was touched, (N,)."""
    @property
    def field(self) -> Field:
        """The field, with the estimates as prior of the untouched cells at points of the cloud."""
    @property
    def method(self) -> str:
        """`torque`, `cells` or `knn`."""
    @property
    def features(self) -> str:
        """Features by which points were compared."""

def extrapolate(
    field: Field,
    cloud: _Path | ArrayLike,
    colours: ArrayLike | None = None,
    robot: Robot | _Path | None = None,
    *,
    method: str | None = None,
    features: str | None = None,
    reach_cells: float | None = None,
    length_scale: float | None = None,
    progress: Progress = None,
) -> Extrapolation:
    """Estimates the stiffness of untouched cells that a camera saw, as `palpate extrapolate` does.

    `cloud` is the path of a PLY or PCD file with colours, or points (N, 3) m with `colours` (N, 3)
    from 0 to 255. `method` is torque (if the field has its memory), cells or knn. If it is left out, it is
    the one of torque and cells that predicts random halves of the remembered touches better; if both
    predict worse than no extrapolation, `field` is returned unchanged, with a warning. `features` are a
    colour (chroma, rgb, oklab), height and shape, joined by `+`.
    """

def inspect(
    log: _Logs,
    robot: Robot | _Path | None = None,
    *,
    settings: AnySettings | None = None,
    progress: Progress = None,
    **sections: Unpack[LearningSections],
) -> Inspection:
    """Reports the content of a log and what looks wrong with it, as `palpate inspect` does.

    `log` is a path, a `Log`, a `Touch`, or several, which are read as one. Torques are compared with
    the gravity of the robot. Contacts are computed as by `Mapper.map`, with lattice and contact model of
    the settings, such as `lattice=Lattice(...)`. `findings` have a `level` (note, warning or error), `what`
    was seen and the `remedy`, errors first. `log` has the figures: units, sign and gravity of the log
    (`reading`), the cells touched (`touched`), and figures of every touch, N·m, s, rad; it is None if
    nothing can be read.

    Raises SettingsError or FileError; defects of the log itself are findings.
    """

def excite(
    robot: Robot | _Path | None = None,
    *,
    start: ArrayLike | None = None,
    duration: float = 20.0,
    rate_hz: float = 100.0,
    speed: float = 0.5,
    torque: float = 0.8,
    ground_m: float | None = 0.05,
    reach: float = 1.2,
    slow_down: float = 1.0,
    seed: int = 0,
    progress: Progress = None,
) -> Excited:
    """Finds a motion that determines masses and friction of an arm for `identify`, as `palpate excite` does.

    `start` are the joint positions at which the motion begins and ends, rad or m, without those of a gripper;
    the middle of each range if left out. `duration` is in s, `speed` and `torque` are the largest shares of the
    joints' limits, `ground_m` is the height above which the arm stays, m in the base frame, or None, `reach` is
    the largest travel of a joint from its start, rad or m. `slow_down` slows the motion down by this factor.
    Returns a dict: `joint_names`, `time` (T,) s, `q`, `velocity` and `acceleration` (T, n_joints) in rad or m, and s,
    the keys of the command's JSON, such as `condition`, and `csv` and `yaml`, the contents of the files that the
    command writes: a table, and a trajectory_msgs/JointTrajectory. Only the ground and the arm itself are known
    as obstacles: play the motion slowly first.

    Raises FileError if there is no such robot, or SettingsError if an argument is out of its range or no motion
    keeps to the limits.
    """

def identify(
    log: _Logs,
    robot: Robot | _Path | None = None,
    *,
    tool_link: str | None = None,
    currents: bool = False,
    settings: AnySettings | None = None,
    progress: Progress = None,
    **sections: Unpack[LearningSections],
) -> Identified:
    """Finds payload, friction, bias and delay of an arm from logs of free motion, as `palpate identify` does.

    `log` is a path, a `Log`, a `Touch`, or several. `tool_link` names the link in whose frame the payload
    is given, that of the last joint if left out. With `currents`, or if the names of columns show it, the
    torques are motor currents. Returns a dict like the command's JSON: `payload`, `joints`, `bodies` and
    `delay_s` with values and standard deviations; `touched`, the share of the samples that is left out
    because of contact; `read_times`, how far stamps are from the times at which the joints were read;
    `held_out` with the residual torques, N·m; `misfit`, what is wrong if these are too large, or None;
    `text`, the content of the file for `Robot(..., arm="arm.toml")` and the command's --arm.

    Raises SettingsError, FileError or PalpateError if the logs cannot be used.
    """

def external_torques(
    log: _Logs,
    robot: Robot | _Path | None = None,
    *,
    causal: bool = False,
    bandwidth_hz: float | None = None,
    free: _Logs | None = None,
    false_alarms_per_hour: float = 1.0,
    wrench_link: str | None = None,
    settings: AnySettings | None = None,
    progress: Progress = None,
    **sections: Unpack[LearningSections],
) -> list[TouchTorques]:
    """External torques of logs with their standard deviations, as `palpate torque` writes them.

    `log` is a path, a `Log`, a `Touch`, or several. `robot` is an identified arm, `Robot(..., arm="arm.toml")`,
    or any other arm, whose standard deviations are then a guess. Returns a dict for each touch: `name`,
    `time` (T,) s or None, `q` (T, n_joints) rad in the robot's order, `torque` and `std` (T, n_joints) N·m,
    `statistic` (T,): the largest |torque| / std over the joints; `threshold`, which the statistic of
    contact-free motion exceeds `false_alarms_per_hour` times an hour, None if it is not known; and `wrench`
    (T, 6), with `wrench_link`: the force, N, and the moment, N·m, at the origin of this link that explain the
    torques best, along the axes of the base; else None. The threshold is determined from `free`, logs of
    contact-free motion, or from the motion that was held out in identification.

    Raises SettingsError, FileError or TouchError.
    """

def default_settings(
    settings: AnySettings | None = None, **sections: Unpack[Settings]
) -> dict[str, Any]:
    """All settings, with defaults for those not given: a dict of sections with every key."""

def given_settings(
    settings: AnySettings | None = None, **sections: Unpack[Settings]
) -> dict[str, dict[str, Any]]:
    """The given settings, from a file or a dict, checked, as a dict of sections."""

def summarised(name: str, errors: Sequence[Errors | None], bands: Sequence[Any]) -> MethodRow:
    """The row of a method in Table I, from its errors and `bands` on the touches as `evaluate` returns them."""

def unpickled_field(bytes: bytes) -> Field:
    """Restores a field from its pickled bytes."""
