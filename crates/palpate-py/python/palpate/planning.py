"""A stiffness field as the cost and the limit of a motion planner.

    cost = FieldCost(field.path_predictor(coarse=True))
    cost.cost(paths)              # the largest torque of a joint along each path, N·m
    cost.limit(paths, 5.0)        # the row at which each path exceeds 5 N·m
    found = plan(cost, start, goal, robot.limits)

`FieldCost` serves any planner. `validity_checker`, `motion_validator` and `objective` are for OMPL, and `plan` is a
planner: ``pip install 'palpate[planning]'``. Torques are external torques of slow motions.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._palpate import Answer, PathPredictor
from ._view import with_view

__all__ = [
    "FieldCost",
    "Plan",
    "motion_validator",
    "objective",
    "plan",
    "validity_checker",
    "with_view",
]

_Array = NDArray[np.float64]
_Paths = ArrayLike | Sequence[ArrayLike]
_Valid = Callable[[_Array], bool]

_VIA = 7
"""Number of rows of a path that are varied."""


class FieldCost:
    """The cost of motions according to a field.

    `by` is the kind of cost: "peak", the largest absolute torque of any joint along the path, N·m; or "work", the work
    of the arm on the object, J: the sum over joints of -torque times displacement where positive. Work that the springs
    return is not subtracted. A path is evaluated at its rows, and between them so that no joint moves more than
    `step_rad`.

    One path is (P, n) rad; joints move linearly from row to row. Several paths are (N, P, n), or a sequence of (P,
    n) with different P. A path starts free of contact. With `inside`, it is a piece of a path, or a posture, that
    begins in the object: cells that the links cover at the first row are pushed out to the nearest surface.
    """

    def __init__(
        self,
        predictor: PathPredictor,
        by: Literal["peak", "work"] = "peak",
        *,
        step_rad: float = 0.05,
    ) -> None:
        if by not in ("peak", "work"):
            raise ValueError(f"`by` is {by!r}; wanted 'peak' or 'work'")
        if not step_rad > 0.0:
            raise ValueError(f"`step_rad` is {step_rad}; wanted more than 0")
        self.predictor, self.by, self.step_rad = predictor, by, step_rad

    def cost(self, paths: _Paths, *, inside: bool = False) -> _Array:
        """Costs of paths, (N,), N·m or J; () for one path."""
        several, one = self._several(paths)
        costs = [self._of(rows, answer.torque) for _, rows, answer in self._answers(several, inside)]
        return np.array(costs[0] if one else costs)

    def limit(
        self, paths: _Paths, max_torque: float, *, with_band: bool = False, inside: bool = False
    ) -> NDArray[np.int64]:
        """The first row of each path at which, or on the way to which, a joint's torque exceeds `max_torque`, N·m.

        (N,), or () for one path; -1 if none. With `with_band`, the half-width of the band for the
        largest torque of the path is added to the torque; ValueError if the field has no bands.
        """
        if not max_torque >= 0.0:
            raise ValueError(f"`max_torque` is {max_torque}; wanted 0 N·m or more")
        several, one = self._several(paths)
        firsts = []
        for ends, _, answer in self._answers(several, inside):
            torque = np.abs(answer.torque)
            if with_band:
                if answer.peak_half_width is None:
                    raise ValueError("the field has no bands; leave out `with_band`, or use a field of `palpate map`")
                torque = torque + answer.peak_half_width
            above = torque.max(1) > max_torque
            firsts.append(int(np.searchsorted(ends, above.argmax())) if above.any() else -1)
        return np.array(firsts[0] if one else firsts, dtype=np.int64)

    def torque_at(self, postures: ArrayLike) -> _Array:
        """The torque at each of `postures` (M, n) rad in the object: (M, n), N·m.

        Cells are pushed out to the nearest surface of a link. A path to the posture has larger torques, since the
        arm also drags cells along.
        """
        q = np.asarray(postures, dtype=np.float64)
        if q.ndim != 2 or q.shape[1] != self.predictor.n_joints:
            raise ValueError(f"`postures` is {q.shape}; wanted (M, {self.predictor.n_joints})")
        answers = self.predictor.ask_all(q[:, None], inside=True)
        return np.array([answer.torque[0] for answer in answers]).reshape(q.shape)

    def rows(self, path: ArrayLike) -> _Array:
        """A path (P, n) with interpolated rows, so that no joint moves more than `step_rad` from row to row."""
        return self._rows(self._several(np.asarray(path, dtype=np.float64))[0][0])[0]

    def _rows(self, path: _Array) -> tuple[_Array, NDArray[np.int64]]:
        """The rows at which a path is evaluated, and the indices of the original rows among them, (P,)."""
        moved = np.abs(np.diff(path, axis=0)).max(1, initial=0.0)
        counts = np.maximum(np.ceil(moved / self.step_rad - 1e-9), 1).astype(np.int64)
        parts = [a + (b - a) * np.arange(n)[:, None] / n for a, b, n in zip(path, path[1:], counts, strict=False)]
        return np.concatenate([*parts, path[-1:]]), np.concatenate([[0], np.cumsum(counts)])

    def _several(self, paths: _Paths) -> tuple[list[_Array], bool]:
        """Paths as arrays, and whether a single path was given."""
        n = self.predictor.n_joints
        try:
            given = list(paths)  # type: ignore[arg-type]
            one = len(given) > 0 and np.ndim(given[0]) == 1
            several = [np.asarray(path, dtype=np.float64) for path in ([given] if one else given)]
        except (TypeError, ValueError):
            raise ValueError(f"`paths` cannot be read as numbers; wanted one path, (P, {n}), or several") from None
        for number, path in enumerate(several):
            name = "`paths`" if one else f"`paths[{number}]`"
            if path.ndim != 2 or path.shape[1] != n or len(path) == 0:
                raise ValueError(f"{name} is {path.shape}; wanted one path, (P, {n}), or several, P at least 1")
            if not np.isfinite(path).all():
                raise ValueError(f"{name} has numbers that are not finite")
        return several, one

    def _answers(self, paths: list[_Array], inside: bool) -> list[tuple[NDArray[np.int64], _Array, Answer]]:
        """For each path the indices of its original rows, all rows, and the predicted torques."""
        rows = [self._rows(path) for path in paths]
        answers = self.predictor.ask_all([own for own, _ in rows], inside=inside) if rows else []
        return [(ends, own, answer) for (own, ends), answer in zip(rows, answers, strict=True)]

    def _of(self, rows: _Array, torque: _Array) -> float:
        if self.by == "peak":
            return float(np.abs(torque).max())
        return float(np.maximum(-0.5 * (torque[1:] + torque[:-1]) * np.diff(rows, axis=0), 0.0).sum())


def validity_checker(cost: FieldCost, si: Any, max_torque: float, valid: _Valid | None = None) -> Any:
    """A StateValidityChecker of OMPL: accepts postures at which no torque exceeds `max_torque`, N·m.

    `si` is a SpaceInformation of a RealVectorStateSpace. `valid` returns whether a posture (n,) is free of
    collisions of the robot with itself, the ground, and all objects that are not in the field.
    """
    base, n = _ompl()[0], cost.predictor.n_joints

    def is_valid(_: Any, state: Any) -> bool:
        q = np.array(state[0:n])
        return (valid is None or valid(q)) and bool(np.abs(cost.torque_at(q[None])).max() <= max_torque)

    return _made(base.StateValidityChecker, si, isValid=is_valid)


def motion_validator(cost: FieldCost, si: Any, max_torque: float, valid: _Valid | None = None) -> Any:
    """A MotionValidator of OMPL: accepts straight motions along which no torque exceeds `max_torque`, N·m.

    It checks a motion as a whole, which is faster and more reliable than checking single postures.
    """
    base, n = _ompl()[0], cost.predictor.n_joints

    def check(_: Any, a: Any, b: Any) -> bool:
        motion = np.array([a[0:n], b[0:n]])
        if valid is not None and not all(map(valid, cost.rows(motion))):
            return False
        return bool(cost.limit(motion, max_torque, inside=True) < 0)

    return _made(base.MotionValidator, si, checkMotion=check)


def objective(cost: FieldCost, si: Any) -> Any:
    """An OptimizationObjective of OMPL: the sum of the costs of the pieces of a path, or their maximum for "peak".

    A piece neglects cells that the arm drags along from earlier pieces, so a path may cost more than its pieces:
    compare paths by `FieldCost.cost`.
    """
    base, n = _ompl()[0], cost.predictor.n_joints

    def of_motion(_: Any, a: Any, b: Any) -> Any:
        return base.Cost(float(cost.cost([a[0:n], b[0:n]], inside=True)))

    def combined(_: Any, a: Any, b: Any) -> Any:
        return base.Cost(max(a.value(), b.value()) if cost.by == "peak" else a.value() + b.value())

    def nothing(*_: Any) -> Any:
        return base.Cost(0.0)

    def is_symmetric(_: Any) -> bool:
        return False  # pushing costs more than retreating

    whole = {"stateCost": nothing, "identityCost": nothing, "isSymmetric": is_symmetric}
    return _made(base.OptimizationObjective, si, motionCost=of_motion, combineCosts=combined, **whole)


def _made(base: Any, si: Any, **methods: Callable[..., Any]) -> Any:
    """An instance of a subclass of an OMPL class, with these methods."""
    return type(base.__name__, (base,), methods)(si)


@dataclass(frozen=True)
class Plan:
    """A planned path: (P, n) rad; no joint moves more than the cost's `step_rad` from row to row."""

    path: _Array
    via: _Array  # via points: the path is straight between them, (V, n) rad
    torque: _Array  # predicted external torque along the path, (P, n), N·m
    cost: float  # N·m or J
    straight_cost: float  # cost of the straight path
    seconds: float  # planning time, s


