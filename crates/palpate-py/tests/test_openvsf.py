"""Fields of OpenVSF are read and written with the same springs; invalid files are refused, and never executed."""

import io
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from stand_in import PointVSF, Tensor

import palpate
from palpate import openvsf
from palpate.settings import ContactSettings

DATA = Path(__file__).parent / "data" / "openvsf"
"""Files written by OpenVSF itself, by scripts/openvsf_round_trip.py."""


def written(path: Path) -> dict[str, NDArray[Any]]:
    """Arrays of a file of OpenVSF, read without checks: these files are trusted."""
    if path.is_dir():
        return {file.stem: np.load(file) for file in path.glob("*.npy")}
    with np.load(path, allow_pickle=True) as held:
        features: dict[str, NDArray[Any]] = held["features"].item()
        return {"points": held["points"], "K": held["K"], **features}


def vsf_of(arrays: dict[str, NDArray[Any]]) -> PointVSF:
    vsf = PointVSF(Tensor(arrays["points"]))
    vsf.stiffness = Tensor(arrays["K"])
    for name in arrays.keys() - {"points", "K"}:
        vsf.set_feature(name, Tensor(arrays[name]))
    return vsf


def same(one: palpate.Field, other: palpate.Field) -> bool:
    names = ("points", "stiffness", "std", "counts")
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in names)


@pytest.fixture(scope="module")
def learnt(robot: palpate.Robot, plant: Path) -> palpate.Field:
    """A field with settings other than the defaults."""
    mapper = palpate.Mapper(robot, contact={"friction": 0.45, "contact_distance_m": 0.02})
    mapper.map(plant / "seq_000")
    return mapper.field()


@pytest.mark.parametrize("name", ["prior.npz", "prior"])
def test_springs_on_a_lattice_are_read_unchanged(name: str) -> None:
    field, wanted = openvsf.load(DATA / name), written(DATA / name)
    assert field.lattice == palpate.Lattice(wanted["points"].min(axis=0), 0.02, [6, 5, 4])
    assert np.abs(field.points - wanted["points"]).max() < 1e-12
    assert (field.stiffness == wanted["K"]).all()
    assert (field.std == wanted["K_std"]).all() and (field.counts == 0).all()


def test_a_live_field_is_the_one_in_its_file() -> None:
    for name in ("prior", "prior.npz"):
        live = openvsf.from_point_vsf(vsf_of(written(DATA / name)))
        assert same(live, openvsf.load(DATA / name))


def test_an_estimated_k_std_is_a_variance_unless_said_otherwise() -> None:
    with pytest.warns(palpate.PalpateWarning):
        field = openvsf.load(DATA / "diag_ekf.npz")
        as_std = openvsf.load(DATA / "diag_ekf.npz", k_std="std")
    wanted = written(DATA / "diag_ekf.npz")
    assert (field.std == np.sqrt(wanted["K_std"].astype(float))).all()
    assert (as_std.std == wanted["K_std"]).all()
    assert (field.counts == wanted["N_obs"]).all() and field.counts.max() > 100
    assert field.std.max() == 10.0  # the variance of the prior is 100
    prior = openvsf.load(DATA / "prior.npz", k_std="variance")
    assert (prior.std == np.sqrt(written(DATA / "prior.npz")["K_std"])).all()


@pytest.mark.parametrize("name", ["box.npz", "diag_ekf.npz", "scattered.npz"])
def test_springs_on_no_lattice_are_moved_and_their_total_stiffness_is_kept(name: str) -> None:
    with pytest.warns(palpate.PalpateWarning, match="were moved to a lattice with a spacing of"):
        field = openvsf.load(DATA / name)
    wanted = written(DATA / name)
    points, stiffness = wanted["points"].astype(float), wanted["K"].astype(float)
    assert field.stiffness.sum() == pytest.approx(stiffness.sum(), rel=1e-12)
    assert (field.std**2).sum() == pytest.approx(wanted["K_std"].astype(float).sum(), rel=1e-12)
    assert field.counts.max() == wanted["N_obs"].max()
    cells = field.lattice.cells(points)
    assert (cells >= 0).all()
    gap = np.linalg.norm(field.lattice.points(cells) - points, axis=1).max()
    assert gap <= 0.5001 * np.sqrt(3.0) * field.lattice.spacing


