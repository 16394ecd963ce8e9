#!/usr/bin/env python3
"""Touches the object of a simulated set again, along given joint paths, perhaps after the object was changed.

    python scripts/touch_again.py SET PATHS --out DIR [--shift DX DY DZ] [--turn DEG] [--without-branch N]
        [--scale-stiffness F] [--noise-seed N] [--max-torque N_M] [--compliant]

SET is a set that touchsim's gen.py made; its meta.json says which object, noise and frame rate. PATHS is a folder with
seq_*/angles.npy (such as a set), one .npy (T x n, rad, a row a frame of SET), or a CSV (played by its column `time`
or `time_s`, if it has one). DIR gets seq_XXX/{angles,torques,time}.npy, truth/seq_XXX_external.npy and meta.json in
the set's format and signs: torques hold gravity, bias and noise. Every touch begins with the object at rest.

A set's angles are measured ones, so the joints follow PATHS under load, too (within about 0.15 mrad). With
--compliant, PATHS are commands, from which the load pushes the joints as in gen.py (by 0.5 to 1 mrad).
With --max-torque, the arm goes back along its path as soon as the true external torque of a joint passes the limit.
It may still grow by half: while the arm brakes, and because friction turns round and branches slip.

Everything physical is in gen.py, which is not part of palpate (--touchsim). Needs numpy, scipy and mujoco (PyPI).
A program that chooses its next touch by the last one can use the class:

    player = ScenePlayer("sets/plant_a", Change(shift_m=(0.03, 0, 0)))
    touch = player.touch(path)  # T x n rad; touch["q"], touch["ext"] (N·m), touch["ncon"], ...
    torques = player.measured(touch, rng)["torques"]
"""

import argparse
import importlib.util
import json
import re
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

TOUCHSIM = Path(__file__).resolve().parents[2] / "shared/tools/touchsim"
# Arguments that gen.py keeps in module variables. Its defaults hold for those that an old set does not list.
GLOBALS = dict(friction="FRICTION", noslip="NOSLIP", radius_power="POWER", modulus_spread="SPREAD", green_wood="GREEN")
AVERAGE_S = 0.02  # the controller averages external torques over about this time: contacts chatter
TURN_S = 0.1  # from full speed on the path to full speed back


@dataclass
class Change:
    """What is done to the object before it is touched."""

    shift_m: tuple = (0.0, 0.0, 0.0)
    turn_deg: float = 0.0  # about the vertical through the object's base
    without_branch: int | None = None  # from 0 at the foot of the plant upwards
    stiffness: float = 1.0  # factor on all springs; their relaxation times stay

    def apply(self, builder, roots):
        """Changes an object that gen.py has built and not yet compiled; `roots`: its bodies on the ground."""
        spec = builder.spec
        if self.without_branch is not None:
            found = branches(builder)
            if not 0 <= self.without_branch < len(found):
                sys.exit(f"--without-branch is {self.without_branch}; the object has {len(found)} branches, from 0")
            spec.delete(found[self.without_branch])
            builder.bodies = [name for name in builder.bodies if spec.body(name)]
            builder.geom_class = {name: kind for name, kind in builder.geom_class.items() if spec.geom(name)}
        for spring in [*spec.joints, *spec.tendons] if self.stiffness != 1 else ():
            if spring.name.startswith("obj_"):
                spring.stiffness, spring.damping = self.stiffness * spring.stiffness, self.stiffness * spring.damping
        turn, foot = Rotation.from_euler("z", self.turn_deg, degrees=True), builder.centre * [1, 1, 0]
        for body in roots if self.turn_deg or any(self.shift_m) else ():
            body.pos = turn.apply(body.pos - foot) + foot + self.shift_m
            body.quat = (turn * Rotation.from_quat(body.quat, scalar_first=True)).as_quat(scalar_first=True)


def branches(builder):
    """The first bodies of a plant's branches, from the foot upwards; twigs and leaves hang from them."""
    kind = {builder.spec.geom(name).parent.name: kind for name, kind in builder.geom_class.items()}
    bodies = (builder.spec.body(name) for name in builder.bodies)
    return [body for body in bodies if kind[body.name] == "branch" and kind.get(body.parent.name) == "trunk"]


def generator(touchsim, robots, arguments, change):
    """gen.py as a module of its own, with a set's settings, whose objects are changed after they were built: no
    random number of the object moves."""
    location = importlib.util.spec_from_file_location("touchsim_gen", Path(touchsim) / "gen.py")
    gen = importlib.util.module_from_spec(location)
    location.loader.exec_module(gen)
    for key in GLOBALS.keys() & arguments.keys():
        setattr(gen, GLOBALS[key], arguments[key])
    for robot in gen.ROBOTS.values() if robots else ():
        for key in robot.keys() & {"urdf", "meshdir", "convex"}:
            inside = Path(robot[key]).resolve().relative_to((Path(gen.ROOT) / "data/robots").resolve())
            robot[key] = str(Path(robots) / inside)

    as_generated = getattr(gen.ObjectBuilder, arguments["kind"])

    def build(builder):
        before = len(builder.spec.worldbody.bodies)
        as_generated(builder)
        change.apply(builder, builder.spec.worldbody.bodies[before:])

    setattr(gen.ObjectBuilder, arguments["kind"], build)
    return gen