def plan(
    cost: FieldCost,
    start: ArrayLike,
    goal: ArrayLike,
    limits: ArrayLike,
    *,
    valid: _Valid | None = None,
    seconds: float = 20.0,
    margin_rad: float = 1.5,
    length_weight: float = 0.2,
    guesses: Sequence[ArrayLike] | None = None,
    batch: int = 16,
    seed: int = 0,
) -> Plan | None:
    """Plans a path from `start`, which is free of contact, to `goal`, both (n,) rad; None if no valid one was found.

    `limits` (n, 2) rad are `Robot.limits`; no joint moves further than `margin_rad` beyond start, goal and `guesses`.
    `valid` is as for `validity_checker`.

    For a third of `seconds`, RRT-Connect of OMPL searches for paths below lower and lower torques. `guesses`
    replace this search: paths (P, n) from start to goal, such as `Plan.via` of a plan with a faster cost. Then
    these paths and the straight one are varied at random, in batches of `batch`, and compared as whole paths: by
    cost plus `length_weight` (N·m or J per rad) times length in joint space. If the straight path is valid, no path
    that costs more is returned. `seed` is for the variation; OMPL uses its own random numbers.
    """
    begun = perf_counter()
    n, bounds = cost.predictor.n_joints, np.asarray(limits, dtype=np.float64)
    a, b = np.asarray(start, dtype=np.float64), np.asarray(goal, dtype=np.float64)
    if a.shape != (n,) or b.shape != (n,) or bounds.shape != (n, 2):
        shapes = f"{a.shape}, {b.shape}, {bounds.shape}"
        raise ValueError(f"`start`, `goal` and `limits` are {shapes}; wanted ({n},), ({n},), ({n}, 2)")
    given = [] if guesses is None else cost._several(list(guesses))[0]
    known = np.concatenate([np.array([a, b]), *given])
    if not ((bounds[:, 0] <= known) & (known <= bounds[:, 1])).all():
        raise ValueError("`start`, `goal` or one of `guesses` is outside of `limits`")
    low = np.maximum(bounds[:, 0], known.min(0) - margin_rad)
    high = np.minimum(bounds[:, 1], known.max(0) + margin_rad)

    def allowed(path: _Array) -> bool:
        return valid is None or all(map(valid, cost.rows(path)))

    def total(paths: list[_Array]) -> _Array:
        lengths = [np.linalg.norm(np.diff(path, axis=0), axis=1).sum() for path in paths]
        return cost.cost(paths) + length_weight * np.array(lengths)

    straight = np.array([a, b])
    if guesses is None:
        found = _connected(cost, straight, (low, high), valid, begun + seconds / 3)
    else:
        found = [np.concatenate([[a], path[1:-1], [b]]) for path in given]
    pool = sorted(((float(total([path])[0]), path, 0.3) for path in [straight, *found] if allowed(path)), key=_score)
    if not pool:
        return None
    rng, varied, end = np.random.default_rng(seed), perf_counter(), begun + seconds
    while (now := perf_counter()) < end:
        pool = pool[: 4 if 3 * (now - varied) < end - varied else 2 if 1.5 * (now - varied) < end - varied else 1]
        for number, own in enumerate(pool):
            if number == 0 or perf_counter() < end:
                pool[number] = _varied(own, total, allowed, (low, high), batch, rng)
        pool.sort(key=_score)
    path = cost.rows(pool[0][1])
    torque = cost.predictor.ask(path).torque
    return Plan(path, pool[0][1], torque, cost._of(path, torque), float(cost.cost(straight)), perf_counter() - begun)


