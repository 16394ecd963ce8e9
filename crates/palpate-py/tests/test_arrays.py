"""Returned arrays share memory; array arguments of many kinds are accepted, or the error says what is wanted."""

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import palpate


def test_arrays_of_a_field_share_its_memory_and_stay_as_they_are(field: palpate.Field) -> None:
    shapes = {"points": (len(field), 3), "stiffness": (len(field),), "std": (len(field),)}
    shapes |= {"counts": (len(field),), "cells": (len(field),)}
    for name, shape in shapes.items():
        array = getattr(field, name)
        assert array is getattr(field, name)
        assert np.shares_memory(array, getattr(field, name)[1:])
        assert array.shape == shape and array.flags.c_contiguous
        assert not array.flags.owndata and not array.flags.writeable
        with pytest.raises(ValueError):
            array[0] = 1
        with pytest.raises(ValueError):
            array.setflags(write=True)


def test_arrays_outlive_their_field(robot: palpate.Robot, plant: Path) -> None:
    mapper = palpate.Mapper(robot)
    mapper.map(plant / "seq_000")
    stiffness = mapper.field().stiffness
    before = stiffness.copy()
    mapper.map(plant / "seq_001")
    assert (stiffness == before).all()
    assert len(mapper.field()) > len(stiffness)


def variants(array: Any) -> dict[str, Any]:
    """The same numbers in other types and memory layouts."""
    wide = np.zeros((array.shape[0], 2 * array.shape[1]))
    wide[:, ::2] = array
    frozen = array.copy()
    frozen.flags.writeable = False
    return {
        "strided": wide[:, ::2],
        "fortran": np.asfortranarray(array),
        "read-only": frozen,
        "list": array.tolist(),
        "tuple of arrays": tuple(array),
        "big-endian": array.astype(">f8"),
        "longdouble": array.astype(np.longdouble),
    }


def test_points_in_arrays_of_any_kind_are_the_same_points(field: palpate.Field) -> None:
    points = np.array(field.points[:20])
    wanted: tuple[Any, ...] = field.query(points)
    assert (wanted[0] == field.stiffness[:20]).all() and (wanted[2] == field.counts[:20]).all()
    for name, variant in variants(points).items():
        queried: tuple[Any, ...] = field.query(variant)
        for found, want in zip(queried, wanted):
            assert found.tobytes() == want.tobytes(), name
    assert (field.query(points.astype(np.float32))[2] == wanted[2]).all()
    whole = np.array([[0, 0, 0], [1, 1, 1]])
    assert field.query(whole)[0].tobytes() == field.query(whole.astype(float))[0].tobytes()


def test_motions_in_arrays_of_any_kind_are_the_same_motion(
    field: palpate.Field, robot: palpate.Robot, touch: palpate.Touch
) -> None:
    q = np.array(touch.q[:30])
    wanted = field.predict(q, robot)
    for name, variant in variants(q).items():
        assert field.predict(variant, robot).tobytes() == wanted.tobytes(), name


def test_untouched_and_outside_points_have_no_counts(field: palpate.Field, tmp_path: Path) -> None:
    stiffness, std, counts = field.query([[-1.0, -1.0, -1.0], [9.0, 9.0, 9.0], [np.nan, 0.0, 0.0]])
    assert stiffness[0] == field.untouched and std[0] == pytest.approx(0.76 * 1.2**1.5)
    assert np.isnan(stiffness[1:]).all() and np.isnan(std[1:]).all() and (counts == 0).all()
    field.save(tmp_path / "bare.npz", memory=False)
    bare = palpate.Field.load(tmp_path / "bare.npz")
    assert not bare.has_memory and np.isnan(bare.query([[-1.0, -1.0, -1.0]])[1]).all()


