"""Cost and limit of motions agree with the predicted torques; a plan costs no more than the straight path."""

import pickle
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import palpate
from palpate.planning import FieldCost, motion_validator, objective, plan, validity_checker, with_view

Array = NDArray[np.float64]
FINE = np.linspace(-0.2, 0.2, 81)


@pytest.fixture(scope="module")
def predictor(field: palpate.Field, robot: palpate.Robot) -> palpate.PathPredictor:
    return field.path_predictor(robot, coarse=True)


@pytest.fixture(scope="module")
def pushes(plant: Path) -> list[Array]:
    """Paths of four touches, from free of contact to the deepest posture, of different lengths."""
    return [np.load(plant / f"seq_{k:03}" / "angles.npy")[40 : 200 + k : 20] for k in range(4)]


def test_the_cost_of_several_paths_is_the_cost_of_each(predictor: palpate.PathPredictor, pushes: list[Array]) -> None:
    for by in ("peak", "work"):
        cost = FieldCost(predictor, by)
        each = [float(cost.cost(path)) for path in pushes]
        assert cost.cost(pushes).tolist() == each and min(each) > 0
        assert cost.cost(np.array([pushes[0], pushes[0]])).tolist() == [each[0]] * 2
        assert cost.cost(pushes[0].tolist()).shape == () and cost.cost([]).shape == (0,)
        limits = [int(cost.limit(path, 1.0)) for path in pushes]
        assert cost.limit(pushes, 1.0).tolist() == limits


def test_a_path_that_touches_nothing_costs_nothing(field: palpate.Field, robot: palpate.Robot) -> None:
    ahead = field.points[:, 0] > 0.3
    only = palpate.Field.from_arrays(field.points[ahead], field.stiffness[ahead], lattice=field.lattice)
    away = np.array([np.pi, 0.5, 0.0, 1.5, 0.0, 0.5, 0.0])
    path = np.array([away, away + 0.3])
    for by in ("peak", "work"):
        cost = FieldCost(only.path_predictor(robot), by)
        assert cost.cost(path) == 0.0 and cost.limit(path, 0.0) == -1
    assert not cost.torque_at(path).any()


def test_rows_between_stay_on_the_path_and_no_step_is_too_long(
    predictor: palpate.PathPredictor, pushes: list[Array]
) -> None:
    cost = FieldCost(predictor, step_rad=0.01)
    for path in pushes:
        rows = cost.rows(path)
        assert np.abs(np.diff(rows, axis=0)).max() <= 0.01 + 1e-12
        kept = [np.flatnonzero((rows == row).all(1)) for row in path]
        assert all(len(found) for found in kept)
        assert cost.cost(path) == pytest.approx(float(cost.cost(rows)), rel=1e-9)


def test_a_beginning_of_a_path_costs_at_most_as_much_as_the_path(
    predictor: palpate.PathPredictor, pushes: list[Array]
) -> None:
    for by in ("peak", "work"):
        cost = FieldCost(predictor, by)
        for path in pushes:
            costs = cost.cost([path[:end] for end in range(1, len(path) + 1)])
            assert (np.diff(costs) >= -1e-9).all() and costs[0] == 0.0


def test_a_path_passes_a_limit_at_the_first_row_whose_beginning_costs_more(
    predictor: palpate.PathPredictor, pushes: list[Array]
) -> None:
    cost = FieldCost(predictor)
    for path in pushes:
        costs = cost.cost([path[:end] for end in range(1, len(path) + 1)])
        for limit in (0.0, 0.3 * costs[-1], 0.7 * costs[-1], 1.01 * costs[-1]):
            above = np.flatnonzero(costs > limit)
            assert cost.limit(path, limit) == (above[0] if len(above) else -1)


class Banded:
    """A predictor whose field has bands of 0.5 N·m."""

    def __init__(self, inner: palpate.PathPredictor) -> None:
        self.inner, self.n_joints = inner, inner.n_joints

    def ask_all(self, paths: Any, inside: bool) -> Any:
        answers = self.inner.ask_all(paths, inside=inside)
        return [SimpleNamespace(torque=own.torque, peak_half_width=0.5 + 0 * own.torque) for own in answers]


