"""A section of a configuration: each key is read with its type, and a key that is not read is an error."""

from __future__ import annotations

from collections.abc import Iterator
from difflib import get_close_matches
from math import isfinite
from pathlib import Path
from typing import Any, TypeVar

from .._palpate import FileError

Kind = TypeVar("Kind")


class Section:
    """The entries of a mapping; errors name the file, the section and the key."""

    def __init__(self, path: Path, name: str, entries: object) -> None:
        self._path, self._name = path, name
        if entries is None:
            entries = {}
        if not isinstance(entries, dict) or not all(isinstance(key, str) for key in entries):
            raise self.error("", f"is {_shown(entries)}; wanted keys with their values")
        self._entries: dict[str, Any] = entries
        self._asked: set[str] = set()

    def error(self, key: str, why: str) -> FileError:
        """An error about a key, or about the section itself if the key is empty."""
        name = self.named(key)
        return FileError(f"`{self._path}`: {f'`{name}`' if name else 'the file'} {why}")

    def named(self, key: str) -> str:
        return ".".join(filter(None, (self._name, key)))

    def keys(self) -> list[str]:
        return list(self._entries)

    def __contains__(self, key: str) -> bool:
        return key in self._entries

    def value(self, key: str) -> Any:
        """The value of a key, of any type; None if there is none."""
        self._asked.add(key)
        return self._entries.get(key)

    def number(self, key: str) -> float | None:
        value = self.value(key)
        hint = " (YAML takes 1.0e-3 for a number, not 1e-3)" if isinstance(value, str) else ""
        number = float(value) if type(value) is int else self._of_type(key, float, f"a number{hint}")
        if number is not None and not isfinite(number):
            raise self.error(key, f"is {number}; wanted a finite number")
        return number

    def positive(self, key: str) -> float | None:
        value = self.number(key)
        if value is not None and value <= 0.0:
            raise self.error(key, f"is {value}; wanted more than 0")
        return value

    def whole(self, key: str) -> int | None:
        wanted = "a whole number from 0 on"
        value = self._of_type(key, int, wanted)
        if value is not None and value < 0:
            raise self.error(key, f"is {value}; wanted {wanted}")
        return value

    def flag(self, key: str) -> bool | None:
        return self._of_type(key, bool, "true or false")

    def text(self, key: str) -> str | None:
        return self._of_type(key, str, "a text")

    def _of_type(self, key: str, kind: type[Kind], wanted: str) -> Kind | None:
        """The value of a key, which must be of exactly this type; None if there is none."""
        value: Kind | None = self.value(key)
        if value is not None and type(value) is not kind:
            raise self.error(key, f"is {_shown(value)}; wanted {wanted}")
        return value

    def items(self, key: str, kind: type, wanted: str) -> list[Any]:
        value = self.value(key)
        if value is None:
            return []
        if not isinstance(value, list) or not all(type(one) is kind for one in value):
            raise self.error(key, f"is {_shown(value)}; wanted a list of {wanted}")
        return value

    def section(self, key: str) -> Section:
        """The section under a key; empty if there is none."""
        return Section(self._path, self.named(key), self.value(key))

    def sections(self) -> Iterator[tuple[str, Section]]:
        """Every entry as a section."""
        for key in self._entries:
            yield key, self.section(key)

    def done(self, *others: str) -> None:
        """Raises FileError if a key was not read and is not in `others`."""
        known = sorted({*self._asked, *others})
        for key in self._entries:
            if key not in known:
                near = get_close_matches(key, known, 1)
                there_are = f"there are {', '.join(known) or 'none here'}"
                raise self.error(key, f"is not known; {f'did you mean `{near[0]}`?' if near else there_are}")


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}…"
