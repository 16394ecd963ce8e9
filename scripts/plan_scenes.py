#!/usr/bin/env python3
"""Plans paths through simulated objects by their fields, plays them in MuJoCo, and says what torque they met.

    python scripts/plan_scenes.py --sets FOLDER --out DIR [--scenes 10] [--seconds 40] [--seed 0] [--bodies FOLDER]

FOLDER has the seven sets that touchsim's gen.py made. Of each set in turn a scene is made, by this rule:

- start: the first posture of a touch of the set, drawn at random;
- goal: a posture drawn at random, no joint more than 2 rad from the start's. Its end effector is in the box of the
  seen points (object.ply), 5 cm wider on all sides, and behind seen points: at least 100 of them lie within 4 cm of the
  level line to it from the axis of the arm's base, and nearer by 5 cm. The arm touches no wood there, stalk or cushion;
  leaves it may;
- the straight path between them is free of self-collision, of the ground and the pot. Its true peak, the largest
  absolute external torque of any joint, is 3 to 30 N·m. Goals are drawn until this holds.

Four paths are played by touch_again.py's ScenePlayer at 0.3 rad/s of the fastest joint:

- straight;
- field: planned by the field of all touches of the set, with extrapolated cells and `with_view`, in a quarter of the
  time;
- avoiding: planned by the seen points alone, taken to be equally stiff up to 1 cm off, in a quarter of the time. It
  touches none of them if there is such a path and it is found;
- planned: these two and the straight path, varied for the rest of the time and compared by a field with an elastic body.

A goal is reached if every joint ends within 0.02 rad of it and no torque was above 30 N·m, where a guard would stop.
The planner knows the arm, the pot, the ground, the touches and the cloud; of the truth it knows that the start is free.
DIR gets scenes.json and a picture of each scene. Needs palpate[planning], numpy, scipy, matplotlib and mujoco (PyPI).
"""

import argparse
import json
import warnings
from pathlib import Path

import numpy as np
import palpate
from palpate.planning import FieldCost, plan, with_view
from touch_again import ScenePlayer

SETS = ("plant_a", "plant_b", "plant_c", "plant_spread", "plant_d", "cushion_a", "stalks_a")
PEAK = 3.0, 30.0  # N·m: of straight paths; the guard is the upper one
STEP_RAD = 0.015  # of the fastest joint in a frame of 0.05 s
BEHIND = 100  # seen points
NAMES = ("straight", "planned", "field", "avoiding")
MARGIN_M = 0.01  # of the path that avoids all seen points


def seen_points(folder):
    """The points of object.ply, N x 3 m."""
    body = (folder / "object.ply").read_bytes().split(b"end_header\n", 1)[1]
    return np.frombuffer(body, dtype=[("at", "<f4", 3), ("colour", "u1", 3)])["at"].astype(float)


def frames(path):
    """A path as frames at constant speed, which it takes up and gives up over a tenth of them."""
    along = np.r_[0, np.cumsum(np.abs(np.diff(path, axis=0)).max(1))]
    t = np.linspace(0, 1, max(int(np.ceil(along[-1] / 0.9 / STEP_RAD)), 20) + 1)
    s = np.where(t < 0.1, t**2 / 0.18, np.where(t > 0.9, 1 - (1 - t) ** 2 / 0.18, (t - 0.05) / 0.9))
    return np.stack([np.interp(s * along[-1], along, joint) for joint in path.T], axis=1)