class Walk:
    """The time along a path: onwards, and back from where a joint's external torque passes the limit."""

    def __init__(self, scene, end_s, frame_s, limit_n_m):
        self.scene, self.end_s, self.limit_n_m = scene, end_s, limit_n_m
        self.lead_s = frame_s / 2  # a frame is recorded as the mean over its time, so its centre is at the path's row
        self.torque, self.turned_s = 0.0, None

    def __call__(self, t):
        """Place on the path and speed at time `t`; gen.py asks for every step of the simulation in turn."""
        dt, n = self.scene.m.opt.timestep, self.scene.n
        self.torque += (self.scene.d.qfrc_constraint[:n] - self.torque) * dt / AVERAGE_S
        at, speed = t - self.lead_s, 1.0
        passed = self.limit_n_m is not None and np.abs(self.torque).max() > self.limit_n_m
        if passed and self.turned_s is None and 0 < at < self.end_s:
            self.turned_s = at
        if self.turned_s is not None:
            since = at - self.turned_s
            turning = since < TURN_S
            at = self.turned_s + (since - since**2 / TURN_S if turning else TURN_S - since)
            speed = 1 - 2 * since / TURN_S if turning else -1.0
        return (at, speed) if 0 < at < self.end_s else (min(max(at, 0.0), self.end_s), 0.0)


class ScenePlayer:
    """The object of a set, built and settled once, and the arm that touches it along one path after the other."""

    def __init__(self, folder, change=Change(), touchsim=TOUCHSIM, robots=None, compliant=False):
        self.meta = json.loads((Path(folder) / "meta.json").read_text())
        self.arguments, self.change = self.meta["arguments"], change
        gen = generator(touchsim, robots, self.arguments, change)
        self.scene = gen.Scene(SimpleNamespace(**self.arguments))
        self.frame_s, self.n_joints = 1 / self.arguments["rate"], self.scene.n
        self.n_branches = len(branches(self.scene.ob)) + (change.without_branch is not None)
        # The builder draws all of this, so that an object of another generator or version differs in it.
        for key, value in self.meta["object"].items():
            assert self.scene.ob.info[key] == value, f"{key} is {self.scene.ob.info[key]}, the set's is {value}"
        self.scene.init_rest(np.array(gen.ROBOTS[self.arguments["robot"]]["q_far"]))
        if not compliant:
            self.scene.control, self.compliant_control = self.stiff_control, self.scene.control

    def stiff_control(self, q, qd):
        """gen.py's position control, and motor torques against the external ones, so that the arm stays at `q`."""
        self.compliant_control(q, qd)
        self.scene.d.ctrl[: self.n_joints] -= self.walk.torque / self.scene.kp

    def touch(self, path, max_torque_n_m=None):
        """What gen.py returns of a touch along `path` (T x n rad, a row a frame, at rest at both ends): T x n angles
        `q`, torques `tau` without noise and `ext` of the contacts, times `t`, contacts `ncon`; and `turned_s`."""
        path = np.unwrap(np.asarray(path, float), axis=0)
        if path.ndim != 2 or len(path) < 2 or path.shape[1] != self.n_joints:
            raise ValueError(f"the path is {path.shape}; wanted two frames or more x {self.n_joints} joints")
        end_s = (len(path) - 1) * self.frame_s
        along, frames = CubicSpline(np.arange(len(path)) * self.frame_s, path), len(path)
        while True:
            mujoco.mj_resetData(self.scene.m, self.scene.d)
            self.scene.d.qpos[:] = self.scene.rest
            self.walk = Walk(self.scene, end_s, self.frame_s, max_torque_n_m)
            touch = self.scene.run_touch(along, self.walk, frames, self.frame_s)
            turned_s = self.walk.turned_s
            back = 0 if turned_s is None else int(np.ceil((2 * turned_s + TURN_S) / self.frame_s)) + 2
            if back <= frames:
                return touch | {"turned_s": turned_s}
            frames = back  # turned late: the same touch again, until the arm is back

    def measured(self, touch, rng):
        """The touch as a log: angles, torques with a bias and noise of the set's size, times; and what was drawn."""
        sigma = rng.uniform(*self.arguments["noise"])
        bias = rng.uniform(-self.arguments["bias"], self.arguments["bias"], self.n_joints)
        torques = touch["tau"] + bias + sigma * rng.normal(size=touch["tau"].shape)
        return dict(angles=touch["q"], torques=torques, time=touch["t"], noise_sigma_Nm=sigma, bias_Nm=bias.tolist())


