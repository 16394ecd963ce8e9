"""External torques and predictions as features of a LeRobot data set.

`palpate.open_log`, and all functions that take a log, read the data sets of LeRobot (versions 2 and 3). `annotate`
writes a copy of one with external and predicted torques of each frame. Needs pyarrow:
``pip install 'palpate[lerobot]'``.
"""

import json
import os
import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
import pyarrow.parquet as pq  # type: ignore[import-untyped]
from numpy.typing import NDArray

from ._palpate import Field, FileError, Mapper, Robot, external_torques
from ._progress import Progress
from .results import TouchTorques
from .settings import AnySettings

_Arrays = dict[str, NDArray[np.float64]]


def annotate(
    dataset: str | os.PathLike[str],
    output: str | os.PathLike[str],
    robot: Robot | str | os.PathLike[str] | None = None,
    field: Field | None = None,
    *,
    settings: AnySettings | None = None,
    progress: Progress = None,
) -> dict[str, list[int]]:
    """Writes a copy of a LeRobot data set with palpate's features in addition.

    `dataset` is the folder with `data/` and `meta/`; `output` must not exist, and is never written partially. Its
    videos are links to those of `dataset` if the system allows it. `robot` is an arm as for `external_torques`.

    | feature                                  | float32, (n_joints,), N·m                              |
    |------------------------------------------|--------------------------------------------------------|
    | `observation.external_torque`            | torque that the object exerts on the joints            |
    | `observation.external_torque_std`        | its standard deviation                                 |
    | `observation.predicted_torque`           | with `field`: predicted for the episode's motion       |
    | `observation.predicted_torque_half_width`| with a field with bands: half-width at 90 %            |

    Features have statistics in `meta/`, as LeRobot requires. Returns their names with their shapes. Raises FileError if
    `dataset` is not a data set or `output` exists, LogError or TouchError if `dataset` cannot be read as a log.
    """
    source, target = Path(dataset), Path(output)
    info = _info(source)
    if target.exists():
        raise FileError(f"`{target}` is there already; choose another name")
    if source.resolve() in target.resolve().parents:
        raise FileError(f"`{target}` would lie inside its source data set; choose a name outside of `{source}`")
    found = external_torques(os.fspath(source), robot, settings=settings, progress=progress)
    arm = robot if isinstance(robot, Robot) else Robot() if robot is None else Robot(robot)
    mapper = Mapper.from_field(field, arm) if field is not None else None
    episodes = {touch["name"]: _features(touch, mapper) for touch in found}
    names, n_joints = list(next(iter(episodes.values()))), arm.n_joints
    features = {
        name: {"dtype": "float32", "shape": [n_joints], "names": arm.joint_names} for name in names
    }

    target.parent.mkdir(parents=True, exist_ok=True)
    partial = Path(tempfile.mkdtemp(prefix=f".{target.name}.", suffix=".partial", dir=target.parent))
    try:
        _copy(source, partial)
        rows = dict.fromkeys(episodes, 0)
        for path in sorted((partial / "data").rglob("*.parquet")):
            _extend(path, episodes, rows, names)
        for name, count in rows.items():
            if count != len(episodes[name][names[0]]):
                raise _other_frames(source, name)
        info["features"].update(features)
        (partial / "meta/info.json").write_text(json.dumps(info, indent=4) + "\n")
        _statistics(partial / "meta", episodes, names)
        partial.chmod(0o755)
        partial.rename(target)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return {name: [n_joints] for name in names}


def _info(source: Path) -> dict[str, Any]:
    path = source / "meta" / "info.json"
    try:
        info = json.loads(path.read_text())
    except FileNotFoundError:
        raise FileError(f"`{path}` does not exist; wanted the folder of a LeRobot data set") from None
    except ValueError as error:
        raise FileError(f"`{path}` is no JSON: {error}") from None
    if not isinstance(info, dict) or not isinstance(info.get("features"), dict):
        raise FileError(f"`{path}` names no features; wanted those of a LeRobot data set")
    return info