class Scene:
    """An object, its field, and a start and goal between which the straight path presses it."""

    def __init__(self, folder, rng):
        self.player, self.cloud = ScenePlayer(folder), seen_points(folder)
        self.scene = self.player.scene
        self.start, self.goal, self.straight = self.draw(folder, rng)

    def draw(self, folder, rng):
        scene = self.scene
        box = self.cloud.min(0) - 0.05, self.cloud.max(0) + 0.05
        low, high = np.maximum(scene.lo, -np.pi) + 0.02, np.minimum(scene.hi, np.pi) - 0.02
        turns = ~np.isfinite(scene.lo)
        starts = [np.load(touch)[0] for touch in sorted(folder.glob("seq_*/angles.npy"))]
        while True:
            start, goal = starts[rng.integers(len(starts))], rng.uniform(low, high)
            goal[turns] = start[turns] + (goal - start + np.pi)[turns] % (2 * np.pi) - np.pi
            at = scene.fk(goal)[0]
            if np.abs(goal - start).max() > 2 or not ((at > box[0]) & (at < box[1])).all() or not self.behind(at):
                continue
            if scene.contacts(goal, scene.d)[1] or not all(map(self.allowed, frames(np.array([start, goal]))[::4])):
                continue
            straight = self.play(np.array([start, goal]))
            if PEAK[0] <= straight["peak"] <= PEAK[1]:
                return start, goal, straight

    def behind(self, at):
        """Whether enough seen points lie on the level line from the base's axis to `at`, and nearer by 5 cm."""
        far = np.hypot(*at[:2])
        level = at * [1, 1, 0] / far
        along = self.cloud @ level
        aside = np.linalg.norm(self.cloud - at - (along - far)[:, None] * level, axis=1)
        return ((aside < 0.04) & (along > 0) & (along < far - 0.05)).sum() >= BEHIND

    def allowed(self, q):
        """Free of self-collision, the ground and the pot."""
        return self.scene.arm_ok(q)

    def play(self, path):
        """What MuJoCo says of a path: the torque of each frame, its peak and where the arm ends."""
        touch = self.player.touch(frames(path))
        peak = float(np.abs(touch["ext"]).max())
        reached = peak <= PEAK[1] and float(np.abs(touch["q"][-1] - path[-1]).max()) <= 0.02
        return dict(path=path, torque=touch["ext"], peak=peak, reached=bool(reached), touched=touch["touched"])


def fields(folder, cloud):
    """The field to plan with, and one of all seen points, equally stiff, whose contact distance is the margin."""
    mapper = palpate.Mapper()
    mapper.map(str(folder), progress=False)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # where colour says nothing about stiffness
        field = palpate.extrapolate(mapper.field(), str(folder / "object.ply"), progress=False).field
    camera = json.loads((folder / "rgbd/camera.json").read_text())["camera_to_world"]
    field = with_view(field, cloud, np.array(camera)[:3, 3])
    lattice = field.lattice
    seen = lattice.points(np.unique(lattice.cells(cloud)))
    near = {"contact_distance_m": MARGIN_M}
    return field, palpate.Field.from_arrays(seen, np.ones(len(seen)), lattice=lattice, contact=near)


def body_of(folder, kept):
    """The field with an elastic body of a set, from the folder `kept`, or learned in two minutes and left there."""
    path = kept / f"{folder.name}.npz"
    if not path.exists():
        kept.mkdir(parents=True, exist_ok=True)
        palpate.map_elastic(str(folder), str(folder / "object.ply"), progress=False).save(path)
    return palpate.Field.load(path)


def solve(scene, folder, args):
    """The straight path and the planned ones, with what MuJoCo says of them."""
    robot, ends = palpate.Robot(), (scene.start, scene.goal)
    field, seen = fields(folder, scene.cloud)
    body = FieldCost(body_of(folder, args.bodies).path_predictor(robot))
    found = {}
    for name, own in dict(field=field, avoiding=seen).items():
        cost = FieldCost(own.path_predictor(robot, coarse=True))
        found[name] = plan(cost, *ends, robot.limits, valid=scene.allowed, seconds=args.seconds / 4)
    guesses = [own.via for own in found.values() if own is not None]
    half = args.seconds / 2
    found["planned"] = plan(body, *ends, robot.limits, valid=scene.allowed, seconds=half, guesses=guesses, batch=4)
    solved = dict(straight=scene.straight)
    for name, own in found.items():
        if own is None:
            raise SystemExit(f"no path was found for `{name}`, although the straight one is allowed; give more --seconds")
        solved[name] = scene.play(own.path) | dict(cost=own.cost, seconds=own.seconds)
    solved["planned"]["seconds"] = sum(own.seconds for own in found.values())
    return {name: own | dict(predicted=float(body.cost(own["path"]))) for name, own in solved.items()}


