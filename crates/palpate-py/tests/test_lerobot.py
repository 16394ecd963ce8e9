"""Data sets of LeRobot: written in the formats of its versions, read by palpate, annotated, and read again by
`datasets`, as LeRobot does."""

import json
from pathlib import Path
from typing import Any

import datasets  # type: ignore[import-untyped]
import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
import pyarrow.parquet as pq  # type: ignore[import-untyped]
import pytest

import palpate
from palpate.lerobot import annotate

N = 7


def described(table: Any, kind: str) -> Any:
    """A table with the metadata that a version of `datasets` writes: lists are `Sequence` before version 4."""

    def feature(field: Any) -> dict[str, Any]:
        if not pa.types.is_fixed_size_list(field.type):
            return {"dtype": "float32" if pa.types.is_float32(field.type) else "int64", "_type": "Value"}
        value = {"dtype": "float32", "_type": "Value"}
        return {"feature": value, "length": field.type.list_size, "_type": kind}

    features = {field.name: feature(field) for field in table.schema}
    text = json.dumps({"info": {"features": features}})
    return table.replace_schema_metadata({"huggingface": text})


def data_set(plant: Path, folder: Path, version: str) -> list[tuple[Any, Any]]:
    """Two touches as a data set, joints in another order and a gripper among the positions."""
    order = [6, 0, 1, 2, 3, 4, 5]
    states = [f"Actuator{1 + joint}.pos" for joint in order]
    states.insert(2, "gripper.pos")
    features = {
        "observation.state": {"dtype": "float32", "shape": [N + 1], "names": {"motors": states}},
        "observation.effort": {"dtype": "float32", "shape": [N], "names": [f"Actuator{j + 1}" for j in range(N)]},
        **{
            name: {"dtype": kind, "shape": [1], "names": None}
            for name, kind in (("timestamp", "float32"), ("frame_index", "int64"), ("episode_index", "int64"))
        },
    }
    touches, tables = [], []
    for episode in (0, 1):
        q, tau = (np.load(plant / f"seq_00{episode}" / f"{name}.npy") for name in ("angles", "torques"))
        touches.append((q.astype(np.float32), tau.astype(np.float32)))
        state = np.insert(q[:, order], 2, 0.04, axis=1).astype(np.float32)
        frames = np.arange(len(q))
        columns = {
            "observation.state": pa.FixedSizeListArray.from_arrays(pa.array(state.ravel()), N + 1),
            "observation.effort": pa.FixedSizeListArray.from_arrays(pa.array(tau.astype(np.float32).ravel()), N),
            "timestamp": pa.array((frames / 20).astype(np.float32)),
            "frame_index": pa.array(frames),
            "episode_index": pa.array(np.full(len(q), episode)),
        }
        tables.append(described(pa.table(columns), "List" if version == "v3.0" else "Sequence"))
    data, meta = folder / "data/chunk-000", folder / "meta"
    data.mkdir(parents=True)
    meta.mkdir()
    (folder / "videos").mkdir()
    (folder / "film").write_bytes(b"film")
    (folder / "videos/front.mp4").symlink_to("../film")  # as in the cache of Hugging Face
    info = {"codebase_version": version, "fps": 20, "features": features}
    (meta / "info.json").write_text(json.dumps(info))
    if version == "v3.0":
        pq.write_table(pa.concat_tables(tables), data / "file-000.parquet")
        (meta / "stats.json").write_text(json.dumps({"timestamp": {"min": [0.0]}}))
    else:
        for episode, table in enumerate(tables):
            pq.write_table(table, data / f"episode_{episode:06}.parquet")
        lines = [json.dumps({"episode_index": episode, "stats": {}}) + "\n" for episode in (0, 1)]
        (meta / "episodes_stats.jsonl").write_text("".join(lines))
    return touches


