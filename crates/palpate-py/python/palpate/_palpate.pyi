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
    """What palpate could not do, and why."""

class SettingsError(PalpateError):
    """Settings or a request that cannot be followed."""

class LogError(PalpateError):
    """A log that cannot be read, or looks wrong where that is to be an error (`strict`)."""

class FileError(PalpateError):
    """A robot, a field or another file that is not what it should be."""

class TouchError(PalpateError):
    """A sample, a touch or a path that cannot be used."""

class PalpateWarning(UserWarning):
    """Something looks wrong, though it did not stop the work."""

@final
class Robot:
    """A robot arm with the surfaces of its links.

    `name_or_urdf` is the path of a URDF or the name of a built-in robot, `kinova_gen3` if left out;
    `packages` are folders of ROS packages for `package://` paths of meshes. `options` are the other
    keys of `palpate.settings.RobotSettings`: a payload, where baked meshes are kept. Meshes are baked
    at the first use and cached.

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
        """Its name, as its URDF has it."""
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
        """URDF, meshes and the arm file that it was read from; of a built-in robot none."""
    @property
    def limits(self) -> NDArray[np.float64]:
        """Lowest and highest position of each joint, (n_joints, 2), rad (m where prismatic); infinite where unlimited."""
    def gravity(self, q: ArrayLike) -> NDArray[np.float64]:
        """What gravity exerts on the joints at positions `q` (n_joints,) rad: (n_joints,) N·m."""
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
        """The points that fill the box between the corners `low` and `high` (3,) m."""
    @property
    def origin(self) -> list[float]:
        """First point, m."""
    @property
    def spacing(self) -> float:
        """Distance between neighbouring points, m."""
    @property
    def shape(self) -> tuple[int, int, int]:
        """Points along x, y and z."""
    @property
    def n_cells(self) -> int:
        """Points in all."""
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
    `time` (T,) s. `joint_names` say the order of the joints, which is the robot's if left out.
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
        """Its name."""
    @property
    def q(self) -> NDArray[np.float64]:
        """Joint positions, (T, n_joints), rad (m where prismatic)."""
    @property
    def tau(self) -> NDArray[np.float64]:
        """Joint torques as logged, (T, n_joints), N·m."""
    @property
    def time(self) -> NDArray[np.float64] | None:
        """By the log's clock, (T,), s; None if it has none."""
    @property
    def joint_names(self) -> list[str] | None:
        """Names of the joints in the order of the columns; None if the log does not say."""
    def __len__(self) -> int: ...
    def __getnewargs__(self) -> tuple[Any, ...]: ...

@final
class Log:
    """Touches in files, read as a stream: iterating yields one `Touch` after another.

    `open_log` makes one. Only the touch at hand is in memory, and each `for` starts anew.
    """

    @property
    def paths(self) -> list[str]:
        """Where it is."""
    def __iter__(self) -> TouchIterator: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

@final
class TouchIterator:
    """The touches of a log, one after another."""

    def __iter__(self) -> TouchIterator: ...
    def __next__(self) -> Touch: ...

def command(arguments: Sequence[str], call: Sequence[str]) -> int:
    """Runs the command `palpate` in this process, and returns its exit code.

    `arguments`: the command's name and its arguments. `call`: how this process is started again,
    without the arguments of the command.
    """

def cpus() -> int:
    """CPUs that this process may use, by its affinity and by its control group."""

def threads() -> int:
    """Threads of long calls in this process: those of RAYON_NUM_THREADS when the first was made."""

def open_log(path: _Path | Log | Sequence[_Path | Log], **options: Unpack[LogSettings]) -> Log:
    """Opens one or more logs, which are read as one.

    A log is a folder of one touch (angles.npy, torques.npy), a folder of such folders, a .csv file
    or a folder of them, a bag of ROS 2 (MCAP, SQLite) or Parquet. `options` are the keys of
    `palpate.settings.LogSettings`; parting at pauses (`split_idle`) needs a robot, and is done by
    what learns from the log.

    Raises LogError, which names the file and the remedy.
    """