def read_paths(source, n, frame_s):
    """Names and paths, T x n: of a folder's touches in order of their numbers, or of a file."""
    if source.is_dir():
        files = sorted(source.glob("seq_*/angles.npy"), key=lambda file: (len(file.parent.name), file.parent.name))
        return {file.parent.name: np.load(file) for file in files}
    if source.suffix == ".npy":
        return {"seq_000": np.load(source)}
    names = source.read_text().splitlines()[0].replace('"', "").lower().split(",")
    rows = np.genfromtxt(source, delimiter=",", skip_header=1)
    # `palpate excite` has velocities and accelerations after the positions.
    positions = [k for k, name in enumerate(names) if re.search(r"position|^q_?\d+$", name)]
    path = np.unwrap(rows[:, positions if len(positions) == n else slice(-n, None)], axis=0)
    clock = [k for k, name in enumerate(names) if name in ("time", "time_s")]
    if clock:
        since = rows[:, clock[0]] - rows[0, clock[0]]
        path = CubicSpline(since, path)(np.arange(since[-1] / frame_s + 1e-6) * frame_s)
    return {"seq_000": path}


def write_touch(out, name, touch, log):
    """Writes a touch as touches of a set are written; returns what meta.json says of it."""
    (out / name).mkdir()
    for what in ("angles", "torques", "time"):
        np.save(out / name / f"{what}.npy", log[what])
    np.save(out / "truth" / f"{name}_external.npy", touch["ext"])
    np.save(out / "truth" / f"{name}_ncontact.npy", touch["ncon"].astype(np.int16))
    contact = np.flatnonzero(touch["ncon"])
    return dict(name=name, peak_external_Nm=float(np.linalg.norm(touch["ext"], axis=1).max()),
                contact_frames=len(contact), first_contact=int(contact[0]) if len(contact) else None,
                turned_s=touch["turned_s"], frames_in_contact_by_class=touch["touched"],
                noise_sigma_Nm=log["noise_sigma_Nm"], bias_Nm=log["bias_Nm"])  # fmt: skip


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("set", type=Path)
    parser.add_argument("paths", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--shift", type=float, nargs=3, default=[0.0] * 3, metavar=("DX", "DY", "DZ"), help="shift, m")
    parser.add_argument("--turn", type=float, default=0.0, metavar="DEG", help="turn about the vertical through the base")
    parser.add_argument("--without-branch", type=int, metavar="N", help="branch of a plant to remove, from 0 at the foot")
    parser.add_argument("--scale-stiffness", type=float, default=1.0, metavar="F", help="factor on all springs")
    parser.add_argument("--noise-seed", type=int, default=0, help="seed of bias and noise")
    parser.add_argument("--max-torque", type=float, metavar="N_M", help="external torque of a joint that ends a push")
    parser.add_argument("--compliant", action="store_true", help="PATHS are commands: the arm gives way under load")
    parser.add_argument("--touchsim", type=Path, default=TOUCHSIM, help="folder of gen.py")
    parser.add_argument("--robots", type=Path, help="folder of the robots' folders (default: where gen.py looks)")
    args = parser.parse_args()
    if args.out.exists():
        sys.exit(f"{args.out} exists already")
    change = Change(tuple(args.shift), args.turn, args.without_branch, args.scale_stiffness)
    player = ScenePlayer(args.set, change, args.touchsim, args.robots, args.compliant)
    paths = read_paths(args.paths, player.n_joints, player.frame_s)
    if not paths:
        sys.exit(f"{args.paths} has no seq_*/angles.npy")
    if change.without_branch is not None:
        print(f"the plant has {player.n_branches} branches; number {change.without_branch} is removed")

    (args.out / "truth").mkdir(parents=True)
    touches = []
    for k, (name, path) in enumerate(paths.items()):
        begun = time.perf_counter()
        touch = player.touch(path, args.max_torque)
        log = player.measured(touch, np.random.default_rng([args.noise_seed, k]))
        touches.append(write_touch(args.out, name, touch, log))
        line = "{name}: {peak_external_Nm:.2f} N·m at most, {contact_frames} frames in contact, first {first_contact}"
        line += "" if touch["turned_s"] is None else ", back after {turned_s:.2f} s"
        print(line.format(**touches[-1]), f"({time.perf_counter() - begun:.1f} s)", flush=True)
    kept = ("arguments", "robot", "joint_names", "end_effector", "world", "conventions", "classes", "object")
    meta = {key: player.meta[key] for key in kept if key in player.meta}
    starts = [touch["first_contact"] for touch in touches if touch["first_contact"] is not None]
    still = meta["conventions"]["contact_free_start_frames"]
    meta["conventions"]["contact_free_start_frames"] = min([still, *starts])
    command = {key: str(value) if isinstance(value, Path) else value for key, value in vars(args).items()}
    meta |= dict(generator="touch_again.py", engine=f"mujoco {mujoco.__version__}", again=command,
                 change=asdict(change), object_note="`object` and `arguments` are those before the change",
                 frame_period_s=player.frame_s, sequences=len(touches), touches=touches)  # fmt: skip
    (args.out / "meta.json").write_text(json.dumps(meta, indent=1))


if __name__ == "__main__":
    main()