@pytest.mark.filterwarnings("ignore::palpate.PalpateWarning")
def test_a_box_grid_of_unequal_spacing_keeps_every_spring_apart() -> None:
    assert len(openvsf.load(DATA / "box.npz")) == len(written(DATA / "box.npz")["K"])


def test_springs_in_one_cell_add_up() -> None:
    points = np.array([[0.5, 0.0, 0.4], [0.502, 0.0, 0.4], [0.56, 0.0, 0.4]])
    features = {"K_std": np.array([9.0, 16.0, 4.0]), "N_obs": np.array([3, 5, 1])}
    vsf = vsf_of({"points": points, "K": np.array([10.0, 20.0, 5.0]), **features})
    warning = r"by 0.000667 m on average and 0.002 m at most, 1 into the cell of another, where"
    with pytest.warns(palpate.PalpateWarning, match=warning):
        field = openvsf.from_point_vsf(vsf, spacing=0.02)
    assert field.stiffness.tolist() == [30.0, 5.0]
    assert field.std.tolist() == [5.0, 2.0] and field.counts.tolist() == [5, 1]
    assert np.abs(field.points - points[[0, 2]]).max() < 1e-12


@pytest.mark.filterwarnings("ignore::palpate.PalpateWarning")
def test_a_given_lattice_or_spacing_is_used() -> None:
    lattice = palpate.Lattice([0.3, -0.2, 0.2], 0.03, [14, 14, 12])
    for name in ("scattered.npz", "prior"):
        assert openvsf.load(DATA / name, lattice=lattice).lattice == lattice
        assert openvsf.load(DATA / name, spacing=0.03).lattice.spacing == 0.03
    with pytest.raises(ValueError, match="150 points lie outside the lattice; they reach from"):
        openvsf.load(DATA / "scattered.npz", lattice=palpate.Lattice([0, 0, 0], 0.02, [5, 5, 5]))
    with pytest.raises(ValueError, match="not both"):
        openvsf.load(DATA / "prior", lattice=lattice, spacing=0.03)
    with pytest.raises(ValueError, match="a spacing of 1e-09 m makes"):
        openvsf.load(DATA / "scattered.npz", spacing=1e-9)
    with pytest.raises(ValueError, match="`spacing` is -1"):
        openvsf.load(DATA / "prior", spacing=-1.0)
    with pytest.raises(ValueError, match="`k_std` is 'deviation'"):
        openvsf.load(DATA / "prior", k_std="deviation")  # type: ignore[arg-type]


@pytest.mark.filterwarnings("ignore::palpate.PalpateWarning")
def test_small_negative_stiffness_is_a_rounding_error_and_becomes_zero() -> None:
    wanted = written(DATA / "quad_prog.npz")["K"]
    assert wanted.min() < 0.0
    warning = rf"`K` are negative, down to {wanted.min():.3g} N/m: rounding errors of a solver"
    with pytest.warns(palpate.PalpateWarning, match=warning):
        field = openvsf.load(DATA / "quad_prog.npz")
    assert field.stiffness.min() == 0.0
    assert field.stiffness.sum() == pytest.approx(np.maximum(wanted, 0.0).sum(dtype=float), rel=1e-12)


