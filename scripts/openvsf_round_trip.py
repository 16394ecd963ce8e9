#!/usr/bin/env python3
"""Holds palpate's fields against OpenVSF 0.0.1, in both directions.

    openvsf_round_trip.py ENVIRONMENT             checks, and says with which figures
    openvsf_round_trip.py ENVIRONMENT --fixtures  first lets OpenVSF write what the tests of the Python
                                                  package read, crates/palpate-py/tests/data/openvsf

Run it with a Python that has palpate. ENVIRONMENT is the folder of another one, which is made if it
is not there: OpenVSF with its stated dependencies, and three that it does not state, take 8 GB.
Nothing that belongs to the project needs it.
"""

import json
import os
import re
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
FIXTURES = ROOT / "crates" / "palpate-py" / "tests" / "data" / "openvsf"
PLANT = ROOT / "data" / "plant_a"
URDF = ROOT / "crates" / "palpate" / "src" / "robot" / "kinova_gen3.urdf"
PAGE = ROOT / "docs" / "guide" / "src" / "openvsf.md"
LINKS = [f"{part}_Link" for part in ("Shoulder", "HalfArm1", "HalfArm2", "ForeArm")]
LINKS += [f"{part}_Link" for part in ("SphericalWrist1", "SphericalWrist2", "Bracelet")]
REQUIRED = ["openvsf==0.0.1", "matplotlib", "pyyaml", "tqdm"]
NEAR_THE_FIRST_TOUCH = np.array([[0.08, -0.06, 0.5], [0.45, 0.19, 0.675]])  # m


def blocks(side):
    """The page's blocks of Python that are marked with a side."""
    pattern = rf"<!-- {side} -->\n```python\n(.*?)```"
    found = re.findall(pattern, PAGE.read_text(), re.DOTALL)
    assert found, f"{PAGE} has no block of {side}"
    return found


# In OpenVSF's environment.


def import_vsf():
    """OpenVSF 0.0.1, as the page says that it is imported since Python 3.11."""
    (code,) = blocks("first")
    exec(compile(code, PAGE.name, "exec"), {})
    return sys.modules["vsf"]


def arrays_of(point_vsf):
    features = {name: array.numpy() for name, array in point_vsf.features.items()}
    return {"points": point_vsf.rest_points.numpy(), "K": point_vsf.stiffness.numpy(), **features}


