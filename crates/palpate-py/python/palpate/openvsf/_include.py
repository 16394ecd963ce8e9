"""Configurations in YAML or JSON, with files that they include.

| YAML                  | JSON                      |                                                 |
|-----------------------|---------------------------|-------------------------------------------------|
| `!include FILE`       | `"!include FILE"`         | what FILE holds; its text if it is neither kind |
| `!relative_path FILE` | `"!relative_path FILE"`   | its path                                        |

FILE is relative to the file that names it.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from .._palpate import FileError


def read(path: Path, within: tuple[Path, ...] = ()) -> Any:
    """What a file holds, and the files that it includes; `within` are those that include it.

    Raises FileError, which names the file and the line, and ImportError if YAML needs PyYAML.
    """
    if path in within:
        told = " includes ".join(f"`{one}`" for one in (*within, path))
        raise FileError(f"the configuration includes itself: {told}")
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "it is no text"
        by = f", which `{within[-1]}` includes," if within else ""
        raise FileError(f"`{path}`{by} cannot be read: {why}") from error
    if path.suffix in (".yaml", ".yml"):
        return _yaml(text, path, within)
    if path.suffix == ".json":
        return _json(text, path, within)
    if not within:
        raise FileError(f"`{path}` is no configuration: wanted .yaml, .yml or .json")
    return text


def _beside(path: Path, name: str) -> Path:
    return Path(os.path.normpath(path.parent / name))


def _yaml(text: str, path: Path, within: tuple[Path, ...]) -> Any:
    try:
        import yaml
    except ImportError as error:
        raise ImportError("YAML needs PyYAML: pip install 'palpate[openvsf]'") from error

    def include(loader: yaml.SafeLoader, node: yaml.ScalarNode) -> Any:
        return read(_beside(path, str(loader.construct_scalar(node))), (*within, path))

    def relative_path(loader: yaml.SafeLoader, node: yaml.ScalarNode) -> str:
        return str(_beside(path, str(loader.construct_scalar(node))))

    loader: Any = type("Loader", (yaml.SafeLoader,), {})
    loader.add_constructor("!include", include)
    loader.add_constructor("!relative_path", relative_path)
    try:
        return yaml.load(text, loader)
    except (yaml.YAMLError, RecursionError) as error:
        raise FileError(f"`{path}` is no YAML that is read: {error}") from error


def _json(text: str, path: Path, within: tuple[Path, ...]) -> Any:
    try:
        return _resolved(json.loads(text), path, within)
    except (ValueError, RecursionError) as error:
        raise FileError(f"`{path}` is no JSON: {error}") from error


def _resolved(value: Any, path: Path, within: tuple[Path, ...]) -> Any:
    if isinstance(value, dict):
        return {key: _resolved(one, path, within) for key, one in value.items()}
    if isinstance(value, list):
        return [_resolved(one, path, within) for one in value]
    if isinstance(value, str) and value.startswith("!include "):
        return read(_beside(path, value.split(" ", 1)[1]), (*within, path))
    if isinstance(value, str) and value.startswith("!relative_path "):
        return str(_beside(path, value.split(" ", 1)[1]))
    return value