@final
class StepReport:
    """What one sample gave."""

    @property
    def contacts(self) -> int:
        """Points touched."""
    @property
    def external(self) -> NDArray[np.float64] | None:
        """External torque, gravity and tare taken off, (n_joints,) N·m; None while taring."""
    @property
    def predicted(self) -> NDArray[np.float64] | None:
        """What the field expected before it learnt from the sample, (n_joints,) N·m; None with that."""

@final
class PathPredictor:
    """A field at one moment, and the arm with what it touches, to predict the torque of motions.

    `Field.path_predictor` and `Mapper.path_predictor` make one. It stays as it is, and threads may share it.
    """

    @property
    def n_joints(self) -> int:
        """Numbers that a point of a path has."""
    def ask(
        self,
        path: ArrayLike,
        resolution_cells: float | None = None,
        start_cells: float | None = None,
        inside: bool = False,
    ) -> Answer:
        """What torque a motion would meet: `path` is (P, n_joints) rad.

        As `Mapper.ask`. A path that does not go on from what the arm touches starts free of contact, and what
        the links cover at its first point counts as empty. With `inside`, it counts as pushed out to the nearest
        surface instead: for a posture, or a piece of a path, within the object.

        Raises TouchError if the path cannot be followed.
        """
    def ask_all(
        self,
        paths: Iterable[ArrayLike],
        resolution_cells: float | None = None,
        start_cells: float | None = None,
        inside: bool = False,
    ) -> list[Answer]:
        """What torque each of several motions would meet, to the bit as `ask` says it, on all threads together.

        Raises TouchError, with the number of the path, if one cannot be followed.
        """

@final
class Answer:
    """What a field says of a path of P points."""

    @property
    def torque(self) -> NDArray[np.float64]:
        """External torque that the path would meet, (P, n_joints), N·m."""
    @property
    def torque_std(self) -> NDArray[np.float64]:
        """Its standard deviation by the uncertainty of the springs alone, (P, n_joints), N·m.

        It ranks paths by how well their resistance is known; it bounds no error.
        """
    @property
    def half_width(self) -> NDArray[np.float64] | None:
        """Half-width of the band around it at 90 %, or the highest level of the field, (P, n_joints), N·m.

        None of a field without bands.
        """
    @property
    def peak_half_width(self) -> NDArray[np.float64] | None:
        """The same of the band that holds the largest torque of a joint along the path, (P, n_joints), N·m."""
    @property
    def contacts(self) -> NDArray[np.uint64]:
        """Points of the lattice touched, (P,)."""
    @property
    def known(self) -> NDArray[np.uint64]:
        """Those of them that were touched when the field was learnt, (P,)."""
    @property
    def goes_on(self) -> bool:
        """Whether the path went on from what the arm touched, rather than free of contact."""
    @property
    def stops(self) -> int:
        """Points of the path where the arm was looked at; the others lie between."""

