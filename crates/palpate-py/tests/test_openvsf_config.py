"""Data sets and configurations of OpenVSF have the same meaning in palpate, or a note says what differs."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import palpate
from palpate import openvsf

FIELDS = Path(__file__).parent / "data" / "openvsf"
URDF = Path(__file__).resolve().parents[2] / "palpate/src/robot/kinova_gen3.urdf"
WRISTS = [f"SphericalWrist{n}_Link" for n in (1, 2)]
LINKS = ["Shoulder_Link", "HalfArm1_Link", "HalfArm2_Link", "ForeArm_Link", *WRISTS, "Bracelet_Link"]


@pytest.fixture
def dataset(tmp_path: Path, plant: Path) -> Path:
    """Twelve short touches whose alphabetical order differs from that of their numbers."""
    root = tmp_path / "touches"
    touch = next(iter(palpate.open_log(plant / "seq_000")))
    for n in range(12):
        folder = root / f"seq_{n}"
        folder.mkdir(parents=True)
        np.save(folder / "angles.npy", touch.q[: 150 + n])
        np.save(folder / "torques.npy", touch.tau[: 150 + n])
        np.save(folder / "sim_torques.npy", 2.0 * np.array(touch.tau[: 150 + n]))
        np.save(folder / "pressure.npy", np.zeros((150 + n, 1)))
    (root / "readme.txt").write_text("no sequence")
    return root


AS_TEXT = [0, 1, 10, 11, 2, 3, 4, 5, 6, 7, 8, 9]


def names(touches: Any) -> list[str]:
    return [touch.name for touch in touches]


def test_sequences_have_openvsfs_numbers(dataset: Path) -> None:
    log = openvsf.open_dataset(dataset)
    assert isinstance(log, palpate.Log)
    assert names(log) == [f"seq_{n}" for n in AS_TEXT]
    assert names(openvsf.open_dataset(dataset, sequences=[2, 4, 0])) == ["seq_10", "seq_2", "seq_0"]
    assert names(openvsf.open_dataset(dataset, sequences=np.array([2]))) == ["seq_10"]
    assert names(palpate.open_log(dataset))[2] == "seq_2"


def test_a_dataset_maps_as_its_folders_do(
    robot: palpate.Robot, dataset: Path, plant: Path
) -> None:
    maps = [palpate.Mapper(robot), palpate.Mapper(robot)]
    maps[0].map(openvsf.open_dataset(plant, sequences=[0]))
    maps[1].map(plant / "seq_000")
    assert (maps[0].field().stiffness == maps[1].field().stiffness).all()


def test_arrays_of_other_names_are_touches(dataset: Path) -> None:
    touches = openvsf.open_dataset(dataset, torques="sim_torques", sequences=[2])
    assert isinstance(touches, list) and names(touches) == ["seq_10"]
    plain = next(iter(openvsf.open_dataset(dataset, sequences=[2])))
    assert (touches[0].tau == 2.0 * np.array(plain.tau)).all() and (touches[0].q == plain.q).all()


def test_what_is_no_dataset_is_refused(dataset: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"`sequences` holds 12; `.*touches` has 12, numbered from 0"):
        openvsf.open_dataset(dataset, sequences=[12])
    with pytest.raises(ValueError, match="`sequences` holds -1"):
        openvsf.open_dataset(dataset, sequences=[-1])
    with pytest.raises(ValueError, match="`sequences` holds 'seq_0'"):
        openvsf.open_dataset(dataset, sequences=["seq_0"])  # type: ignore[list-item]
    with pytest.raises(ValueError, match="`sequences` is empty"):
        openvsf.open_dataset(dataset, sequences=[])
    with pytest.raises(palpate.LogError, match="seq_0` has no velocities.npy"):
        openvsf.open_dataset(dataset, angles="velocities")
    with pytest.raises(palpate.LogError, match="seq_0`, `angles` as q and `pressure` as tau"):
        openvsf.open_dataset(dataset, torques="pressure")
    with pytest.raises(ValueError, match="angle_unit: only for arrays called"):
        openvsf.open_dataset(dataset, torques="sim_torques", angle_unit="deg")
    (dataset / "seq_0" / "sim_torques.npy").write_bytes(b"nonsense")
    with pytest.raises(palpate.LogError, match=r"sim_torques\.npy` is no array of NumPy"):
        openvsf.open_dataset(dataset, torques="sim_torques")
    (dataset / "seq_notes.txt").write_text("counted all the same")
    assert len(names(openvsf.open_dataset(dataset, sequences=range(12)))) == 12
    with pytest.raises(palpate.LogError, match="seq_notes.txt` is no folder, though OpenVSF counts"):
        openvsf.open_dataset(dataset)
    with pytest.raises(palpate.LogError, match="holds no sequences"):
        openvsf.open_dataset(tmp_path)
    with pytest.raises(palpate.LogError, match="cannot be read: No such file"):
        openvsf.open_dataset(tmp_path / "nowhere")


@pytest.fixture
def config(tmp_path: Path, dataset: Path) -> Path:
    """A configuration in several files, like those for an arm with a Punyo sensor."""
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "arm.yaml").write_text(f"""
        gen3: {{type: robot, file_name: {URDF}}}
        bubble:
          type: deformable
          file_name: !relative_path ../meshes/bubble.ply
          parent_name: EndEffector_Link
          parent_relative_transform: [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.1], [0, 0, 0, 1]]
        """)
    (tmp_path / "parts" / "keys.yaml").write_text("""
        angles: 7
        torques: [[7], np.float64]
        sim_torques: 7
        pressure: 1
        bubble_points: [[390, 3], np.ndarray]
        """)
    (tmp_path / "parts" / "torques.yaml").write_text(
        f"{{type: JointTorqueSensor, attachment_name: gen3, link_names: [{', '.join(LINKS)}]}}"
    )
    path = tmp_path / "study.yaml"
    path.write_text("""
        world: !include parts/arm.yaml
        simulator:
          type: quasistatic
          deformables:
            vsf:
              model:
                type: point
                init_method: config
                point_vsf_config: {bbox: [[0.1, -0.3, 0.2], [0.7, 0.3, 0.8]], voxel_size: 0.02}
              config: {friction_mu: 0.4, sim_slide: true, slide_step: 0.002,
                       geometry_padding1: 0.004, geometry_padding2: 0.008}
        sensors:
          arm_torques: !include parts/torques.yaml
          bubble_pressure: {type: PunyoPressureSensor, attachment_name: bubble}
        calibrators:
          arm_torques: {type: tare, num_samples: 15}
          bubble_pressure: {type: tare, num_samples: 10}
        dataset:
          path: !relative_path touches
          keys: !include parts/keys.yaml
          control_keys: {gen3: angles}
          sensor_keys: {arm_torques: torques, bubble_pressure: pressure}
        train_sequences: [2, 0, 4]
        test_sequences: [3]
        estimator: {optimizer: diag_ekf, num_replay_update: 7, max_buffer_length: 2000}
        prior: {type: gaussian, mu: 0.8, var: 16.0}
        """)
    return path


def test_a_configuration_becomes_the_same_settings_of_palpate(config: Path) -> None:
    study = openvsf.read_config(config)
    assert study.robot.n_joints == 7 and study.path == config
    assert names(study.train) == ["seq_10", "seq_0", "seq_2"]
    assert study.test is not None and names(study.test) == ["seq_11"]
    settings = palpate.default_settings(study.settings)
    contact = {"friction": 0.4, "slip_step_m": 0.002, "contact_distance_m": 0.012}
    assert settings["contact"].items() >= contact.items()
    assert settings["touch"]["tare_frames"] == 15
    estimator = {"estimator": "ekf", "replays": 7, "memory_frames": 2000}
    assert settings["estimator"].items() >= estimator.items()
    lattice = palpate.Lattice.filling([0.1, -0.3, 0.2], [0.7, 0.3, 0.8], 0.02)
    assert study.settings["lattice"] == lattice
    mapper = palpate.Mapper(study.robot, settings=study.settings)
    mapper.map(study.train)
    assert mapper.method == "ekf" and mapper.field().lattice == lattice


def test_a_prior_is_that_of_the_cells_as_they_are(config: Path) -> None:
    """The prior of an untouched cell is that of a point in the file."""
    study = openvsf.read_config(config)
    field = palpate.Mapper(study.robot, settings=study.settings).field()
    stiffness, std, _ = field.query([[0.2, 0.0, 0.5]])
    assert stiffness == pytest.approx(0.8) and std == pytest.approx(4.0)


def test_settings_without_a_counterpart_are_noted(config: Path) -> None:
    notes = "\n".join(openvsf.read_config(config).notes)
    for note in (
        "`world.bubble` moves with `EndEffector_Link`: add it to the URDF",
        "Sensor `bubble_pressure` (PunyoPressureSensor of `bubble`) has no counterpart",
        "The tare of `bubble_pressure` is ignored",
        "Of the data set, `sim_torques`, `pressure`, `bubble_points` are not read.",
    ):
        assert note in notes
    changed(config, "{optimizer: diag_ekf,", "{optimizer: quad_prog, batch_size: 5, down_sample_rate: 3,")
    changed(config, "type: gaussian", "type: linear_gaussian")
    notes = "\n".join(openvsf.read_config(config).notes)
    for note in (
        "`quad_prog` becomes `map`: `map` finds the same optimum",
        "`estimator.batch_size` has no counterpart",
        "`estimator.down_sample_rate` has no counterpart",
        "The prior `linear_gaussian` depends on features",
    ):
        assert note in notes


def changed(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def test_a_filter_does_not_start_from_a_mean_of_0(config: Path) -> None:
    changed(config, "mu: 0.8", "mu: 0.0")
    study = openvsf.read_config(config)
    assert any("`prior.mu` is 0 N/m; its `ekf` keeps a prior mean" in note for note in study.notes)
    palpate.Mapper(study.robot, settings=study.settings).map(study.train)
    changed(config, "diag_ekf", "quad_prog")
    study = openvsf.read_config(config)
    assert palpate.Mapper(study.robot, settings=study.settings).field().untouched == 0.0


def test_replay_is_carried_over_whatever_the_optimizer(config: Path) -> None:
    changed(config, "optimizer: diag_ekf, ", "")
    estimator = palpate.default_settings(openvsf.read_config(config).settings)["estimator"]
    assert estimator.items() >= {"replays": 7, "memory_frames": 2000}.items()


def test_points_that_do_not_slide_stick(config: Path) -> None:
    changed(config, "sim_slide: true", "sim_slide: False")
    study = openvsf.read_config(config)
    assert any("sim_slide` is false, so points stick" in note for note in study.notes)
    contact = palpate.default_settings(study.settings)["contact"]
    assert contact["slip_iterations"] == 0 and contact["friction"] == 0.4
    over = palpate.Mapper(settings=study.settings, contact={"slip_iterations": 10}).config
    assert over["contact"]["slip_iterations"] == 10 and over["contact"]["friction"] == 0.4


def test_arguments_override_the_file(config: Path, dataset: Path, tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    dataset.rename(elsewhere)
    with pytest.raises(palpate.FileError, match=r"`dataset\.path` is .*not there; give `data_dir`"):
        openvsf.read_config(config)
    lattice = palpate.Lattice([0, 0, 0], 0.05, [9, 9, 9])
    arm = palpate.Robot()
    study = openvsf.read_config(config, data_dir=elsewhere, robot=arm, lattice=lattice)
    assert study.robot is arm and study.settings["lattice"] == lattice
    assert palpate.Mapper(settings=study.settings).field().untouched == pytest.approx(0.8)


def test_the_points_of_a_field_give_the_lattice(config: Path) -> None:
    model = config.read_text().split("init_method: config")[1].split("config: {friction")[0]
    changed(config, f"init_method: config{model}", f"path: {FIELDS / 'prior.npz'}\n              ")
    study = openvsf.read_config(config)
    assert study.settings["lattice"] == openvsf.load(FIELDS / "prior.npz").lattice
    pose = "pose: [[0, -1, 0, 0.5], [1, 0, 0, 0], [0, 0, 1, 0.1], [0, 0, 0, 1]]\n              config: {f"
    changed(config, "config: {f", pose)
    posed = openvsf.read_config(config).settings["lattice"]
    assert isinstance(posed, palpate.Lattice) and posed.shape == (5, 6, 4)
    assert posed.origin == pytest.approx([0.5 - 0.03, 0.4, 0.4])
    changed(config, "prior.npz", "nowhere.npz")
    with pytest.raises(palpate.FileError, match=r"deformables\.vsf\.model\.path` `.*` is not there"):
        openvsf.read_config(config)


def test_a_posed_box_stands_where_it_is_posed(config: Path) -> None:
    pose = "pose: [[0, -1, 0, 0.5], [1, 0, 0, 0], [0, 0, 1, 0.1], [0, 0, 0, 1]]\n              config: {f"
    changed(config, "config: {f", pose)
    low, high = [0.5 - 0.3, 0.1, 0.2 + 0.1], [0.5 + 0.3, 0.7, 0.8 + 0.1]
    lattice = openvsf.read_config(config).settings["lattice"]
    assert isinstance(lattice, palpate.Lattice) and lattice.shape == (30, 30, 30)
    assert lattice.origin == pytest.approx(palpate.Lattice.filling(low, high, 0.02).origin)


def test_json_is_read_as_yaml_is(config: Path, tmp_path: Path) -> None:
    yaml = pytest.importorskip("yaml")
    world = yaml.safe_load((tmp_path / "parts/arm.yaml").read_text().replace("!relative_path", ""))
    (tmp_path / "world.json").write_text(json.dumps(world))
    keys = {"angles": 7, "torques": 7}
    study = {
        "world": "!include world.json",
        "dataset": {"path": "!relative_path touches", "keys": keys, "control_keys": {"gen3": "angles"}},
        "train_sequences": [2],
    }
    (tmp_path / "study.json").write_text(json.dumps(study))
    read = openvsf.read_config(tmp_path / "study.json")
    assert names(read.train) == ["seq_10"] and read.test is None and read.settings == {}


def test_a_section_of_a_dataset_alone_is_enough(config: Path, tmp_path: Path, dataset: Path) -> None:
    keys = openvsf.read_config(tmp_path / "parts/keys.yaml", data_dir=dataset)
    assert names(keys.train) == [f"seq_{n}" for n in AS_TEXT] and keys.settings == {}
    assert "The file names no robot: palpate's kinova_gen3 is taken." in keys.notes
    path = tmp_path / "data.yaml"
    path.write_text(
        "{keys: !include parts/keys.yaml, control_keys: {gen3: angles}, "
        "sensor_keys: {arm: sim_torques, bubble: pressure}, path: touches}"
    )
    study = openvsf.read_config(path)
    assert isinstance(study.train, list) and len(study.train) == 12
    with pytest.raises(ValueError, match=r"has no `dataset\.path`: give `data_dir`"):
        openvsf.read_config(tmp_path / "parts/keys.yaml")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("train_sequences", "train_sequence", "`train_sequence` is not known; did you mean `train_seq"),
        ("friction_mu", "friction", r"config\.friction` is not known; did you mean `friction_mu`"),
        ("optimizer:", "type:", r"`estimator\.type` is not known; there are"),
        ("optimizer: diag_ekf", "optimizer: adam", "`estimator.optimizer` is 'adam'; wanted quad_prog"),
        ("slide_step: 0.002", "slide_step: 2e-3", r"slide_step` is '2e-3'; wanted a number \(YAML takes"),
        ("slide_step: 0.002", "slide_step: -1", r"slide_step` is -1\.0; wanted more than 0"),
        ("slide_step: 0.002", "slide_step: .nan", r"slide_step` is nan; wanted a finite number"),
        ("sim_slide: true", "sim_slide: 1", "sim_slide` is 1; wanted true or false"),
        ("num_samples: 15", "num_samples: many", "num_samples` is 'many'; wanted a whole number"),
        ("num_samples: 15", "num_samples: 1.5", r"num_samples` is 1\.5; wanted a whole number"),
        ("type: tare, num_samples: 15", "type: bias", r"arm_torques\.type` is 'bias'; wanted `tare`"),
        ("[2, 0, 4]", "[2, zero]", "train_sequences` is .*; wanted a list of whole numbers"),
        ("type: quasistatic", "type: dynamic", "`simulator.type` is not `quasistatic`"),
        ("{gen3: angles}", "{gen3: pressure}", r"keys\.pressure` is 1; wanted 7, the positions"),
        ("arm_torques: torques", "arm_torques: tau", r"keys\.tau` is missing; it must hold"),
        ("path: !relative_path touches", "type: file_loader", "stack them into angles.npy and torques"),
        ("parts/torques.yaml", "parts/none.yaml", r"none\.yaml`, which `.*study\.yaml` includes, cannot"),
        ("parts/torques.yaml", "study.yaml", "the configuration includes itself"),
        ("world: !include parts/arm.yaml", "world: 3", "`world` is 3; wanted keys with their values"),
        ("friction_mu: 0.4", "friction_mu: [", r"study\.yaml` is no YAML that palpate reads: .*line"),
        ("friction_mu: 0.4", "friction_mu: !!python/name:os.system", "is no YAML that palpate reads"),
        ("[0.7, 0.3, 0.8]]", "[0.7, 0.3]]", r"bbox` is not a box of 2 x 3 numbers, or the pose"),
        ("!include parts/torques.yaml", "{type: PunyoDenseForceSensor}", "has 0 sensors of the robot's"),
    ],
)
def test_invalid_settings_are_reported_with_file_and_key(
    config: Path, old: str, new: str, message: str
) -> None:
    changed(config, old, new)
    with pytest.raises(palpate.FileError, match=f"(?s){message}") as error:
        openvsf.read_config(config)
    assert str(config) in str(error.value)


def test_values_out_of_range_are_refused(config: Path) -> None:
    changed(config, "geometry_padding1: 0.004", "geometry_padding1: 0.4")
    with pytest.raises(palpate.SettingsError, match=r"study\.yaml`, as settings of palpate: .*contact_"):
        openvsf.read_config(config)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("ForeArm_Link, ", "", "needs the torques of all 7 joints, base to tip"),
        ("Shoulder_Link, HalfArm1_Link", "HalfArm1_Link, Shoulder_Link", "base to tip"),
        ("Shoulder_Link", "Shoulder", "base to tip"),
    ],
)
def test_torques_must_be_those_of_all_joints_in_order(
    config: Path, tmp_path: Path, old: str, new: str, message: str
) -> None:
    changed(tmp_path / "parts/torques.yaml", old, new)
    with pytest.raises(palpate.FileError, match=rf"arm_torques\.link_names` is \[.*{message}"):
        openvsf.read_config(config)


def test_a_robot_that_is_not_there_is_reported(config: Path, tmp_path: Path) -> None:
    changed(tmp_path / "parts/arm.yaml", str(URDF), "no/such.urdf")
    with pytest.raises(palpate.FileError, match="the robot's file_name `no/such.urdf` is not there"):
        openvsf.read_config(config)


def test_files_of_other_kinds_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text("")
    with pytest.raises(palpate.FileError, match="is no configuration: wanted .yaml, .yml or .json"):
        openvsf.read_config(tmp_path / "a.toml")
    (tmp_path / "a.json").write_text("{")
    with pytest.raises(palpate.FileError, match=r"a\.json` is no JSON: Expecting"):
        openvsf.read_config(tmp_path / "a.json")
    (tmp_path / "a.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(palpate.FileError, match=r"a\.yaml` cannot be read: it is not a text file"):
        openvsf.read_config(tmp_path / "a.yaml")
    with pytest.raises(palpate.FileError, match=r"b\.yaml` cannot be read: No such file"):
        openvsf.read_config(tmp_path / "b.yaml")


def test_yaml_aliases_are_resolved_once(tmp_path: Path) -> None:
    levels = [f"a{n}: &a{n} [*a{n - 1}, *a{n - 1}]" for n in range(1, 60)]
    file = tmp_path / "config.yaml"
    file.write_text("\n".join(["a0: &a0 [1]", *levels]))
    with pytest.raises(palpate.FileError, match=r"config\.yaml"):
        openvsf.read_config(file)
