"""A section of a configuration: every key is asked for by its type, and none may be left over."""

from __future__ import annotations

from collections.abc import Iterator
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from .._palpate import FileError


class Section:
    """The entries of a mapping; errors name the file, the section and the key."""

    def __init__(self, path: Path, name: str, entries: object) -> None:
        self._path, self._name = path, name
        if entries is None:
            entries = {}
        if not isinstance(entries, dict) or not all(isinstance(key, str) for key in entries):
            raise self.error(name, f"is {_shown(entries)}; wanted keys with their values")
        self._entries: dict[str, Any] = entries
        self._asked: set[str] = set()

    def error(self, name: str, told: str) -> FileError:
        return FileError(f"`{self._path}`: {f'`{name}`' if name else 'the file'} {told}")

    def named(self, key: str) -> str:
        return f"{self._name}.{key}" if self._name else key

    def keys(self) -> list[str]:
        return list(self._entries)

    def __contains__(self, key: str) -> bool:
        return key in self._entries

    def value(self, key: str) -> Any:
        """The value of a key, whatever it is; None if there is none."""
        self._asked.add(key)
        return self._entries.get(key)

    def number(self, key: str) -> float | None:
        hint = " (YAML takes 1.0e-3 for a number, not 1e-3)" if isinstance(self.value(key), str) else ""
        value = self._of_type(key, (int, float), f"a number{hint}")
        return None if value is None else float(value)

    def positive(self, key: str) -> float | None:
        value = self.number(key)
        if value is not None and not 0.0 < value < float("inf"):
            raise self.error(self.named(key), f"is {value}; wanted more than 0")
        return value

    def whole(self, key: str) -> int | None:
        wanted = "a whole number from 0 on"
        value: int | None = self._of_type(key, (int,), wanted)
        if value is not None and value < 0:
            raise self.error(self.named(key), f"is {value}; wanted {wanted}")
        return value

    def flag(self, key: str) -> bool | None:
        value: bool | None = self._of_type(key, (bool,), "true or false")
        return value

    def text(self, key: str) -> str | None:
        value: str | None = self._of_type(key, (str,), "a text")
        return value

    def _of_type(self, key: str, types: tuple[type, ...], wanted: str) -> Any:
        """The value of a key, which must be of one of these very types; None if there is none."""
        value = self.value(key)
        if value is not None and type(value) not in types:
            raise self.error(self.named(key), f"is {_shown(value)}; wanted {wanted}")
        return value

    def items(self, key: str, kind: type, wanted: str) -> list[Any]:
        value = self.value(key)
        if value is None:
            return []
        if not isinstance(value, list) or not all(type(one) is kind for one in value):
            raise self.error(self.named(key), f"is {_shown(value)}; wanted a list of {wanted}")
        return value

    def section(self, key: str) -> Section:
        """The section of a key, without entries if there is none."""
        return Section(self._path, self.named(key), self.value(key))

    def sections(self) -> Iterator[tuple[str, Section]]:
        """Every entry as a section."""
        for key in self._entries:
            yield key, self.section(key)

    def done(self) -> None:
        """Raises FileError if there is a key that nobody has asked for."""
        for key in self._entries:
            if key not in self._asked:
                near = get_close_matches(key, self._asked, 1)
                hint = f"did you mean `{near[0]}`?" if near else f"there are {self._known()}"
                raise self.error(self.named(key), f"is not known; {hint}")

    def _known(self) -> str:
        return ", ".join(sorted(self._asked)) or "none here"


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}…"