_Scored = tuple[float, _Array, float]  # total cost, path, size of the next variation in rad


def _score(own: _Scored) -> float:
    return own[0]


def _varied(
    own: _Scored,
    total: Callable[[list[_Array]], _Array],
    allowed: Callable[[_Array], bool],
    box: tuple[_Array, _Array],
    batch: int,
    rng: np.random.Generator,
) -> _Scored:
    """The best allowed path among a path and a batch of variants, each with a smooth random bump."""
    score, path, size = own
    via = path if len(path) >= _VIA else _evenly(path, _VIA)
    middle, width = rng.uniform(0, len(via) - 1, (batch, 1)), rng.uniform(0.5, 0.5 * len(via), (batch, 1))
    bump = np.exp(-(((np.arange(len(via)) - middle) / width) ** 2))
    bump[:, [0, -1]] = 0.0
    tried = list(np.clip(via + size * rng.normal(size=(batch, 1, via.shape[1])) * bump[:, :, None], *box))
    scores = total(tried)
    for k in scores.argsort():
        if scores[k] < score and allowed(tried[k]):
            return float(scores[k]), tried[k], min(1.2 * size, 1.0)
    return score, path, 0.85 * size if size > 0.02 else 0.3


def _evenly(path: _Array, count: int) -> _Array:
    """`count` rows equally spaced along a path."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    at = np.linspace(0.0, along[-1], count)
    return np.stack([np.interp(at, along, joint) for joint in path.T], axis=1)


def _connected(
    cost: FieldCost, ends: _Array, box: tuple[_Array, _Array], valid: _Valid | None, until: float
) -> list[_Array]:
    """Paths of RRT-Connect: four tries; each halves the limit of torque, or raises it by 40 % if none was found."""
    base, geometric, util = _ompl()
    n = cost.predictor.n_joints
    space, bounds = base.RealVectorStateSpace(n), base.RealVectorBounds(n)
    for joint in range(n):
        bounds.setLow(joint, float(box[0][joint]))
        bounds.setHigh(joint, float(box[1][joint]))
    space.setBounds(bounds)
    lowest = 1.05 * float(np.abs(cost.torque_at(ends)).max()) + 1e-9
    torque = max(0.5 * float(np.abs(cost.predictor.ask(cost.rows(ends), inside=True).torque).max()), lowest)
    found, spoken = [], util.getLogLevel()
    util.setLogLevel(util.LOG_ERROR)
    try:
        for left in (4, 3, 2, 1):
            share = (until - perf_counter()) / left
            if share <= 0:
                break
            si = base.SpaceInformation(space)
            si.setStateValidityChecker(validity_checker(cost, si, torque, valid))
            si.setMotionValidator(motion_validator(cost, si, torque, valid))
            si.setup()
            problem, states = base.ProblemDefinition(si), [si.allocState(), si.allocState()]
            for state, q in zip(states, ends.tolist(), strict=True):
                space.copyFromReals(state, q)
            problem.setStartAndGoalStates(*states)
            planner = geometric.RRTConnect(si)
            planner.setProblemDefinition(problem)
            planner.setup()
            planner.solve(0.8 * share)
            if problem.hasExactSolution():
                path = problem.getSolutionPath()
                geometric.PathSimplifier(si).simplify(path, 0.2 * share)
                found.append(np.array([state[0:n] for state in path.getStates()]))
            torque = max(0.5 * torque, lowest) if problem.hasExactSolution() else 1.4 * torque
    finally:
        util.setLogLevel(spoken)
    return found


def _ompl() -> Any:
    """OMPL's modules `base`, `geometric` and `util`."""
    try:
        import ompl.base  # type: ignore[import-untyped]
        import ompl.geometric  # type: ignore[import-untyped]
        import ompl.util  # type: ignore[import-untyped]
    except ImportError as error:
        raise ImportError(f"{error}; OMPL comes with `pip install 'palpate[planning]'`") from None
    return ompl.base, ompl.geometric, ompl.util