def _features(touch: TouchTorques, mapper: Mapper | None) -> _Arrays:
    found = {"observation.external_torque": touch["torque"], "observation.external_torque_std": touch["std"]}
    if mapper is not None:
        answer = mapper.ask(touch["q"])
        found["observation.predicted_torque"] = answer.torque
        if answer.half_width is not None:
            found["observation.predicted_torque_half_width"] = answer.half_width
    return found


def _copy(source: Path, partial: Path) -> None:
    """Copies a data set; videos and images, which are not changed, as links."""

    def linked(old: str, new: str) -> None:
        try:
            os.link(os.path.realpath(old), new)
        except OSError:
            shutil.copy2(old, new)

    for entry in source.iterdir():
        to = partial / entry.name
        if entry.is_dir():
            keeps = entry.name in ("videos", "images")
            shutil.copytree(entry, to, copy_function=linked if keeps else shutil.copy2)
        else:
            shutil.copy2(entry, to)


def _extend(path: Path, episodes: dict[str, _Arrays], rows: dict[str, int], names: list[str]) -> None:
    """Adds features to a file of frames; `rows` is the number of frames of each episode so far."""
    table = pq.read_table(path)
    if "episode_index" in table.column_names:
        keys = [f"episode_{number}" for number in table["episode_index"].to_pylist()]
    else:
        keys = [path.stem] * len(table)
    if not keys:
        return
    places = []
    for key in keys:
        if key not in rows or rows[key] >= len(episodes[key][names[0]]):
            raise _other_frames(path, key)
        places.append((key, rows[key]))
        rows[key] += 1
    metadata = dict(table.schema.metadata or {})
    for name in names:
        values = np.asarray([episodes[key][name][row] for key, row in places], dtype=np.float32)
        column = pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])
        if name in table.column_names:
            table = table.drop_columns([name])
        table = table.append_column(name, column)
    huggingface = json.loads(metadata.get(b"huggingface", b"null")) or {}
    features = huggingface.get("info", {}).get("features")
    if features is not None:
        # Version 4 of datasets has another name for lists; take the one that the file already uses.
        lists = (own["_type"] for own in features.values() if "feature" in own)
        kind = next(lists, "Sequence")
        for name in names:
            value = {"dtype": "float32", "_type": "Value"}
            features[name] = {"feature": value, "length": episodes[keys[0]][name].shape[1], "_type": kind}
        metadata[b"huggingface"] = json.dumps(huggingface).encode()
    pq.write_table(table.replace_schema_metadata(metadata), path)


def _other_frames(path: Path, episode: str) -> FileError:
    return FileError(
        f"`{path}`: the frames of `{episode}` in its data/ are not those that were read as a touch; leave out settings "
        "that split or skip touches"
    )


def _statistics(meta: Path, episodes: dict[str, _Arrays], names: list[str]) -> None:
    """Adds the features to the existing statistics of the data set: of all frames, or of each episode."""
    whole = meta / "stats.json"
    if whole.exists():
        stats = json.loads(whole.read_text())
        for name in names:
            stats[name] = _of(np.concatenate([episode[name] for episode in episodes.values()]))
        whole.write_text(json.dumps(stats, indent=4) + "\n")
    each = meta / "episodes_stats.jsonl"
    if each.exists():
        lines = [json.loads(line) for line in each.read_text().splitlines() if line.strip()]
        for line in lines:
            episode = episodes[f"episode_{line['episode_index']}"]
            line["stats"].update({name: _of(episode[name]) for name in names})
        each.write_text("".join(json.dumps(line) + "\n" for line in lines))


def _of(values: NDArray[np.float64]) -> dict[str, list[float]]:
    found = {"min": values.min(0), "max": values.max(0), "mean": values.mean(0), "std": values.std(0)}
    stats = {name: [float(number) for number in numbers] for name, numbers in found.items()}
    return {**stats, "count": [len(values)]}
