"""Saves results, one file each and never partially, so that interrupted work can be continued."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from ._tasks import Outcome


class Kept:
    """A folder of outcomes by the keys of their tasks; with None, nothing is kept."""

    def __init__(self, folder: str | os.PathLike[str] | None) -> None:
        self._folder = None if folder is None else Path(folder)
        if self._folder is not None:
            self._folder.mkdir(parents=True, exist_ok=True)

    def get(self, key: str) -> Outcome | None:
        """The outcome kept under a key; None if it is missing or damaged."""
        if self._folder is None:
            return None
        try:
            with np.load(self._path(key), allow_pickle=False) as arrays:

                def with_array(plain: dict[str, Any]) -> Any:
                    return arrays[plain["array"]] if plain.keys() == {"array"} else plain

                text = arrays["outcome"].tobytes()
                return Outcome(**json.loads(text, object_hook=with_array))
        except Exception:  # damage causes many types: zlib.error, EOFError, NotImplementedError
            return None  # the task is done and written again

    def put(self, key: str, outcome: Outcome) -> None:
        """Keeps a result; errors are not kept, since their cause may be gone next time."""
        if self._folder is None or outcome.error is not None:
            return
        arrays: dict[str, Any] = {}

        def name_of(array: Any) -> dict[str, str]:
            name = f"array{len(arrays)}"
            arrays[name] = array
            return {"array": name}

        text = json.dumps(vars(outcome), default=name_of)  # `name_of` collects the arrays
        arrays["outcome"] = np.frombuffer(text.encode(), dtype=np.uint8)
        path = self._path(key)
        begun = path.with_suffix(f".{os.getpid()}.part")
        try:
            with open(begun, "wb") as file:
                np.savez_compressed(file, **arrays)
            os.replace(begun, path)
        finally:
            begun.unlink(missing_ok=True)

    def _path(self, key: str) -> Path:
        assert self._folder is not None
        return self._folder / f"{key}.npz"
