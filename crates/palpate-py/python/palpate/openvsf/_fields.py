"""Conversion of fields from and to OpenVSF: files, folders and objects in memory.

A spring is the same in both: the force on a point displaced by u is −K u. But points of OpenVSF may be
anywhere, and it has springs only at its points, so all other cells have stiffness 0.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import warnings
import zipfile
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from .._palpate import Field, FileError, Lattice, PalpateWarning
from ..settings import AnySettings, FieldSections
from ..settings import Path as _Path
from . import _lattice
from ._arrays import STATED, Arrays, checked, has_settings, read
from ._lattice import NEAR_CELLS, Moved, Springs

if TYPE_CHECKING:
    from typing_extensions import Unpack


TINY = 1e-3
"""A negative stiffness counts as zero, as solvers produce it, up to this share of the largest one or of 1 N/m."""

FAR_M = 1e4
"""Largest coordinate of a point, m; a larger one is an error, since the unit is probably wrong."""

MOST_CELLS = 1 << 25
"""Largest number of cells that `whole_box` writes: 1.9 GB."""

_OWN = Path("palpate") / "field.npz"
"""Path of palpate's own file in a folder."""


def load(
    path: _Path,
    *,
    lattice: Lattice | None = None,
    spacing: float | None = None,
    k_std: Literal["variance", "std"] | None = None,
    robot: str | None = None,
    settings: AnySettings | None = None,
    **sections: Unpack[FieldSections],
) -> Field:
    """Reads a field that `PointVSF.save` wrote, an npz file or a folder.

    Points on a lattice of equal spacing, to 0.1 % of the spacing, become its cells. All others are
    moved to the nearest point of `lattice`, or of a lattice with `spacing`, m, which is deduced if left
    out; springs in the same cell are added, and a PalpateWarning reports how far points were moved.

    `k_std` is the meaning of the feature `K_std`: "std", N/m, as before an estimation, or "variance",
    (N/m)², as after one. If left out, it is a variance if some `N_obs` are above 0 and `K_var` is not its
    square. Without the features, std is 0 and counts are 1. `robot`, `settings` and `sections` give the
    field its robot (`kinova_gen3`), contact model, and sign, gravity and tare of torques, which OpenVSF
    does not store; a file that palpate wrote contains its own, which are used if no argument is given.

    Raises FileError, which names the file and the array, and ValueError for a lattice that does not
    contain the points. Code in the pickle of an npz file is not executed.
    """
    path = Path(path)
    arrays = read(path)
    own = _own(path, arrays)
    asked = (lattice, spacing, k_std, robot, settings, *sections.values())
    if own is not None and all(one is None for one in asked):
        return own
    given = {"robot": robot or "kinova_gen3", "settings": settings, **sections}
    return _field(f"`{path}`", arrays, lattice, spacing, k_std, given)


def from_point_vsf(
    vsf: Any,
    *,
    lattice: Lattice | None = None,
    spacing: float | None = None,
    k_std: Literal["variance", "std"] | None = None,
    robot: str = "kinova_gen3",
    settings: AnySettings | None = None,
    **sections: Unpack[FieldSections],
) -> Field:
    """Converts a `PointVSF` in memory, as `load` does a file. Does not import OpenVSF."""

    def numbers(tensor: Any) -> NDArray[np.float64]:
        return np.array(tensor.detach().cpu().numpy(), dtype=np.float64)

    features = {name: numbers(vsf.features[name]) for name in STATED if name in vsf.features}
    given = {"robot": robot, "settings": settings, **sections}
    try:
        points, stiffness = numbers(vsf.rest_points), numbers(vsf.stiffness)
        arrays = checked("`vsf`", points, stiffness, vsf.axis_mode, features)
        return _field("`vsf`", arrays, lattice, spacing, k_std, given)
    except FileError as error:
        raise ValueError(str(error)) from None


def save(
    field: Field, path: _Path, *, whole_box: bool = False, untouched_std: float | None = None
) -> None:
    """Writes a field that `PointVSF.load` reads: an `.npz`, or a folder if `path` is one or ends in /.

    Features are `K_std`, the standard deviation, N/m, its square `K_var`, by which `load` recognises
    that `K_std` is no variance, and `N_obs`. Cells that were never touched and have no prior of their own
    are left out; `whole_box` writes them too, with stiffness and std of the prior (`untouched_std`, N/m,
    if the field has no memory). Without `whole_box`, the npz file is also a field of palpate, without
    memory. The file is never written partially; other files in a folder are kept.

    Raises FileError if it cannot be written, ValueError if `path` is neither or the box is too large.
    """
    text = os.fspath(path)
    separators = tuple(filter(None, (os.sep, os.altsep)))
    as_folder = text.endswith(separators) or os.path.isdir(text)
    if not as_folder and not text.endswith(".npz"):
        raise ValueError(f"`{text}`: wanted a name that ends in .npz, or in / for a folder")
    arrays = _arrays(field, whole_box, untouched_std)
    write = _save_folder if as_folder else _save_npz
    try:
        write(arrays, None if whole_box else field, Path(os.path.realpath(text)))
    except OSError as error:
        raise FileError(f"`{text}` cannot be written: {error.strerror or error}") from error