def picture(path, title, scene, solved):
    """The seen points and the end effector's way from two sides, the arm at the goal, and the true torques."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, 3, figsize=(13, 4.2))
    kin, n = scene.scene.kin, scene.scene.n
    links = [k for k in range(1, scene.scene.m.nbody) if not scene.scene.m.body(k).name.startswith("obj_")]
    colours = dict(straight="#d62728", planned="#1f77b4", field="#9467bd", avoiding="#2ca02c")
    for axis, (x, y) in zip(axes, ((0, 2), (0, 1))):
        axis.scatter(scene.cloud[::10, x], scene.cloud[::10, y], s=1, c="0.8")
        for q, dash in ((scene.start, ":"), (scene.goal, "-")):
            end = scene.scene.fk(q)[0]
            joints = np.vstack([kin.xpos[links], end])
            axis.plot(joints[:, x], joints[:, y], dash, color="0.4", lw=2)
        for name, played in solved.items():
            at = np.array([scene.scene.fk(q)[0] for q in frames(played["path"])])
            axis.plot(at[:, x], at[:, y], color=colours[name])
        axis.set(xlabel="xyz"[x] + ", m", ylabel="xyz"[y] + ", m", aspect="equal")
    for name, played in solved.items():
        axes[2].plot(np.abs(played["torque"]).max(1), color=colours[name], label=f"{name}: {played['peak']:.2f}")
    axes[2].set(xlabel="frame (0.05 s)", ylabel="largest true torque, N·m", title=title)
    axes[2].legend(frameon=False)
    figure.tight_layout()
    figure.savefig(path, dpi=80)
    pyplot.close(figure)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", type=Path, required=True)
    parser.add_argument("--names", nargs="+", default=SETS)
    parser.add_argument("--scenes", type=int, default=10)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--bodies", type=Path, help="fields with elastic bodies, made if missing (default: OUT/bodies)")
    parser.add_argument("--seconds", type=float, default=40.0, help="time for planning, s")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    args.bodies = args.bodies or args.out / "bodies"
    print(f"largest torque, true (and predicted), of {', '.join(NAMES)}, N·m; contact of `avoiding` with seen points;")
    print("then of `planned`: goal reached, time of planning, frames in contact")
    rows = []
    for number in range(args.scenes):
        name = args.names[number % len(args.names)]
        scene = Scene(args.sets / name, np.random.default_rng([args.seed, number]))
        solved = solve(scene, args.sets / name, args)
        picture(args.out / f"scene_{number}.png", f"{number}: {name} (simulated)", scene, solved)
        peaks = "".join(f"{solved[key]['peak']:7.2f} ({solved[key]['predicted']:5.2f})" for key in NAMES)
        planned = solved["planned"]
        print(
            f"{number:2} {name:13}{peaks}  {'none' if solved['avoiding']['cost'] == 0 else 'some'}"
            f"  {'yes' if planned['reached'] else 'no'}  {planned['seconds']:.0f} s  {planned['touched']}",
            flush=True,
        )
        rows.append(solved | dict(set=name))
        (args.out / "scenes.json").write_text(json.dumps(rows, default=np.ndarray.tolist))
    for name in NAMES:
        ratio = np.median([row[name]["peak"] / row["straight"]["peak"] for row in rows])
        reached = sum(row[name]["reached"] for row in rows)
        print(f"{name:9} true peak over that of straight, median: {ratio:.2f}; goal reached: {reached} of {len(rows)}")


if __name__ == "__main__":
    main()
