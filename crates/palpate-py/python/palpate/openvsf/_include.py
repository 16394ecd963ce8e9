"""Reads configurations in YAML or JSON, with the files that they include.

| YAML                  | JSON                      |                                                 |
|-----------------------|---------------------------|-------------------------------------------------|
| `!include FILE`       | `"!include FILE"`         | content of FILE; its text if not YAML or JSON   |
| `!relative_path FILE` | `"!relative_path FILE"`   | path of FILE                                    |

FILE is relative to the file that names it.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from .._palpate import FileError


def read(path: Path, within: tuple[Path, ...] = ()) -> Any:
    """The content of a file and of the files that it includes; `within` are the files that include it.

    Raises FileError, which names the file and the line, and ImportError if YAML needs PyYAML.
    """
    if path in within:
        chain = " includes ".join(f"`{one}`" for one in (*within, path))
        raise FileError(f"the configuration includes itself: {chain}")
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "it is not a text file"
        by = f", which `{within[-1]}` includes," if within else ""
        raise FileError(f"`{path}`{by} cannot be read: {why}") from error
    parse: Callable[[str], Any]
    if path.suffix in (".yaml", ".yml"):
        kind, parse = "YAML that palpate reads", _yaml
    elif path.suffix == ".json":
        kind, parse = "JSON", json.loads
    elif within:
        return text
    else:
        raise FileError(f"`{path}` is no configuration: wanted .yaml, .yml or .json")
    try:
        return _resolved(parse(text), path, within, {})
    except (ValueError, RecursionError) as error:
        raise FileError(f"`{path}` is no {kind}: {error}") from error


def _yaml(text: str) -> Any:
    """Parses YAML, with tagged file names as strings like those in JSON. Raises ValueError."""
    try:
        import yaml
    except ImportError as error:
        raise ImportError("YAML needs PyYAML: pip install 'palpate[openvsf]'") from error

    def tagged(loader: yaml.SafeLoader, node: yaml.ScalarNode) -> str:
        return f"{node.tag} {loader.construct_scalar(node)}"

    loader: Any = type("Loader", (yaml.SafeLoader,), {})
    loader.add_constructor("!include", tagged)
    loader.add_constructor("!relative_path", tagged)
    try:
        return yaml.load(text, loader)
    except yaml.YAMLError as error:
        raise ValueError(error) from error


def _resolved(value: Any, path: Path, within: tuple[Path, ...], known: dict[int, Any]) -> Any:
    """A value with its includes resolved; `known` has resolved values, since YAML may refer to one many times."""
    if isinstance(value, dict | list):
        if id(value) not in known:
            items = value.items() if isinstance(value, dict) else enumerate(value)
            done = {key: _resolved(one, path, within, known) for key, one in items}
            known[id(value)] = done if isinstance(value, dict) else list(done.values())
        return known[id(value)]
    if isinstance(value, str) and value.startswith(("!include ", "!relative_path ")):
        tag, name = value.split(" ", 1)
        file = Path(os.path.normpath(path.parent / name))
        return read(file, (*within, path)) if tag == "!include" else str(file)
    return value