def test_a_band_of_half_a_newton_metre_lowers_the_limit_by_it(
    predictor: palpate.PathPredictor, pushes: list[Array], field: palpate.Field, robot: palpate.Robot
) -> None:
    banded = FieldCost(Banded(predictor))  # type: ignore[arg-type]
    for limit in (0.6, 1.0, 1.5):
        lower = FieldCost(predictor).limit(pushes, limit - 0.5).tolist()
        assert banded.limit(pushes, limit, with_band=True).tolist() == lower
    # A field from arrays has no bands.
    alone = palpate.Field.from_arrays(field.points, field.stiffness, lattice=field.lattice)
    with pytest.raises(ValueError, match="no bands"):
        FieldCost(alone.path_predictor(robot)).limit(pushes, 1.0, with_band=True)


def test_a_field_with_an_elastic_body_has_bands_once_something_was_touched(
    plant: Path, robot: palpate.Robot, pushes: list[Array]
) -> None:
    cloud = plant / "object.ply"
    untouched = palpate.map_elastic(None, cloud, robot=robot)
    with pytest.raises(ValueError, match="no bands"):
        FieldCost(untouched.path_predictor(robot)).limit(pushes, 1.0, with_band=True)
    with pytest.raises(palpate.PalpateError, match="no bands"):
        untouched.next(pushes, robot=robot, limit=1.0)
    field = palpate.map_elastic(plant / "seq_000", cloud, robot=robot)
    cost = FieldCost(pickle.loads(pickle.dumps(field)).path_predictor(robot))
    largest = float(np.abs(cost.predictor.ask_all([cost.rows(pushes[0])])[0].torque).max())
    assert cost.limit(pushes[0], 1.001 * largest) == -1
    assert cost.limit(pushes[0], 1.001 * largest, with_band=True) >= 0
    assert cost.limit(pushes[0], 100.0 * largest, with_band=True) == -1
    found = field.next(pushes, robot=robot, limit=100.0 * largest)["proposals"]
    assert len(found) == len(pushes)
    for own in found:
        assert own["torque_n_m"] > 0.9 * np.abs(field.predict(pushes[own["candidate"]], robot)).max()
        assert own["with_band_n_m"] > own["torque_n_m"]


def test_work_is_that_of_the_torques_along_the_path(predictor: palpate.PathPredictor, pushes: list[Array]) -> None:
    cost = FieldCost(predictor, "work")
    rows = cost.rows(pushes[0])
    torque = predictor.ask(rows).torque
    work = 0.0
    for k in range(len(rows) - 1):
        for joint in range(7):
            mean = (torque[k, joint] + torque[k + 1, joint]) / 2
            work += max(0.0, -mean * (rows[k + 1, joint] - rows[k, joint]))
    assert cost.cost(pushes[0]) == pytest.approx(work)


def test_errors_say_what_was_wanted(predictor: palpate.PathPredictor) -> None:
    cost, q = FieldCost(predictor), np.zeros(7)
    for wrong, said in (
        (np.zeros((3, 6)), r"\(3, 6\); wanted one path, \(P, 7\)"),
        ([np.zeros((3, 7)), np.zeros((0, 7))], r"paths\[1\]` is \(0, 7\)"),
        (np.zeros((2, 2, 2, 7)), "paths"),
        (5.0, "cannot be read as numbers"),
        (np.full((2, 7), np.nan), "not finite"),
    ):
        with pytest.raises(ValueError, match=said):
            cost.cost(wrong)
    with pytest.raises(ValueError, match=r"\(M, 7\)"):
        cost.torque_at(q)
    with pytest.raises(ValueError, match="wanted 'peak' or 'work'"):
        FieldCost(predictor, "force")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="max_torque"):
        cost.limit(np.zeros((2, 7)), float("nan"))
    with pytest.raises(ValueError, match="step_rad"):
        FieldCost(predictor, step_rad=0.0)
    with pytest.raises(ValueError, match=r"\(6,\)"):
        plan(cost, np.zeros(6), q, np.zeros((7, 2)))
    with pytest.raises(ValueError, match="outside of `limits`"):
        plan(cost, q, q + 1, np.tile([-0.5, 0.5], (7, 1)))