@final
class Mapper:
    """Learns a stiffness field from touches.

    `robot` is a `Robot`, a name or a path; `method` is `map`, the exact maximum a posteriori, or
    `ekf`, the paper's filter. `settings` are those of the command: the path of a TOML file or a dict
    of its sections, over which `sections` are laid, such as `contact={"friction": 0.3}` or
    `lattice=Lattice(...)`; `palpate.settings` has all keys. `prior` is a field that says what is
    expected of its cells before they are touched. Threads that use one mapper wait for each other.

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
        """Goes on from a field that `save` or `palpate map` wrote, as if it had never stopped.

        Settings, if given, must agree with the field's own. Raises PalpateError if it was saved
        without its memory or learnt with another robot.
        """
    @staticmethod
    def from_field(
        field: Field,
        robot: Robot | _Path | None = None,
        settings: AnySettings | None = None,
        **sections: Unpack[Sections],
    ) -> Mapper:
        """Goes on from a field that has its memory, as `load` does from a file."""
    @property
    def robot(self) -> Robot:
        """The arm."""
    @property
    def method(self) -> str:
        """`map` or `ekf`."""
    @property
    def config(self) -> dict[str, Any]:
        """The configuration that holds, as the field's file has it."""
    def begin_touch(self, name: str = "") -> None:
        """Starts a touch: the next samples belong to it, and its start gives the tare.

        `Field.without` forgets it by its name.
        """
    def step(self, q: ArrayLike, tau: ArrayLike, time: float | None = None) -> StepReport:
        """Learns from one sample: `q` (n_joints,) rad, `tau` (n_joints,) N·m as logged, `time` in s. One within
        45 ms of the last that was learned from is only predicted. Without times, samples
        between which the fastest joint moves less than 2 mrad are thinned out.

        Raises TouchError if the sample cannot be used; it has then taught nothing.
        """
    def end_touch(self) -> None:
        """Ends the touch. Raises TouchError if it was shorter than the tare asked for."""
    def map(self, log: _Logs, progress: Progress = None) -> MapReport:
        """Learns the touches of logs, given by path, as `Log` or as `Touch`, in their order.

        The cells are those of `palpate map --tune=off` to the bit. `progress` is None for a bar where somebody
        can see it, True, False, or a callable of frames done and in all. Ctrl-C raises
        KeyboardInterrupt; the mapper then knows all samples before it and can go on.
        """
    def field(self) -> Field:
        """The field as it is now, with its memory: a snapshot, which later samples do not change."""
    def ask(
        self,
        path: ArrayLike,
        resolution_cells: float | None = None,
        start_cells: float | None = None,
    ) -> Answer:
        """What torque a motion would meet: `path` is (P, n_joints) rad.

        Joints go straight from point to point. A path that starts where the arm is in a touch under
        way goes on from the contacts there, if no point of the arm is further off than `start_cells`
        cells; any other starts free of contact. Between stops at most `resolution_cells` cells apart
        torques go in proportion; 0 stops at every point.

        Raises TouchError if the path cannot be followed.
        """
    def path_predictor(self, coarse: bool = False) -> PathPredictor:
        """The field and the arm as they are now, to say what torque many motions would meet.

        With `coarse`, clusters of cells count as one spring each: torques are off by some percent, and come
        several times as soon.
        """
    def save(self, path: _Path, memory: bool = True) -> None:
        """Writes the field as .npz, whole or not at all; without `memory` it cannot be gone on from."""