@pytest.mark.parametrize(
    ("wrong", "kind", "message"),
    [
        ([1.0, 2.0, 3.0], ValueError, r"`points` has shape \(3,\); wanted \(N, 3\)"),
        (np.zeros((3, 2)), ValueError, r"has shape \(3, 2\); wanted \(N, 3\)"),
        (np.zeros((1, 1, 3)), ValueError, r"has shape \(1, 1, 3\); wanted \(N, 3\)"),
        (1.0, ValueError, r"has shape \(\); wanted \(N, 3\)"),
        (np.zeros((1, 3), dtype=complex), TypeError, "dtype complex128; wanted float64"),
        (np.zeros((1, 3), dtype=bool), TypeError, "dtype bool; wanted float64"),
        ([["a", "b", "c"]], TypeError, "dtype <U1; wanted float64"),
        (np.array([[None, 1, 2]]), TypeError, "dtype object; wanted float64"),
        ([[1, 2, 3], [4, 5]], ValueError, r"must be an array of numbers, \(N, 3\); found list"),
        (np.array([[1, 2, 3]], dtype="datetime64[s]"), TypeError, "dtype datetime64"),
        (None, TypeError, "dtype object; wanted float64"),
    ],
)
def test_an_invalid_array_of_points_is_refused(
    field: palpate.Field, wrong: Any, kind: type[Exception], message: str
) -> None:
    with pytest.raises(kind, match=message):
        field.query(wrong)


def test_invalid_colours_are_refused_with_their_row(field: palpate.Field, robot: palpate.Robot) -> None:
    for wrong in (300.0, -1.0, 0.5):
        message = rf"`colours` holds {wrong:g} in row 1 \(from 0\); wanted whole numbers from 0 to 255"
        with pytest.raises(ValueError, match=message):
            palpate.extrapolate(field, np.zeros((2, 3)), [[0.0] * 3, [0.0, 0.0, wrong]], robot)


def test_samples_of_a_wrong_shape_are_refused_and_not_learnt(robot: palpate.Robot) -> None:
    mapper = palpate.Mapper(robot)
    good = [0.0] * 7
    with pytest.raises(palpate.PalpateError, match="begin_touch"):
        mapper.step(good, good)
    mapper.begin_touch()
    mapper.step(good, np.zeros(14, dtype=np.float32)[::2])
    mapper.step(np.zeros(7, dtype=np.int16), tuple(good))
    with pytest.raises(ValueError, match=r"`q` has shape \(6,\); wanted \(7,\)"):
        mapper.step(good[:6], good)
    with pytest.raises(ValueError, match=r"`tau` has shape \(1, 7\); wanted \(7,\)"):
        mapper.step(good, [good])
    with pytest.raises(palpate.TouchError):
        mapper.step([np.nan] * 7, good)
    with pytest.raises(ValueError, match=r"`path` has shape \(2, 3\); wanted \(P, 7\)"):
        mapper.ask(np.zeros((2, 3)))
    with pytest.raises(palpate.TouchError, match="no points"):
        mapper.ask(np.zeros((0, 7)))
    assert len(mapper.field()) == 0


def test_touches_whose_arrays_differ_in_length_are_refused() -> None:
    q = np.zeros((4, 7))
    assert len(palpate.Touch(q, q.astype(np.float32), time=range(4))) == 4
    with pytest.raises(ValueError, match=r"`tau` has 3 rows; wanted \(4, 7\), as `q`"):
        palpate.Touch(q, q[:3])
    with pytest.raises(ValueError, match=r"`tau` has shape \(4, 6\); wanted \(4, 7\), as `q`"):
        palpate.Touch(q, q[:, :6])
    with pytest.raises(ValueError, match=r"`time` has shape \(3,\); wanted \(4,\)"):
        palpate.Touch(q, q, time=[0, 1, 2])
    with pytest.raises(ValueError, match="`joint_names` has 1 names"):
        palpate.Touch(q, q, joint_names=["a"])