def test_a_view_removes_cells_in_front_of_the_cloud_and_adds_hidden_cells(field: palpate.Field) -> None:
    eye, wall = np.array([-1.0, 0.0, 0.4]), np.array([[0.5, y, z] for y in FINE for z in 0.4 + FINE])
    view = with_view(field, wall, eye)
    depth = field.points[:, 0] - 0.5
    aside = np.abs(field.points[:, 1:] - [0.0, 0.4]).max(1)
    in_front, behind = (depth > -0.09) & (depth < -0.03) & (aside < 0.15), (depth > 0.03) & (aside < 0.15)
    assert in_front.any() and behind.any()
    assert not np.isin(field.cells[in_front], view.cells).any()
    outside = (depth < -0.13) | (depth > 0.13) | (aside > 0.35)
    for kept in (behind, outside):
        assert (view.query(field.points[kept])[0] == field.stiffness[kept]).all()
    hidden = view.counts == 0
    cell = field.lattice.spacing
    ahead = view.points[hidden][:, 0] - 0.5
    assert hidden.sum() > 1000 and (ahead > -cell).all() and (ahead < 0.1 + cell).all()
    assert len(set(view.stiffness[hidden])) == 1
    touched = ~hidden & (np.abs(view.points - [0.5, 0.0, 0.4]) < [0.1, 0.3, 0.3]).all(1)
    assert view.stiffness[hidden][0] == pytest.approx(view.stiffness[touched].mean(), rel=0.1)
    with pytest.raises(ValueError, match=r"wanted \(M, 3\) and \(3,\)"):
        with_view(field, wall[:, :2], eye)


@pytest.fixture
def space() -> Iterator[Any]:
    """A SpaceInformation of OMPL for seven joints, and its states from postures."""
    import ompl.base as base  # type: ignore[import-untyped]

    space = base.RealVectorStateSpace(7)
    bounds = base.RealVectorBounds(7)
    bounds.setLow(-7.0)
    bounds.setHigh(7.0)
    space.setBounds(bounds)
    si = base.SpaceInformation(space)
    space.setup()  # without it, copyFromReals ends in a segmentation fault

    def state(q: Array) -> Any:
        made = si.allocState()
        space.copyFromReals(made, q.tolist())
        return made

    yield si, state


def test_needs_ompl_its_objective_gives_a_path_the_cost_of_its_pieces(
    space: Any, predictor: palpate.PathPredictor, pushes: list[Array]
) -> None:
    import ompl.geometric as geometric  # type: ignore[import-untyped]

    si, state = space
    for by, joined in (("peak", max), ("work", sum)):
        cost = FieldCost(predictor, by)  # type: ignore[arg-type]
        target = objective(cost, si)
        path = geometric.PathGeometric(si)
        for q in pushes[0]:
            path.append(state(q))
        pieces = cost.cost([pushes[0][k : k + 2] for k in range(len(pushes[0]) - 1)], inside=True)
        assert path.cost(target).value() == pytest.approx(joined(pieces.tolist()))


def test_needs_ompl_a_motion_back_has_a_cost_of_its_own(
    space: Any, predictor: palpate.PathPredictor, pushes: list[Array]
) -> None:
    si, state = space
    target = objective(FieldCost(predictor, "work"), si)
    there, back = (target.motionCost(*map(state, ends)).value() for ends in (pushes[0][[0, -1]], pushes[0][[-1, 0]]))
    assert there != back and not target.isSymmetric()