@pytest.mark.parametrize("ending", [".npz", "/"])
def test_a_field_written_and_read_again_is_unchanged(
    learnt: palpate.Field, touch: palpate.Touch, tmp_path: Path, ending: str
) -> None:
    path = f"{tmp_path / 'field'}{ending}"
    openvsf.save(learnt, path)
    back = openvsf.load(path)
    assert same(back, learnt) and back.lattice == learnt.lattice
    assert (back.predict(touch.q[:120]) == learnt.predict(touch.q[:120])).all()
    arrays = written(Path(path))
    assert arrays.keys() - {"palpate"} == {"points", "K", "K_std", "K_var", "N_obs"}
    assert arrays["N_obs"].dtype == np.int64 and arrays["K"].shape == (len(learnt),)
    assert (arrays["points"] == learnt.points).all() and (arrays["K_std"] == learnt.std).all()
    if ending == ".npz":
        assert same(palpate.Field.load(path), learnt)


@pytest.mark.parametrize("ending", [".npz", "/"])
def test_k_std_is_still_a_std_after_openvsf_saves_the_field_again(
    learnt: palpate.Field, touch: palpate.Touch, tmp_path: Path, ending: str
) -> None:
    openvsf.save(learnt, f"{tmp_path / 'field'}{ending}")
    arrays = written(Path(f"{tmp_path / 'field'}{ending}"))
    arrays = {name: array[::-1].copy() for name, array in arrays.items()}
    contact: ContactSettings = {"friction": 0.45, "contact_distance_m": 0.02}
    back = openvsf.from_point_vsf(vsf_of(arrays), contact=contact)
    assert (back.stiffness == learnt.stiffness[::-1]).all()
    assert (back.std == learnt.std[::-1]).all()
    gap = back.predict(touch.q[:120]) - learnt.predict(touch.q[:120])
    assert np.abs(gap).max() < 1e-12
    estimated = arrays | {"K_std": arrays["K_std"] ** 2 / 2}
    assert openvsf.from_point_vsf(vsf_of(estimated)).std == pytest.approx(arrays["K_std"] / 2**0.5)


def test_a_file_of_palpate_alone_is_its_field(learnt: palpate.Field, tmp_path: Path) -> None:
    learnt.save(tmp_path / "field.npz")
    back = openvsf.load(tmp_path / "field.npz")
    assert same(back, learnt) and back.has_memory


def test_a_folder_that_openvsf_wrote_over_is_read_anew(learnt: palpate.Field, tmp_path: Path) -> None:
    folder = tmp_path / "field"
    openvsf.save(learnt, f"{folder}/")
    np.save(folder / "K.npy", 2.0 * learnt.stiffness)
    assert (openvsf.load(folder).stiffness == 2.0 * learnt.stiffness).all()


def test_files_of_others_stay_in_a_folder(learnt: palpate.Field, tmp_path: Path) -> None:
    folder = tmp_path / "field"
    (folder / "palpate").mkdir(parents=True)
    for name in ("notes.txt", "palpate/mine.txt"):
        (folder / name).write_text(name)
    np.save(folder / "height.npy", np.zeros(3))
    np.save(folder / "K.npy", np.zeros(3))
    with pytest.warns(palpate.PalpateWarning, match=r"also holds height\.npy"):
        openvsf.save(learnt, folder)
    for name in ("notes.txt", "palpate/mine.txt"):
        assert (folder / name).read_text() == name
    assert same(openvsf.load(folder), learnt)
    assert list(tmp_path.iterdir()) == [folder]


