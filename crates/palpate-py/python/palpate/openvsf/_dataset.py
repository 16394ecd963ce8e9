"""Data sets of OpenVSF: `seq*/KEY.npy`, a folder for each touch, an array of T rows for each key.

OpenVSF numbers sequences in alphabetical order of their names, so `seq_10` comes before `seq_2`; palpate
otherwise sorts by number. Numbers in a configuration are OpenVSF's.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from operator import index
from pathlib import Path
from typing import Any, SupportsIndex, TypeAlias

from .._palpate import FileError, Log, LogError, Touch, open_log
from ._arrays import read_npy

Touches: TypeAlias = Log | list[Touch]
"""The type that functions take as log."""


def open_dataset(
    path: str | os.PathLike[str],
    *,
    sequences: Iterable[SupportsIndex] | None = None,
    angles: str = "angles",
    torques: str = "torques",
    **options: Any,
) -> Touches:
    """Opens the sequences of a data set in OpenVSF's order, or those with the numbers in `sequences`.

    Each is a folder with the arrays `angles`, (T, n_joints) rad, and `torques`, (T, n_joints) N·m, as
    npy files of these names; others are not read, except a `time`. `options` are those of
    `palpate.open_log`. The result is a `Log`, which reads one touch at a time. If the arrays have
    other names, such as `sim_torques`, the result is a list of all touches.

    Raises LogError, which names the file, and ValueError for a sequence that does not exist.
    """
    root = Path(path)
    folders = [root / name for name in sequence_names(root)]
    if sequences is not None:
        folders = [folders[_number(root, one, len(folders))] for one in sequences]
    if not folders:
        raise ValueError("`sequences` is empty; wanted at least one")
    for folder in folders:
        if not folder.is_dir():
            raise LogError(f"`{folder}` is no folder, though OpenVSF counts it as a sequence: move it elsewhere")
        for key in (angles, torques):
            if not (folder / f"{key}.npy").is_file():
                raise LogError(f"`{folder}` has no {key}.npy")
    if (angles, torques) == ("angles", "torques"):
        return open_log(folders, **options)
    if options:
        raise ValueError(f"{', '.join(options)}: only for arrays called `angles` and `torques`")
    return [_touch(folder, angles, torques) for folder in folders]


def sequence_names(root: Path) -> list[str]:
    """The names of the sequences, in the order of their numbers."""
    try:
        names = sorted(entry.name for entry in root.iterdir() if entry.name.startswith("seq"))
    except OSError as error:
        raise LogError(f"`{root}` cannot be read: {error.strerror or error}") from error
    if not names:
        raise LogError(f"`{root}` holds no sequences: OpenVSF's are folders called seq…")
    return names


def _number(root: Path, one: SupportsIndex, n: int) -> int:
    if hasattr(one, "__index__") and 0 <= index(one) < n:
        return index(one)
    raise ValueError(f"`sequences` holds {one!r}; `{root}` has {n}, numbered from 0 on")


def _touch(folder: Path, angles: str, torques: str) -> Touch:
    try:
        q, tau = read_npy(folder / f"{angles}.npy"), read_npy(folder / f"{torques}.npy")
        return Touch(q, tau, folder.name)
    except FileError as error:
        raise LogError(str(error)) from None
    except (TypeError, ValueError) as error:
        raise LogError(f"`{folder}`, `{angles}` as q and `{torques}` as tau: {error}") from None