def test_needs_ompl_a_state_is_valid_if_its_torque_keeps_to_the_limit(
    space: Any, predictor: palpate.PathPredictor, pushes: list[Array]
) -> None:
    si, state = space
    cost = FieldCost(predictor)
    ends = [path[[0, -1]] for path in pushes]
    costs = cost.cost(ends, inside=True)
    held = np.abs(cost.torque_at(np.array([path[-1] for path in pushes]))).max(1)
    for limit in np.sort(costs) * 0.999:
        motions = motion_validator(cost, si, limit)
        assert [motions.checkMotion(*map(state, pair)) for pair in ends] == (costs <= limit).tolist()
    for limit in np.sort(held) * 0.999:
        postures = validity_checker(cost, si, limit)
        assert [postures.isValid(state(path[-1])) for path in pushes] == (held <= limit).tolist()
    refused = validity_checker(cost, si, 100.0, lambda q: False)
    assert not refused.isValid(state(pushes[0][0]))


def test_needs_ompl_a_plan_costs_no_more_than_the_straight_path(
    robot: palpate.Robot, predictor: palpate.PathPredictor, pushes: list[Array]
) -> None:
    start = pushes[0][0]
    goal = start + 2.5 * (pushes[0][-1] - start)  # through the plant
    for by in ("peak", "work"):
        cost = FieldCost(predictor, by)
        found = plan(cost, start, goal, robot.limits, seconds=2.0)
        assert found is not None
        assert (found.path == cost.rows(found.via)).all()
        assert (found.path[0] == start).all() and (found.path[-1] == goal).all()
        assert found.cost <= found.straight_cost == cost.cost([start, goal])
        assert found.cost == pytest.approx(float(cost.cost(found.path)), rel=1e-6)
        assert (np.abs(np.diff(found.path, axis=0)) <= cost.step_rad + 1e-12).all()
        assert found.seconds < 4.0 and found.torque.shape == found.path.shape


def test_needs_ompl_a_plan_keeps_to_limits_and_to_what_is_allowed(
    robot: palpate.Robot, predictor: palpate.PathPredictor, pushes: list[Array]
) -> None:
    start, goal = pushes[0][0], pushes[0][0] + 2.5 * (pushes[0][-1] - pushes[0][0])
    middle = (start + goal) / 2

    def valid(q: Array) -> bool:
        return bool(np.linalg.norm(q - middle) > 0.1)

    limits = np.stack([np.minimum(start, goal) - 0.3, np.maximum(start, goal) + 0.3], axis=1)
    found = plan(FieldCost(predictor), start, goal, limits, valid=valid, seconds=3.0)
    assert found is not None
    assert all(map(valid, found.path))
    assert (limits[:, 0] <= found.path).all() and (found.path <= limits[:, 1]).all()
    assert plan(FieldCost(predictor), start, goal, limits, valid=lambda q: False, seconds=0.5) is None


def test_needs_ompl_a_plan_of_guesses_costs_no_more_than_any_of_them(
    robot: palpate.Robot, predictor: palpate.PathPredictor, pushes: list[Array]
) -> None:
    start, goal = pushes[0][0], pushes[0][0] + 2.5 * (pushes[0][-1] - pushes[0][0])
    rng = np.random.default_rng(3)
    guesses = [np.array([start, (start + goal) / 2 + rng.normal(0, 0.5, 7), goal]) for _ in range(3)]
    cost = FieldCost(predictor)
    found = plan(cost, start, goal, robot.limits, guesses=guesses, seconds=0.5, length_weight=0.0, batch=2)
    assert found is not None and found.cost <= min(cost.cost(guesses))
    narrow = np.stack([np.minimum(start, goal), np.maximum(start, goal)], axis=1)
    with pytest.raises(ValueError, match="one of `guesses` is outside"):
        plan(cost, start, goal, narrow, guesses=guesses)


def test_another_robot_than_that_of_the_field_is_reported(field: palpate.Field, touch: palpate.Touch) -> None:
    coarser = palpate.Robot(bake_spacing_m=0.01)
    with pytest.warns(palpate.PalpateWarning, match="with other joints, masses or shapes"):
        field.predict(touch.q[:5], coarser)