@final
class Field:
    """The stiffness of N cells that were touched or expected to be stiff.

    Arrays are read-only, share the memory of the field, and are the same object every time.
    """

    @staticmethod
    def load(path: _Path) -> Field:
        """Reads a field that `save` or `palpate map` wrote. Raises FileError."""
    def save(self, path: _Path, memory: bool = True) -> None:
        """Writes the field as .npz, whole or not at all, with its memory if it has one."""
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
        `std` is 0 and `counts` 1 if left out; a count of 0 says that a stiffness is only expected.
        `untouched` is the stiffness of all other cells, N/m. The contact model and the meaning of
        torques are those of the settings. Raises ValueError, which names the array and the row.
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
        """Frames that touched each point, (N,); 0 if its stiffness is only expected."""
    @property
    def cells(self) -> NDArray[np.uint32]:
        """Cell number of each point in the lattice, (N,)."""
    @property
    def prior(self) -> NDArray[np.float64] | None:
        """What K would be had nothing been touched, (N,), N/m; None if that is the same of all."""
    @property
    def lattice(self) -> Lattice:
        """The box that the cells belong to."""
    @property
    def contact(self) -> ContactSettings:
        """Settings of the contact model under which it was learnt, as `contact=` takes them."""
    @property
    def robot_name(self) -> str:
        """Name of the robot that touched them."""
    @property
    def untouched(self) -> float:
        """K of all other cells, N/m."""
    @property
    def has_memory(self) -> bool:
        """Whether mapping can go on from it, and touches be learnt from again."""
    def query(
        self, points: ArrayLike
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.uint32]]:
        """Stiffness (M,) N/m, its std (M,) N/m and counts (M,) of the cells at `points` (M, 3) m.

        Cells never touched have the prior's stiffness and std (NaN if the field has no memory, and
        so does not say) and a count of 0; outside the box both are NaN.
        """
    def predict(
        self, q_path: ArrayLike, robot: Robot | _Path | None = None, progress: Progress = None
    ) -> NDArray[np.float64]:
        """External torque that a motion meets: `q_path` (T, n_joints) rad gives (T, n_joints) N·m.

        The motion starts free of contact, and every row is a step, as in `palpate predict`. The
        robot is the one that learnt the field, by name, if left out.
        """
    def path_predictor(
        self, robot: Robot | _Path | None = None, *, coarse: bool = False
    ) -> PathPredictor:
        """The field, to say what torque many motions of an arm would meet.

        The robot is the one that learnt the field, by name, if left out. With `coarse`, clusters of cells count as one spring
        each: torques are off by some percent, and come several times as soon.
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

        `truth` compares with the true torques beside simulated touches. The settings may change how
        the log is read (`log`) and what its torques mean (`touch`).
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
        """Whether touches of logs contradict the field, and what has changed, as `palpate compare` reports it.

        The settings may change how the log is read (`log`) and what its torques mean (`touch`). Raises FileError if the
        field has no bands.
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
        """The candidates that would teach most, the best first, each after those before it, as `palpate next` ranks them.

        `candidates` are motions that could be made, (T, n_joints) rad each, and `task` those whose torques are to be known:
        the candidates if left out. `box` is a pair of corners, m, whose stiffness is to be known instead. `by` is
        "variance" or "information". Left out are motions whose predicted torque may pass `limit`, N·m, and motions
        in which a joint goes beyond its limits. A field with an elastic body takes no `limit`.
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
        """The field as if some of its touches had never been, as `palpate forget` makes it.

        Those of the names or numbers (such as "#3") in `touches`, those before the last `older_than`, and those that touched
        a point between two corners, `box`, m. Raises PalpateError if the field has no memory, or not all others can be learnt
        again.
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
    """Compares methods on touches that they have not seen, as `palpate evaluate` does.

    `methods` are of elastic, map, ekf, mlp, gp, knn, uniform and zero, all if left out; zero always
    stands beside the others. elastic needs a `cloud` of the object, with `colours`, `viewpoint`,
    `object_kind` and `root` as for `map_elastic`. Every touch is predicted from all others, in `folds` groups, or those named by
    `test` from all others. `truth` compares with true torques. In every fold, the settings of map that are not given
    are chosen among few (`tune="quick"`, if left out), those of map and ekf among many (True), or none (False).
    `share`, its number from 0 and how many there are, does that share of the folds alone: a `palpate.results.Share`. `reuse` names the logs and the
    robot as they are now: what was read for the last call of that name serves this one, if settings allow it.
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
    `colours` (N, 3) from 0 to 255; `viewpoint` is where the camera stood, (3,) m, searched if left out;
    `object_kind` is "plant" (stems, branches, leaves) or "cushion" (anything else that gives way), found from the
    cloud if left out; `root` is where a plant is held, (3,) or one a tree, (R, 3) m, where it meets the ground if
    left out. Clouds of several cameras are a list of paths, or lists of arrays for `cloud` and `colours`, with
    `viewpoint` (C, 3).
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

    `candidates` are from 2 to 1000, 24 if left out (12 for ekf); `quick` chooses among few, as
    `palpate map` does. Give the `settings` of the result to other calls.
    """

@final
class Extrapolation:
    """A stiffness for each of N seen points."""

    @property
    def points(self) -> NDArray[np.float64]:
        """The points, (N, 3), m."""
    @property
    def stiffness(self) -> NDArray[np.float64]:
        """K of a cell at each point, (N,), N/m."""
    @property
    def std(self) -> NDArray[np.float64]:
        """Its standard deviation: of the regression over features, not of single points, (N,), N/m."""
    @property
    def touched(self) -> NDArray[np.bool_]:
        """Whether the cell that the point lies in was touched, (N,)."""
    @property
    def field(self) -> Field:
        """The field with what untouched cells at seen points are expected to be."""
    @property
    def method(self) -> str:
        """`torque`, `cells` or `knn`."""
    @property
    def features(self) -> str:
        """What points were compared by."""

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
    """Carries the stiffness of a field over to all that a camera saw, as `palpate extrapolate` does.

    `cloud` is the path of a PLY or PCD file with colours, or points (N, 3) m with `colours` (N, 3)
    from 0 to 255. `method` is torque (if the field has its memory), cells or knn; without it, torque or
    cells, whichever predicts random halves of the remembered touches better, and `field` is as it was, with
    a warning, where both predict worse than none. `features` are a colour (chroma, rgb, oklab), height and
    shape, joined by `+`.
    """

