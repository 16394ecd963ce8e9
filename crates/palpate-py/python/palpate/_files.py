"""The files that tasks read, and their transfer to workers that do not have them."""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

_LEFT_OUT = {".avi", ".gif", ".jpeg", ".jpg", ".mkv", ".mov", ".mp4", ".png", ".tif", ".tiff", ".webm"}
"""Suffixes of images and videos beside a log, which are not read."""


@dataclass(frozen=True)
class File:
    """A file, with size and time of its present version."""

    path: str
    """Absolute path."""
    size: int
    changed_ns: int

    def is_here(self) -> bool:
        """Whether this machine has the same version of the file."""
        try:
            about = os.stat(self.path)
        except OSError:
            return False
        return (about.st_size, about.st_mtime_ns) == (self.size, self.changed_ns)


class Files:
    """All files at some paths, including those in folders; missing ones are left out.

    Only their digest is sent to other processes.
    """

    def __init__(self, paths: Iterable[str]) -> None:
        self.each = tuple(_files(paths))
        self.digest = digest([[file.path, file.size, file.changed_ns] for file in self.each])

    def __getstate__(self) -> dict[str, Any]:
        return {"each": (), "digest": self.digest}


def digest(plain: Any) -> str:
    """A digest of plain data."""
    return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()[:32]


def _files(paths: Iterable[str]) -> Iterator[File]:
    taken = set()
    for path in map(Path, paths):
        for file in sorted(_within(path)) if path.is_dir() else [path]:
            if file not in taken and file.is_file() and file.suffix.lower() not in _LEFT_OUT:
                taken.add(file)
                about = file.stat()
                yield File(str(file), about.st_size, about.st_mtime_ns)


def _within(folder: Path) -> Iterator[Path]:
    """All files in a folder; follows links, but visits no folder twice."""
    seen: set[str] = set()
    for at, folders, files in os.walk(folder, followlinks=True):
        folders[:] = [name for name in folders if os.path.realpath(os.path.join(at, name)) not in seen]
        seen.update(os.path.realpath(os.path.join(at, name)) for name in folders)
        yield from (Path(at, name) for name in files)


_Content = Any
"""Content of a file, an object with the buffer protocol; None if the caller does not send it."""


class _Copies:
    """Copies of the files of one log, in a folder that is removed at the end of this process."""

    def __init__(self) -> None:
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._files: Sequence[File] = ()

    def folder(self, files: Sequence[File], contents: Callable[[], Iterable[_Content]]) -> str:
        """The folder with a copy of each file at its own path."""
        if self._folder is None or self._files != files:
            if self._folder is not None:
                self._folder.cleanup()  # only one log is kept
            self._folder = tempfile.TemporaryDirectory(prefix="palpate-")
            self._files = ()
            for file, content in zip(files, contents(), strict=True):
                if content is None:
                    raise FileNotFoundError(
                        f"a worker does not see {file.path}, which was not sent to it: files of more than "
                        "1 GiB together are sent only if the cluster has several computers when their "
                        "first task begins; put them in a folder that all workers can read"
                    )
                copy = Path(self._folder.name + file.path)
                copy.parent.mkdir(parents=True, exist_ok=True)
                copy.write_bytes(content)
            self._files = files
        return self._folder.name


_copies = _Copies()


def brought(files: Sequence[File], contents: Callable[[], Iterable[_Content]]) -> str:
    """The prefix of paths under which files are found on this machine: empty if all are here already."""
    return "" if all(file.is_here() for file in files) else _copies.folder(files, contents)