def test_a_field_from_arrays_is_the_field(field: palpate.Field, robot: palpate.Robot, touch: palpate.Touch) -> None:
    same = palpate.Field.from_arrays(
        field.points, field.stiffness, field.std, field.counts.astype(np.int64), lattice=field.lattice
    )
    assert same.cells.tobytes() == field.cells.tobytes()
    assert same.points.tobytes() == field.points.tobytes()
    assert same.predict(touch.q, robot).tobytes() == field.predict(touch.q, robot).tobytes()
    float32 = palpate.Field.from_arrays(
        field.points.astype(np.float32), field.stiffness.astype(np.float32), lattice=field.lattice
    )
    assert float32.cells.tobytes() == field.cells.tobytes()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"stiffness": [1.0, -1.0]}, "`stiffness` holds -1 in row 1"),
        ({"stiffness": [1.0, np.inf]}, "`stiffness` holds inf in row 1"),
        ({"stiffness": [1.0]}, r"`stiffness` has shape \(1,\); wanted \(2,\)"),
        ({"std": [[1.0, 2.0]]}, r"`std` has shape \(1, 2\); wanted \(2,\)"),
        ({"counts": [1, -1]}, "`counts` holds -1 in row 1"),
        ({"counts": [1, 0.5]}, "`counts` holds 0.5 in row 1"),
        ({"counts": [1]}, "`counts` has 1 rows and `points` has 2"),
        ({"points": [[0, 0, 0], [0, 0, 0]]}, "point 1 .* comes twice"),
        ({"points": [[0, 0, 0], [0, 0, 0.004]]}, "point 1 .* is no point of the lattice"),
        ({"points": [[0, 0, 0], [0, 0, 9]]}, "point 1 .* outside"),
        ({"untouched": -1.0}, "`untouched` holds -1"),
    ],
)
def test_arrays_that_make_no_field_are_refused(change: dict[str, Any], message: str) -> None:
    lattice = palpate.Lattice([0, 0, 0], 0.01, [10, 10, 10])
    good: dict[str, Any] = {"points": [[0, 0, 0], [0, 0, 0.01]], "stiffness": [1, 2]}
    palpate.Field.from_arrays(**good, lattice=lattice)
    with pytest.raises(ValueError, match=message):
        palpate.Field.from_arrays(**(good | change), lattice=lattice)


def test_cells_and_points_of_a_lattice_are_inverse() -> None:
    lattice = palpate.Lattice(np.zeros(3), 0.01, (4, 5, 6))
    assert lattice.n_cells == 120 and lattice.shape == (4, 5, 6)
    cells = np.arange(120)
    assert (lattice.cells(lattice.points(cells)) == cells).all()
    assert (lattice.cells([[-1, 0, 0], [0, 0, 0]]) == [-1, 0]).all()
    with pytest.raises(ValueError, match="120 cells"):
        lattice.points([120])
    with pytest.raises(ValueError, match="in row 0"):
        lattice.points([-1])
    with pytest.raises(palpate.SettingsError, match="spacing is 0 m"):
        palpate.Lattice([0, 0, 0], 0.0, [1, 1, 1])
    with pytest.raises(ValueError, match="three counts"):
        palpate.Lattice([0, 0, 0], 0.1, [1, 1])
    zero, minus_zero = (palpate.Lattice([x, 0, 0], 0.01, [1, 1, 1]) for x in (0.0, -0.0))
    assert zero == minus_zero and hash(zero) == hash(minus_zero)
    filled = palpate.Lattice.filling([-1.2] * 3, [1.2] * 3, 0.012)
    assert filled.shape == (200, 200, 200)


def test_pickled_objects_are_restored_unchanged(
    field: palpate.Field, robot: palpate.Robot, touch: palpate.Touch, plant: Path
) -> None:
    def sent(thing: Any) -> Any:
        return pickle.loads(pickle.dumps(thing))

    again = sent(field)
    assert again.stiffness.tobytes() == field.stiffness.tobytes() and again.has_memory
    assert sent(field.lattice) == field.lattice and hash(sent(field.lattice)) == hash(field.lattice)
    heavy = palpate.Robot(payload_link="EndEffector_Link", payload_mass_kg=1.5)
    assert (sent(heavy).gravity(touch.q[0]) == heavy.gravity(touch.q[0])).all()
    assert (heavy.gravity(touch.q[0]) != robot.gravity(touch.q[0])).any()
    same = sent(touch)
    assert same.q.tobytes() == touch.q.tobytes() and same.name == touch.name
    assert touch.time is not None and same.time.tobytes() == touch.time.tobytes()
    log = sent(palpate.open_log(plant, split_gap_s=2.0))
    assert [t.name for t in log] == [t.name for t in palpate.open_log(plant)]


def test_poses_and_gravity_are_those_of_the_arm(robot: palpate.Robot) -> None:
    pose = robot.forward(np.zeros(7), robot.link_names[-1])
    assert pose.shape == (4, 4) and (pose[3] == [0, 0, 0, 1]).all()
    assert np.allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3))
    # Gravity exerts no torque on joints with a vertical axis.
    assert robot.gravity(np.zeros(7))[0] == pytest.approx(0, abs=1e-6)
    with pytest.raises(ValueError, match="no link `nose`"):
        robot.forward(np.zeros(7), "nose")