def to_point_vsf(
    field: Field, *, whole_box: bool = False, untouched_std: float | None = None
) -> Any:
    """A `PointVSF` in memory with the arrays that `save` would write. Imports OpenVSF and torch."""
    torch: Any = import_module("torch")
    vsf_type: Any = import_module("vsf").PointVSF
    arrays = _arrays(field, whole_box, untouched_std)
    vsf = vsf_type(torch.from_numpy(arrays["points"].copy()))
    vsf.stiffness = torch.from_numpy(arrays["K"].copy())
    for name in STATED:
        vsf.set_feature(name, torch.from_numpy(arrays[name].copy()))
    return vsf


def _field(
    what: str,
    arrays: Arrays,
    lattice: Lattice | None,
    spacing: float | None,
    k_std: Literal["variance", "std"] | None,
    given: dict[str, Any],
) -> Field:
    """The field of arrays at the points of a lattice; `given` are further arguments of `from_arrays`."""
    points = arrays.points
    far_m = float(np.abs(points).max())
    if far_m > FAR_M:
        raise FileError(f"{what}: `points` reach {far_m:.6g} m; wanted coordinates in m, in the frame of the robot")
    counts = _counts(what, arrays)
    variance = _variance(what, arrays, counts, k_std)
    springs = Springs(points, _not_negative(what, arrays.stiffness), variance, counts)
    if lattice is None:
        lattice = _lattice.lattice_of(points, spacing)
    elif spacing is not None:
        raise ValueError("`lattice` has a spacing of its own; give it or `spacing`, not both")
    springs, moved = _lattice.brought_to(lattice, springs)
    _warn_if_moved(what, lattice, len(points), moved)
    std = np.sqrt(springs.variance)
    arguments = (springs.points, springs.stiffness, std, springs.counts)
    return Field.from_arrays(*arguments, lattice=lattice, **given)


def _counts(what: str, arrays: Arrays) -> NDArray[np.float64]:
    counts = arrays.features.get("N_obs")
    if counts is None:
        return np.ones(len(arrays.points))
    wrong = (counts < 0) | (counts >= 1 << 32) | (counts != np.floor(counts))
    if wrong.any():
        raise FileError(f"{what}: `N_obs` holds {counts[wrong][0]:g}; wanted whole numbers from 0 on")
    return counts


def _variance(
    what: str, arrays: Arrays, counts: NDArray[np.float64], k_std: Literal["variance", "std"] | None
) -> NDArray[np.float64]:
    """The variance from `K_std`, (N/m)²."""
    if k_std not in ("variance", "std", None):
        raise ValueError(f'`k_std` is {k_std!r}; wanted "variance" or "std"')
    stated = arrays.features.get("K_std")
    if stated is None:
        return np.zeros(len(counts))
    if (stated < 0.0).any():
        raise FileError(f"{what}: `K_std` holds {stated.min():g}; wanted none below 0")
    if k_std is None:
        square = arrays.features.get("K_var")
        is_std = square is not None and np.allclose(square, stated**2, rtol=1e-6, atol=0.0)
        estimated = "N_obs" in arrays.features and bool((counts > 0).any())
        k_std = "variance" if estimated and not is_std else "std"
    return stated if k_std == "variance" else stated**2


def _not_negative(what: str, stiffness: NDArray[np.float64]) -> NDArray[np.float64]:
    negative = stiffness[stiffness < 0.0]
    if len(negative) == 0:
        return stiffness
    found = f"{what}: {len(negative)} of {len(stiffness)} values of `K` are negative, down to"
    found = f"{found} {negative.min():.3g} N/m"
    if negative.min() < -TINY * max(1.0, float(stiffness.max())):
        raise FileError(f"{found}: too far below 0 for rounding errors of a solver")
    warnings.warn(f"{found}: rounding errors of a solver, taken as 0", PalpateWarning, stacklevel=4)
    return np.maximum(stiffness, 0.0)


def _warn_if_moved(what: str, lattice: Lattice, n: int, moved: Moved) -> None:
    if moved.largest_m <= NEAR_CELLS * lattice.spacing and moved.merged == 0:
        return
    shared = f", {moved.merged} into the cell of another, where stiffness adds up" if moved.merged else ""
    warnings.warn(
        f"{what}: its {n} points were moved to a lattice with a spacing of "
        f"{lattice.spacing:.6g} m, by {moved.mean_m:.3g} m on average and {moved.largest_m:.3g} m at "
        f"most{shared}; `lattice` or `spacing` set another",
        PalpateWarning,
        stacklevel=4,
    )