def loaded(folder: Path) -> Any:
    """The frames as LeRobot loads them: with the features in the data set's metadata."""
    info = json.loads((folder / "meta/info.json").read_text())
    features = {
        name: datasets.Value(own["dtype"])
        if own["shape"] == [1]
        else datasets.List(datasets.Value(own["dtype"]), length=own["shape"][0])
        for name, own in info["features"].items()
    }
    files = sorted(str(path) for path in (folder / "data").rglob("*.parquet"))
    return datasets.Dataset.from_parquet(files, features=datasets.Features(features)).with_format("numpy")


def stored(path: str) -> Any:
    """The metadata of a file."""
    return json.loads(pq.read_schema(path).metadata[b"huggingface"])["info"]["features"]


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_needs_datasets_a_data_set_is_read_by_its_names_and_annotated_for_its_own_library(
    plant: Path, robot: palpate.Robot, field: palpate.Field, tmp_path: Path, version: str
) -> None:
    source, target = tmp_path / "source", tmp_path / "target"
    touches = data_set(plant, source, version)
    # Positions and torques are matched by joint name: the field equals that of the arrays.
    fields = []
    for log in (source, [palpate.Touch(q, tau, time=np.arange(len(q)) / 20) for q, tau in touches]):
        mapper = palpate.Mapper(robot)
        mapper.map(log, progress=False)
        fields.append(mapper.field())
    assert np.array_equal(fields[0].stiffness, fields[1].stiffness) and len(fields[0]) > 1000

    found = annotate(source, target, robot, field, progress=False)
    assert set(found) >= {"observation.external_torque", "observation.predicted_torque"}
    frames = loaded(target)
    assert len(frames) == sum(len(q) for q, _ in touches)
    torques = palpate.external_torques(source, robot, progress=False)
    wanted = np.concatenate([touch["torque"] for touch in torques]).astype(np.float32)
    assert np.array_equal(frames["observation.external_torque"][:], wanted)
    predicted = np.concatenate([palpate.Mapper.from_field(field, robot).ask(t["q"]).torque for t in torques])
    assert np.array_equal(frames["observation.predicted_torque"][:], predicted.astype(np.float32))
    assert np.abs(predicted).max() > 0.5
    files = sorted(str(path) for path in (target / "data").rglob("*.parquet"))
    plain = datasets.Dataset.from_parquet(files).with_format("numpy")
    assert np.array_equal(plain["observation.external_torque"][:], wanted)
    kinds = {own["_type"] for own in stored(files[0]).values() if "feature" in own}
    assert kinds == {"List" if version == "v3.0" else "Sequence"}
    # Other files are copied, and the source is unchanged.
    before = loaded(source)
    for name in before.column_names:
        assert np.array_equal(before[name][:], frames[name][:]), name
    assert (target / "videos/front.mp4").read_bytes() == b"film"
    info = json.loads((target / "meta/info.json").read_text())
    assert info["features"]["observation.external_torque"]["names"] == robot.joint_names
    if version == "v3.0":
        stats = json.loads((target / "meta/stats.json").read_text())
        assert np.allclose(stats["observation.external_torque"]["max"], wanted.max(0)) and "timestamp" in stats
    else:
        lines = [json.loads(line) for line in (target / "meta/episodes_stats.jsonl").read_text().splitlines()]
        assert lines[1]["stats"]["observation.external_torque"]["count"] == [len(touches[1][0])]


def test_needs_datasets_a_missing_data_set_or_an_existing_target_is_refused(plant: Path, tmp_path: Path) -> None:
    with pytest.raises(palpate.FileError, match="info.json` does not exist"):
        annotate(plant, tmp_path / "out")
    source = tmp_path / "source"
    data_set(plant, source, "v3.0")
    with pytest.raises(palpate.FileError, match="is there already"):
        annotate(source, source)
    with pytest.raises(palpate.FileError, match="inside its source data set"):
        annotate(source, source / "data/out")
    with pytest.raises(palpate.FileError, match="not those that were read"):
        annotate(source, tmp_path / "out", settings={"log": {"split_idle": True, "idle_s": 0.2}})
    (source / "data/chunk-000/file-000.parquet").write_bytes(b"PAR1 broken")
    with pytest.raises(palpate.LogError):
        annotate(source, tmp_path / "out")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["source"]