def write_fixtures():
    import torch

    vsf = import_vsf()
    FIXTURES.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(7)

    def with_stiffness(point_vsf, seen):
        n = point_vsf.num_points
        point_vsf.stiffness = torch.from_numpy(rng.uniform(0.0, 200.0, n)).to(point_vsf.dtype)
        point_vsf.set_feature("K_std", torch.from_numpy(rng.uniform(1.0, 9.0, n)).to(point_vsf.dtype))
        point_vsf.set_feature("N_obs", torch.from_numpy(rng.integers(0, 5, n) * seen))
        point_vsf.set_feature("height", point_vsf.rest_points[:, 2])
        return point_vsf

    axes = [0.4 + 0.02 * np.arange(6), -0.05 + 0.02 * np.arange(5), 0.3 + 0.02 * np.arange(4)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    prior = with_stiffness(vsf.PointVSF(grid), seen=False)
    prior.save(str(FIXTURES / "prior.npz"))
    prior.save(f"{FIXTURES / 'prior'}/")
    box = np.array([[0.4, -0.06, 0.3], [0.5, 0.07, 0.39]], dtype=np.float32)
    with_stiffness(vsf.PointVSF(bbox=box, voxel_size=0.02), seen=True).save(str(FIXTURES / "box.npz"))
    scattered = rng.uniform([0.4, -0.1, 0.3], [0.6, 0.1, 0.5], (150, 3))
    with_stiffness(vsf.PointVSF(scattered), seen=True).save(str(FIXTURES / "scattered.npz"))
    vsf.PointVSF(grid, axis_mode="axis_aligned").save(str(FIXTURES / "axis_aligned.npz"))
    for optimizer in ("diag_ekf", "quad_prog"):
        estimated(vsf, optimizer).save(str(FIXTURES / f"{optimizer}.npz"))
    size = sum(path.stat().st_size for path in FIXTURES.rglob("*.np?"))
    print(f"fixtures: {sorted(path.name for path in FIXTURES.iterdir())}, {size} bytes")


def estimated(vsf, optimizer):
    """A field that OpenVSF learns from a bundled, simulated touch."""
    from vsf.dataset.constructors import dataset_from_config
    from vsf.estimator.point_vsf_estimator import PointVSFEstimator, PointVSFEstimatorConfig
    from vsf.prior.prior_factory import GaussianVSFPriorFactory
    from vsf.sensor import TareCalibrator
    from vsf.sensor.joint_torque_sensor import JointTorqueSensor
    from vsf.sim import QuasistaticVSFSimulator, klamptWorldWrapper
    from vsf.sim.point_vsf_body import ContactParams

    world = klamptWorldWrapper()
    world.add_robot("kinova", str(URDF))
    sensor = JointTorqueSensor("tau", "kinova", LINKS)
    simulator = QuasistaticVSFSimulator(world, [sensor])
    field = vsf.vsf_from_box(*NEAR_THE_FIRST_TOUCH, resolution=0.03)
    simulator.add_deformable("vsf", field, ContactParams(friction_mu=0.5, sim_slide=False))
    world.setup_local_pcd_lst(sample_backend="open3d", num_of_pts=1000)
    world.setup_local_sdf_lst(resolution=0.01)
    config = vsf.DatasetConfig(
        path=str(PLANT),
        keys={"angles": 7, "torques": 7},
        control_keys={"kinova": "angles"},
        sensor_keys={"tau": "torques"},
    )
    touch = dataset_from_config(config)[0]
    estimator = PointVSFEstimator(
        PointVSFEstimatorConfig(optimizer=optimizer, num_replay_update=5, down_sample_rate=5),
        prior=GaussianVSFPriorFactory(0.0, 100.0),
    )
    if optimizer == "quad_prog":
        estimator.batch_estimate(simulator, field, [touch], config, {"tau": TareCalibrator(20)})
        return field
    estimator.online_init(simulator, field)
    controls = [{"kinova": touch[i]["angles"]} for i in range(len(touch))]
    readings = [{"tau": touch[i]["torques"]} for i in range(len(touch))]
    simulator.reset()
    tared = TareCalibrator(20).calibrate(sensor, simulator, controls, readings)
    estimator.online_reset(simulator)
    for control, reading in zip(controls[tared:], readings[tared:]):
        simulator.step(control, 0.1)
        estimator.online_update(simulator, 0.1, reading)
    estimator.online_finalize(field)
    return field


def read_what_palpate_saved(folder):
    """Loads every field in `folder` and saves it again, as npz and as a folder."""
    import torch

    vsf = import_vsf()
    for path in sorted(folder.glob("palpate*")):
        field = vsf.vsf_from_file(str(path))
        wanted = np.load(folder / f"wanted_{path.stem}.npz")
        found = arrays_of(field)
        for name in wanted.files:
            assert found[name].dtype == wanted[name].dtype, (path.name, name, found[name].dtype)
            assert found[name].tobytes() == wanted[name].tobytes(), (path.name, name)
        assert field.axis_mode == "isotropic"
        field.features["N_obs"][0] += 1  # as estimating does
        field.features["N_obs"][0] -= 1
        origin = field.compute_forces(torch.arange(3), field.rest_points[:3] + 0.01)
        pushed = -np.repeat(0.01 * wanted["K"][:3, None], 3, axis=1)
        assert np.allclose(np.abs(origin.numpy()), np.abs(pushed), rtol=1e-9)
        field.save(str(folder / f"vsf_{path.stem}.npz"))
        field.save(f"{folder / f'vsf_{path.stem}'}/")
        print(
            f"OpenVSF reads {path.name}: {field.num_points} points, stiffness to "
            f"{field.stiffness.max():.1f} N/m, K_std and N_obs, bit for bit"
        )


def hand_over(folder, packages):
    """A live field from palpate to OpenVSF and back."""
    import_vsf()
    sys.path.append(str(packages))
    from palpate import openvsf

    field = openvsf.load(folder / "palpate.npz")
    live = openvsf.to_point_vsf(field)
    back = openvsf.from_point_vsf(live)
    for name, found in arrays_of(live).items():
        wanted = {"points": field.points, "K": field.stiffness, "N_obs": field.counts}
        wanted |= {"K_std": field.std, "K_var": field.std**2}
        assert (found == wanted[name]).all(), name
    assert (back.stiffness == field.stiffness).all() and (back.std == field.std).all()
    print(f"a live PointVSF of {live.num_points} points has the same springs, and so has its field")


def run_page(folder):
    """Runs OpenVSF's part of the page as it stands."""
    os.chdir(folder)
    import_vsf()
    for code in blocks("OpenVSF"):
        exec(compile(code, PAGE.name, "exec"), {"__name__": "page"})


# In palpate's.


def save_with_palpate(folder):
    import palpate
    from palpate import openvsf

    mapper = palpate.Mapper()
    mapper.map(PLANT / "seq_000")
    learnt = mapper.field()
    small = palpate.Mapper(lattice=palpate.Lattice([0.08, -0.06, 0.5], 0.02, [19, 13, 9]))
    small.map(PLANT / "seq_000")
    whole = small.field()
    for path, field, whole_box in [
        ("palpate.npz", learnt, False),
        ("palpate_folder", learnt, False),
        ("palpate_box.npz", whole, True),
        ("palpate_box_folder", whole, True),
    ]:
        if not path.endswith(".npz"):
            (folder / path).mkdir()
        openvsf.save(field, folder / path, whole_box=whole_box)
        points = field.lattice.points(np.arange(field.lattice.n_cells)) if whole_box else field.points
        stiffness, std, counts = field.query(points)
        wanted = {"points": points, "K": stiffness, "K_std": std, "N_obs": counts.astype(np.int64)}
        np.savez(folder / f"wanted_{Path(path).stem}.npz", **wanted)
    return learnt


def read_what_openvsf_saved(folder, learnt):
    import palpate
    from palpate import openvsf

    path = np.array(next(iter(palpate.open_log(PLANT / "seq_000"))).q)
    torque = learnt.predict(path)
    for stem in ("palpate", "palpate_folder", "palpate_box", "palpate_box_folder"):
        wanted = np.load(folder / f"wanted_{stem}.npz")
        for saved in (folder / f"vsf_{stem}.npz", folder / f"vsf_{stem}"):
            field = openvsf.load(saved)
            assert field.stiffness.tobytes() == wanted["K"].tobytes(), saved.name
            assert field.std.tobytes() == wanted["K_std"].tobytes(), saved.name
            assert (field.counts == wanted["N_obs"]).all(), saved.name
            moved = np.abs(field.points - wanted["points"]).max()
            assert moved < 1e-12, saved.name
            difference = ""
            if len(field) == len(learnt):
                gap = np.abs(field.predict(path) - torque).max()
                difference = f"; predicted torque differs by {gap:.2g} of {np.abs(torque).max():.3g} N·m"
            print(
                f"palpate reads {saved.name}: {len(field)} points within {moved:.1g} m, stiffness, "
                f"std and counts bit for bit{difference}"
            )


def make_environment(folder):
    ready = folder / "required.json"  # written last
    if not ready.exists() or json.loads(ready.read_text()) != REQUIRED:
        venv.create(folder, with_pip=True)
        pip = [folder / "bin" / "python", "-m", "pip", "install", "--quiet", "--no-cache-dir"]
        subprocess.run([*pip, *REQUIRED], check=True)
        ready.write_text(json.dumps(REQUIRED))


def main(environment, *options):
    import palpate
    from palpate import openvsf

    make_environment(environment)

    def inside(work, *arguments):
        command = [environment / "bin" / "python", __file__, "--inside", work, *arguments]
        subprocess.run(command, check=True)

    if "--fixtures" in options:
        inside("write_fixtures")
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        learnt = save_with_palpate(folder)
        inside("read_what_palpate_saved", folder)
        read_what_openvsf_saved(folder, learnt)
        inside("hand_over", folder, Path(palpate.__file__).parents[1])
        (folder / "data").symlink_to(ROOT / "data")
        (folder / "kinova_gen3.urdf").symlink_to(URDF)
        inside("run_page", folder)
        page = openvsf.load(folder / "from_openvsf.npz")
        print(f"palpate reads the field of the page: {page}, up to {page.stiffness.max():.0f} N/m")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--inside"]:
        globals()[sys.argv[2]](*map(Path, sys.argv[3:]))
    elif len(sys.argv) > 1:
        main(Path(sys.argv[1]), *sys.argv[2:])
    else:
        sys.exit(__doc__)
