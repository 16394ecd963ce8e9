"""Shows the progress of long work: as a bar of tqdm, or by a callable of the caller."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from importlib import import_module
from typing import Any

Progress = bool | Callable[[int, int | None], object] | None
"""None for a bar if a terminal or notebook shows it, True, False, or a callable that gets the numbers of steps done
and in total."""


class Shown:
    """Receives the progress from the compiled part; this base class shows nothing."""

    def __call__(self, done: int, steps: int | None, doing: str) -> None:
        pass

    def close(self) -> None:
        pass


class _Callback(Shown):
    """Passes the progress to a callable of the caller, without the description."""

    def __init__(self, callback: Callable[[int, int | None], object]) -> None:
        self._callback = callback

    def __call__(self, done: int, steps: int | None, doing: str) -> None:
        self._callback(done, steps)


class _Bar(Shown):
    """Shows a bar of tqdm, a new one for each stage of the work."""

    def __init__(self) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # tqdm warns if a notebook has no widgets, and shows a text bar
            self._tqdm: Any = import_module("tqdm.auto").tqdm
        self._bar: Any = None
        self._stretch: tuple[str, int | None] | None = None

    def __call__(self, done: int, steps: int | None, doing: str) -> None:
        if self._stretch != (doing, steps):
            self.close()
            self._bar = self._tqdm(total=steps, desc=doing, leave=False)
            self._stretch = (doing, steps)
        self._bar.update(done - self._bar.n)

    def close(self) -> None:
        if self._bar is not None:
            self._bar.close()
        self._bar = self._stretch = None


def of(progress: Progress) -> Shown:
    """The object that shows this kind of progress."""
    if progress is None:
        progress = _is_seen() and _has_tqdm()
    if progress is False:
        return Shown()
    if progress is True:
        if not _has_tqdm():
            raise ImportError("progress=True needs tqdm: pip install 'palpate[progress]'")
        return _Bar()
    if callable(progress):
        return _Callback(progress)
    raise TypeError(
        f"`progress` is {progress!r}; wanted None, True, False or a callable of the steps done and in total"
    )


def _has_tqdm() -> bool:
    from importlib.util import find_spec

    return find_spec("tqdm") is not None


def _is_seen() -> bool:
    """Whether a terminal or a notebook shows printed text."""
    if sys.stderr is not None and sys.stderr.isatty():
        return True
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    return shell is not None and "IPKernelApp" in shell.config