@pytest.mark.parametrize("ending", [".npz", "/"])
def test_a_file_is_whole_or_not_there(
    learnt: palpate.Field, tmp_path: Path, ending: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = f"{tmp_path / 'field'}{ending}"
    openvsf.save(learnt, path)
    before = written(Path(path))

    def full(*_: Any, **__: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "save", full)
    monkeypatch.setattr(np.lib.format, "write_array", full)
    with pytest.raises(palpate.FileError, match="cannot be written: No space left"):
        openvsf.save(palpate.Mapper().field(), path)
    monkeypatch.undo()
    assert list(tmp_path.iterdir()) == [Path(path)]
    assert all((before[name] == array).all() for name, array in written(Path(path)).items())


def test_a_folder_that_cannot_be_put_in_place_leaves_the_old_one(
    learnt: palpate.Field, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, rename = tmp_path / "field", Path.rename
    openvsf.save(learnt, f"{folder}/")

    def refused(self: Path, target: Path) -> Path:
        if self.name == "made":
            raise OSError(16, "Device or resource busy")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", refused)
    with pytest.raises(palpate.FileError, match="cannot be written: Device or resource busy"):
        openvsf.save(palpate.Mapper().field(), folder)
    monkeypatch.undo()
    assert same(openvsf.load(folder), learnt) and list(tmp_path.iterdir()) == [folder]


def test_a_name_without_ending_is_refused(learnt: palpate.Field, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"ends in \.npz, or in / for a folder"):
        openvsf.save(learnt, tmp_path / "field")
    with pytest.raises(palpate.FileError, match="cannot be written"):
        openvsf.save(learnt, tmp_path / "nowhere" / "field.npz")


@pytest.mark.parametrize("ending", [".npz", "/"])
def test_a_whole_box_holds_the_prior_of_untouched_cells(
    robot: palpate.Robot, plant: Path, tmp_path: Path, ending: str
) -> None:
    lattice = palpate.Lattice([0.2, -0.1, 0.4], 0.03, [8, 9, 7])
    mapper = palpate.Mapper(robot, "ekf", lattice=lattice)
    mapper.map(plant / "seq_000")
    field, path = mapper.field(), f"{tmp_path / 'box'}{ending}"
    openvsf.save(field, path, whole_box=True)
    box = openvsf.load(path)
    assert len(box) == lattice.n_cells > len(field) > 0
    stiffness, std, counts = field.query(box.points)
    assert (box.stiffness == stiffness).all() and field.untouched in box.stiffness
    assert (box.std == std).all() and (box.counts == counts).all()
    field.save(tmp_path / "bare.npz", memory=False)
    bare = palpate.Field.load(tmp_path / "bare.npz")
    with pytest.raises(ValueError, match="give `untouched_std`"):
        openvsf.save(bare, path, whole_box=True)
    with pytest.raises(ValueError, match="`untouched_std` is -1"):
        openvsf.save(bare, path, whole_box=True, untouched_std=-1.0)
    openvsf.save(bare, path)
    openvsf.save(bare, path, whole_box=True, untouched_std=3.0)
    assert not (Path(path) / "palpate" / "field.npz").exists()
    assert openvsf.load(path).std[box.counts == 0] == pytest.approx(3.0)


def test_a_box_of_absurd_size_is_not_written(learnt: palpate.Field, tmp_path: Path) -> None:
    huge = palpate.Lattice([-1, -1, -1], 0.001, [2000, 2000, 1000])
    field = palpate.Field.from_arrays(huge.points([7]), [1.0], lattice=huge)
    with pytest.raises(ValueError, match="4000000000 cells, and 33554432 at most are written"):
        openvsf.save(field, tmp_path / "box.npz", whole_box=True)


def member(array: Any) -> bytes:
    """An array as a member of an npz file."""
    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.asanyarray(array), allow_pickle=True)
    return stream.getvalue()


def pickled(thing: Any, protocol: int = 4) -> bytes:
    """A member whose header declares an object array, with any pickle."""
    header = member(np.array(None))
    return header[: 10 + int.from_bytes(header[8:10], "little")] + pickle.dumps(thing, protocol)


class Malice:
    """Creates a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __reduce__(self) -> tuple[Any, tuple[str]]:
        return (Path.touch, (self._path,))  # type: ignore[return-value]


GRID = written(DATA / "prior")
N = len(GRID["K"])


def archive(path: Path, **members: bytes | None) -> Path:
    """A copy of the npz file of `prior`, with members replaced or removed."""
    whole = {"points": member(GRID["points"]), "K": member(GRID["K"])}
    features = {"K_std": GRID["K_std"], "N_obs": GRID["N_obs"]}
    whole["features"] = member(np.array(features, dtype=object))
    with zipfile.ZipFile(path, "w") as held:
        for name, data in (whole | members).items():
            if data is not None:
                held.writestr(f"{name}.npy", data)
    return path


def test_old_pickles_are_read(tmp_path: Path) -> None:
    wanted = openvsf.load(archive(tmp_path / "new.npz"))
    features = np.array({"K_std": GRID["K_std"], "N_obs": GRID["N_obs"]}, dtype=object)
    for protocol in (0, 1, 2, 3, 5):
        path = archive(tmp_path / "old.npz", features=pickled(features, protocol))
        assert same(openvsf.load(path), wanted), protocol
    plain = pickled(features, 3).replace(b"cnumpy._core.multiarray", b"cnumpy.core.multiarray")
    assert b"numpy.core" in plain
    assert same(openvsf.load(archive(tmp_path / "numpy1.npz", features=plain)), wanted)


def test_a_pickle_that_runs_something_is_refused_and_not_run(tmp_path: Path) -> None:
    trace = tmp_path / "trace"
    for held in (Malice(trace), np.array({"K_std": Malice(trace)}, dtype=object)):
        path = archive(tmp_path / "bad.npz", features=pickled(held))
        with pytest.raises(palpate.FileError, match="`features` is a pickle that palpate does not read"):
            openvsf.load(path)
    for call in (b"cos\nsystem\n(S'touch x'\ntR.", b"cbuiltins\neval\n(S'1'\ntR.", b"cnumpy\nload\n."):
        header = pickled(None)[:-4]
        path = archive(tmp_path / "bad.npz", features=header + call)
        with pytest.raises(palpate.FileError, match=r"it wants to call|does not read"):
            openvsf.load(path)
    objects = np.array([Malice(trace)], dtype=object)
    with pytest.raises(palpate.FileError, match="`K` holds Python objects"):
        openvsf.load(archive(tmp_path / "bad.npz", K=member(objects)))
    assert not trace.exists()


def lengthened(array: NDArray[Any], n: int) -> bytes:
    """An array whose header declares n rows."""
    data = member(array)
    return data.replace(f"({len(array)},)".encode(), f"({n},)".encode().ljust(5), 1)


def with_value(array: NDArray[Any], value: float) -> bytes:
    changed = array.astype(float)
    changed.flat[4] = value
    return member(changed)


def features(**arrays: Any) -> bytes:
    return member(np.array(arrays, dtype=object))


BAD: list[tuple[dict[str, bytes | None], str]] = [
    ({"K": None}, "lacks the array `K`"),
    ({"points": None}, "lacks the array `points`"),
    ({"K": member(GRID["K"][:-1])}, rf"`K` has shape \({N - 1},\); wanted \({N},\)"),
    ({"points": member(GRID["points"][:, :2])}, rf"`points` has shape \({N}, 2\); wanted \(N, 3\)"),
    ({"points": member(np.zeros((0, 3))), "K": member(np.zeros(0))}, "holds no points"),
    ({"K": with_value(GRID["K"], np.nan)}, r"`K` holds nan in row 4 \(from 0\)"),
    ({"K": with_value(GRID["K"], np.inf)}, "`K` holds inf in row 4"),
    ({"points": with_value(GRID["points"], np.nan)}, r"`points` holds \[.*nan.*\] in row 1"),
    ({"K": with_value(GRID["K"], -1.0)}, "negative, down to -1 N/m: too far below 0"),
    ({"points": with_value(GRID["points"], 1e20)}, r"`points` reach 1e\+20 m"),
    ({"K": member(GRID["K"].astype("U"))}, "`K` is of <U.*; wanted an array of numbers"),
    ({"K": member(GRID["K"] * 1j)}, "`K` is of complex128"),
    ({"K": member(GRID["K"] > 1)}, "`K` is of bool"),
    ({"K": b"nonsense"}, "`K` is no array of NumPy"),
    ({"K": member(GRID["K"])[:-8]}, "`K` breaks off after 952 of 960 bytes"),
    ({"K": member(GRID["K"]) + b"more"}, "`K` is longer than its shape"),
    ({"K": lengthened(GRID["K"], 10**12)}, r"`K` says it has shape \(1000000000000,\)"),
    ({"axis_mode": member("anisotropic")}, "axis_mode 'anisotropic' and `K` of shape"),
    ({"K": member(np.ones((N, 3, 3)))}, rf"`K` of shape \({N}, 3, 3\); palpate's springs are equally stiff"),
    ({"features": member(np.zeros(3))}, "`features` is an array of float64; wanted a dict"),
    ({"features": member(np.array([1, None]))}, "`features` holds Python objects"),
    ({"features": pickled([1, 2])}, "`features` holds NoneType; wanted a dict|holds list"),
    ({"features": pickled(None)[:-1]}, "`features` is a pickle that palpate does not read"),
    ({"features": features(K_std=GRID["K_std"][1:])}, rf"`K_std` has shape \({N - 1},\)"),
    ({"features": features(K_std=[1.0] * N)}, "`K_std` is of list; wanted an array of numbers"),
    ({"features": features(K_std=-GRID["K_std"])}, "`K_std` holds -.*; wanted none below 0"),
    ({"features": features(N_obs=GRID["N_obs"] - 1)}, "`N_obs` holds -1; wanted whole numbers"),
    ({"features": features(N_obs=GRID["K"] / 1e3)}, "`N_obs` holds .*; wanted whole numbers"),
    ({"features": features(N_obs=GRID["N_obs"] + 2**40)}, r"`N_obs` holds 1.09951e\+12"),
]


@pytest.mark.parametrize(("members", "message"), BAD)
def test_a_file_that_is_no_field_is_refused_by_file_and_array(
    tmp_path: Path, members: dict[str, bytes | None], message: str
) -> None:
    path = archive(tmp_path / "bad.npz", **members)
    with pytest.raises(palpate.FileError, match=message) as error:
        openvsf.load(path)
    assert str(path) in str(error.value)


def truncated(path: Path) -> None:
    path.write_bytes(archive(path).read_bytes()[:-200])


def damaged(path: Path) -> None:
    data = bytearray(archive(path).read_bytes())
    data[400] ^= 1
    path.write_bytes(data)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (truncated, "is no npz file, or a broken one"),
        (damaged, "is no npz file, or a broken one: Bad CRC-32"),
        (lambda path: path.write_bytes(b""), "is no npz file"),
        (lambda path: np.save(path.open("wb"), GRID["K"]), "is no npz file"),
        (lambda path: path.mkdir(), r"has no points\.npy: it is no folder of a PointVSF"),
        (lambda path: None, "is not there"),
    ],
)
def test_a_broken_or_missing_file_is_refused(
    tmp_path: Path, make: Callable[[Path], object], message: str
) -> None:
    make(tmp_path / "bad.npz")
    with pytest.raises(palpate.FileError, match=message):
        openvsf.load(tmp_path / "bad.npz")


def test_springs_that_differ_by_direction_are_refused_with_a_remedy() -> None:
    with pytest.raises(palpate.FileError, match=r"axis_mode 'axis_aligned'.*mean over its axes"):
        openvsf.load(DATA / "axis_aligned.npz")
    live = vsf_of(GRID | {"K": np.ones((N, 3))})
    with pytest.raises(ValueError, match="equally stiff in all directions"):
        openvsf.from_point_vsf(live)


def test_broken_arrays_in_a_folder_name_their_file(tmp_path: Path) -> None:
    np.save(tmp_path / "points.npy", GRID["points"])
    (tmp_path / "K.npy").write_bytes(member(GRID["K"])[:-8])
    with pytest.raises(palpate.FileError, match=r"K\.npy` breaks off"):
        openvsf.load(tmp_path)
    np.save(tmp_path / "K.npy", np.array([Malice(tmp_path / "trace")], dtype=object))
    with pytest.raises(palpate.FileError, match=r"K\.npy` holds Python objects"):
        openvsf.load(tmp_path)
    assert not (tmp_path / "trace").exists()
