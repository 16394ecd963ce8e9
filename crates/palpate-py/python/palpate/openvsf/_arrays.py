"""Reads the arrays of OpenVSF's files, without executing code from their pickles.

| array             | shape | type    | meaning                                             |
|-------------------|-------|---------|-----------------------------------------------------|
| `points`          | N x 3 | f4, f8  | rest points, m                                      |
| `K`               | N     | f4, f8  | stiffness, N/m                                      |
| `axis_mode`       |       | text    | `isotropic`: palpate supports no other              |
| `features`        |       | pickle  | dict of arrays: `K_std`, `N_obs`, and others        |

In a folder, each array and each feature is a `.npy` file; an `.npz` file has the features as a pickled
dict. Of a pickle, only the calls that create arrays are allowed. Values are not interpreted here.
"""

from __future__ import annotations

import io
import math
import pickle
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from .._palpate import FileError

MAX_BYTES = 2 << 30
"""Largest size of an unpacked array, bytes; the limit is that of palpate's own fields."""

STATED = ("K_std", "K_var", "N_obs")
"""The features of a spring that are read."""

_CORE = "numpy._core" if int(np.__version__.split(".")[0]) >= 2 else "numpy.core"
"""Name of NumPy's core module; pickles of one version are readable by the other."""

_ARRAYS_ARE_MADE_OF = {
    ("numpy.core.multiarray", "_reconstruct"),
    ("numpy.core.numeric", "_frombuffer"),
    ("numpy", "ndarray"),
    ("numpy", "dtype"),
    ("_codecs", "encode"),  # bytes, before protocol 3
}


@dataclass(frozen=True)
class Arrays:
    """Content of a file: `points` (N, 3) m, `stiffness` (N,) N/m, and the `features` in `STATED`."""

    points: NDArray[np.float64]
    stiffness: NDArray[np.float64]
    features: dict[str, NDArray[np.float64]]


def read(path: Path) -> Arrays:
    """Reads a folder or an npz file. Raises FileError, which names the file and the array."""
    with _file_errors(path):
        if path.is_dir():
            return _of_folder(path)
        with zipfile.ZipFile(path) as archive:
            return _of_archive(path, archive)


@contextmanager
def _file_errors(path: Path) -> Iterator[None]:
    """Converts Python's errors to a FileError that names the file."""
    try:
        yield
    except FileNotFoundError as error:
        raise FileError(f"`{error.filename or path}` is not there") from error
    except zipfile.BadZipFile as error:
        raise FileError(f"`{path}` is no npz file, or a broken one: {error}") from error
    except (OSError, EOFError, zlib.error, NotImplementedError, RuntimeError) as error:
        raise FileError(f"`{path}` cannot be read: {error}") from error
    except MemoryError as error:
        raise FileError(f"`{path}` needs more memory than there is") from error


def has_settings(path: Path) -> bool:
    """Whether an npz file is also a field of palpate."""
    with _file_errors(path), zipfile.ZipFile(path) as archive:
        return "palpate.npy" in archive.namelist()


def read_npy(path: Path) -> Any:
    """The array of one npy file. Raises FileError."""
    with _file_errors(path), path.open("rb") as stream:
        return _array(stream, path.stat().st_size, f"`{path}`")


def _of_folder(path: Path) -> Arrays:
    def array(name: str) -> Any:
        return read_npy(path / f"{name}.npy")

    for name in ("points", "K"):
        if not (path / f"{name}.npy").is_file():
            raise FileError(f"`{path}` has no {name}.npy: it is no folder of a PointVSF")
    features = {name: array(name) for name in STATED if (path / f"{name}.npy").is_file()}
    return checked(f"`{path}`", array("points"), array("K"), None, features)


def _of_archive(path: Path, archive: zipfile.ZipFile) -> Arrays:
    names = set(archive.namelist())

    def array(name: str) -> Any:
        with archive.open(f"{name}.npy") as stream:
            size = archive.getinfo(f"{name}.npy").file_size
            return _array(stream, size, f"`{path}`: `{name}`", _dict if name == "features" else None)

    for name in ("points", "K"):
        if f"{name}.npy" not in names:
            raise FileError(f"`{path}` lacks the array `{name}`: it is no file of a PointVSF")
    mode = array("axis_mode") if "axis_mode.npy" in names else None
    features = array("features") if "features.npy" in names else {}
    return checked(f"`{path}`", array("points"), array("K"), mode, features)