def inspect(
    log: _Logs,
    robot: Robot | _Path | None = None,
    *,
    settings: AnySettings | None = None,
    progress: Progress = None,
    **sections: Unpack[LearningSections],
) -> Inspection:
    """Says what a log holds and what looks wrong with it, as `palpate inspect` does.

    `log` is a path, a `Log`, a `Touch`, or several, which are read as one. Torques are held against
    the gravity of the robot; contacts are looked for in the lattice and by the contact model of the
    settings, such as `lattice=Lattice(...)`, as `Mapper.map` would. `findings` have a `level`
    (note, warning or error), `what` was seen and the `remedy`, errors first. `log` has the figures: how to
    read the torques (`reading`), what is touched (`touched`) and those of every touch, N·m, s, rad;
    it is None if nothing can be read.

    Raises SettingsError or FileError; what is wrong with the log itself is a finding.
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
    """Finds payload, friction, bias and delay of an arm from logs of it in free motion, as `palpate identify` does.

    `log` is a path, a `Log`, a `Touch`, or several. `tool_link` names the link in whose frame the payload is given, the
    last joint's if left out; with `currents`, or if columns say so, torques are the drives' currents. Returns a dict as the
    command's JSON: `payload`, `joints`, `bodies`, `delay_s` with values and standard deviations; `touched`, the part of the
    samples that is left out, since something is touched in them; `read_times`, how far stamps are from the times at which
    the joints were read; `held_out` with the residual torques, N·m; `misfit`, what is wrong if that is too much, or None;
    `text` is the file for `Robot(..., arm="arm.toml")` and the command's --arm.

    Raises SettingsError, FileError or PalpateError if the logs do not serve.
    """

def external_torques(
    log: _Logs,
    robot: Robot | _Path | None = None,
    *,
    causal: bool = False,
    bandwidth_hz: float | None = None,
    false_alarms_per_hour: float = 1.0,
    settings: AnySettings | None = None,
    progress: Progress = None,
    **sections: Unpack[LearningSections],
) -> list[TouchTorques]:
    """External torques of logs with their standard deviations, as `palpate torque` writes them.

    `log` is a path, a `Log`, a `Touch`, or several; `robot` an arm that was identified, `Robot(..., arm="arm.toml")`, or
    any other, whose standard deviations are a guess. Returns a dict for each touch: `name`, `time` (T,) s or None, `q` (T,
    n_joints) rad in the robot's order, `torque` and `std` (T, n_joints) N·m, `statistic` (T,): the largest |torque| over
    its std, and `threshold`, which contact-free
    motion passes `false_alarms_per_hour` times an hour; None if nothing says it.

    Raises SettingsError, FileError or TouchError.
    """

def default_settings(
    settings: AnySettings | None = None, **sections: Unpack[Settings]
) -> dict[str, Any]:
    """All settings that hold when no more than this is said: a dict of sections with every key."""

def given_settings(
    settings: AnySettings | None = None, **sections: Unpack[Settings]
) -> dict[str, dict[str, Any]]:
    """The settings that are given, as a dict of sections: a file's, or those of a dict after a check."""

def summarised(name: str, errors: Sequence[Errors | None], bands: Sequence[Any]) -> MethodRow:
    """The row of a method in Table I by its errors and `bands` on touches, as `evaluate` gives them."""

def unpickled_field(bytes: bytes) -> Field:
    """A field from the bytes that it was pickled as."""