def _own(path: Path, arrays: Arrays) -> Field | None:
    """The field as palpate wrote it, if the arrays for OpenVSF were not changed since."""
    inside = path / _OWN if path.is_dir() else path
    if not inside.is_file() or (inside == path and not has_settings(path)):
        return None
    own = Field.load(inside)
    wanted = _arrays(own)
    found = {"points": arrays.points, "K": arrays.stiffness, **arrays.features}
    return own if all(np.array_equal(wanted[key], found[key]) for key in found) else None


def _arrays(
    field: Field, whole_box: bool = False, untouched_std: float | None = None
) -> dict[str, NDArray[Any]]:
    """The arrays that `save` writes."""
    points, stiffness, std, counts = field.points, field.stiffness, field.std, field.counts
    if whole_box:
        points = _box(field.lattice)
        stiffness, std, counts = field.query(points)
        std = _with_untouched(std, untouched_std)
    # OpenVSF increments N_obs, which must be signed: torch cannot add uint32.
    features = {"K_std": std, "K_var": std**2, "N_obs": counts.astype(np.int64)}
    return {"points": points, "K": stiffness, **features}


def _box(lattice: Lattice) -> NDArray[np.float64]:
    """All points of a lattice."""
    n = lattice.n_cells
    if n > MOST_CELLS:
        raise ValueError(
            f"the box has {n} cells, and {MOST_CELLS} at most are written; leave `whole_box` out, or "
            "learn the field in a smaller lattice"
        )
    return lattice.points(np.arange(n))


def _with_untouched(std: NDArray[np.float64], untouched: float | None) -> NDArray[np.float64]:
    """Standard deviations, with NaN, for cells never touched, replaced by `untouched`."""
    if not np.isnan(std).any():
        return std
    if untouched is None:
        raise ValueError(
            "the field has no memory, and so no std of untouched cells; give "
            "`untouched_std`, N/m"
        )
    if not (np.isfinite(untouched) and untouched >= 0.0):
        raise ValueError(f"`untouched_std` is {untouched}; wanted N/m, none below 0")
    return np.where(np.isnan(std), untouched, std)


def _save_npz(arrays: dict[str, NDArray[Any]], own: Field | None, target: Path) -> None:
    features = np.array({name: arrays[name] for name in STATED}, dtype=object)
    added: dict[str, NDArray[Any]] = {"axis_mode": np.array("isotropic"), "features": features}
    with tempfile.TemporaryDirectory(prefix=".palpate-", dir=target.parent) as scratch:
        made = Path(scratch) / target.name
        if own is not None:
            own.save(made, memory=False)
        else:
            added |= {"points": arrays["points"], "K": arrays["K"]}
        with zipfile.ZipFile(made, "a", zipfile.ZIP_DEFLATED) as archive:
            for name, array in added.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as stream:
                    npy.write_array(stream, array, allow_pickle=True)
        made.replace(target)


def _save_folder(arrays: dict[str, NDArray[Any]], own: Field | None, target: Path) -> None:
    ours = {f"{name}.npy" for name in arrays}
    with tempfile.TemporaryDirectory(prefix=".palpate-", dir=target.parent) as scratch:
        made, before = Path(scratch) / "made", Path(scratch) / "before"
        made.mkdir()
        if target.is_dir():
            _link_others(target, made, ours)
        for name, array in arrays.items():
            np.save(made / f"{name}.npy", array)
        (made / _OWN).unlink(missing_ok=True)
        if own is not None:
            (made / _OWN).parent.mkdir(exist_ok=True)
            own.save(made / _OWN, memory=False)
        try:
            if target.is_dir():
                target.rename(before)
            made.rename(target)
        except BaseException:
            if before.is_dir() and not target.exists():
                before.rename(target)
            raise


def _link_others(target: Path, made: Path, ours: set[str]) -> None:
    """Links all files of a folder that `save` does not write into another folder."""

    def others(folder: str, names: list[str]) -> set[str]:
        return ours & set(names) if Path(folder) == target else set()

    shutil.copytree(
        target, made, symlinks=True, ignore=others, copy_function=_linked, dirs_exist_ok=True
    )
    strange = sorted(path.name for path in made.iterdir() if path.suffix in (".npy", ".npz"))
    if strange:
        warnings.warn(
            f"`{target}` also holds {', '.join(strange)}, which OpenVSF takes for features of these "
            "points",
            PalpateWarning,
            stacklevel=4,
        )


def _linked(source: str, target: str) -> str:
    try:
        os.link(source, target, follow_symlinks=False)
    except OSError:  # a file system without links
        shutil.copy2(source, target, follow_symlinks=False)
    return target