def checked(what: str, points: Any, stiffness: Any, mode: Any, features: dict[str, Any]) -> Arrays:
    """Checks and converts arrays to float64 of one length; `mode` is the axis mode, None if unknown.

    Raises FileError, whose message begins with `what`.
    """
    shape = np.shape(stiffness)
    if (mode is not None and str(mode) != "isotropic") or shape[1:] not in [(), (1,)]:
        said = f"axis_mode {str(mode)!r} and " if mode is not None else ""
        raise FileError(
            f"{what} has {said}`K` of shape {shape}; palpate's springs are equally stiff in all directions:"
            " estimate with axis_mode='isotropic', or save a copy whose stiffness is (N,), such as the"
            " mean over its axes"
        )
    if np.shape(points)[1:] != (3,):
        raise FileError(f"{what}: `points` has shape {np.shape(points)}; wanted (N, 3)")
    n = len(points)
    if n == 0:
        raise FileError(f"{what} holds no points")
    return Arrays(
        _numbers(what, "points", points),
        _row(what, "K", stiffness, n),
        {name: _row(what, name, features[name], n) for name in STATED if name in features},
    )


def _row(what: str, name: str, array: Any, n: int) -> NDArray[np.float64]:
    shape = np.shape(array)
    if shape not in [(n,), (n, 1)]:
        raise FileError(f"{what}: `{name}` has shape {shape}; wanted ({n},), as `points` has rows")
    return _numbers(what, name, array).reshape(n)


def _numbers(what: str, name: str, array: Any) -> NDArray[np.float64]:
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu":
        found = array.dtype if isinstance(array, np.ndarray) else type(array).__name__
        raise FileError(f"{what}: `{name}` is of {found}; wanted an array of numbers")
    numbers = array.astype(np.float64)
    if not np.isfinite(numbers).all():
        row = int(np.argwhere(~np.isfinite(numbers))[0][0])
        raise FileError(f"{what}: `{name}` holds {numbers[row]} in row {row} (from 0)")
    return numbers


def _array(
    stream: IO[bytes], size: int, what: str, unpickled: Callable[[IO[bytes], str], Any] | None = None
) -> Any:
    """Reads an array from a stream of `size` bytes; a header that does not fit is refused before data is read."""
    try:
        version = npy.read_magic(stream)
        header = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}[version]
        shape, fortran, dtype = header(stream)
    except (ValueError, KeyError) as error:
        raise FileError(f"{what} is no array of NumPy: {error}") from error
    if dtype.hasobject:
        if unpickled is not None and shape == ():
            return unpickled(stream, what)
        raise FileError(f"{what} holds Python objects; wanted numbers")
    if unpickled is not None:
        raise FileError(f"{what} is an array of {dtype}; wanted a dict of arrays")
    needed = math.prod(shape) * dtype.itemsize
    if needed > min(size, MAX_BYTES):
        raise FileError(
            f"{what} says it has shape {shape} of {dtype}, {needed} bytes; it holds {size}, and "
            f"at most {MAX_BYTES} are read"
        )
    data = stream.read(needed)
    if len(data) < needed:
        raise FileError(f"{what} breaks off after {len(data)} of {needed} bytes")
    if stream.read(1):  # reading to the end also checks the checksum of a zip member
        raise FileError(f"{what} is longer than its shape {shape} of {dtype}")
    return np.frombuffer(data, dtype).reshape(shape, order="F" if fortran else "C")


class _ArraysOnly(pickle.Unpickler):
    """Unpickles arrays; refuses all other calls."""

    def find_class(self, module: str, name: str) -> Any:
        plain = module.replace("numpy._core.", "numpy.core.")
        if (plain, name) not in _ARRAYS_ARE_MADE_OF:
            raise pickle.UnpicklingError(f"it wants to call {module}.{name}")
        return super().find_class(plain.replace("numpy.core", _CORE), name)


def _dict(stream: IO[bytes], what: str) -> dict[str, Any]:
    """Reads the dict in a pickled array of no dimensions."""
    data = stream.read(MAX_BYTES + 1)
    if len(data) > MAX_BYTES:
        raise FileError(f"{what} unpacks to more than {MAX_BYTES} bytes")
    try:
        array = _ArraysOnly(io.BytesIO(data)).load()
    except Exception as error:  # a broken pickle may raise anything
        raise FileError(
            f"{what} is a pickle that palpate does not read: {error}; only arrays of numbers are read"
        ) from error
    held = array.item() if isinstance(array, np.ndarray) and array.shape == () else None
    if not isinstance(held, dict):
        raise FileError(f"{what} holds {type(held).__name__}; wanted a dict of arrays")
    return held
