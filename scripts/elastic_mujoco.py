#!/usr/bin/env python3
"""The torques of palpate's elastic bodies beside MuJoCo's, on the same body and the same motions.

A rod on a slide and a hinge pushes three stems with a branch each, in several motions. palpate predicts the
torques of the two joints from the body's file (`palpate map --body`). MuJoCo moves the rod through the model
that `palpate convert` writes, and comes to rest after each frame; its torques are those of the contact forces.
MuJoCo's contacts have its default softness, which is about that of palpate's, or are hard with --stiff. Needs
numpy and mujoco (both on PyPI).

    python scripts/elastic_mujoco.py target/release/palpate [--stiff]
"""

import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import mujoco
import numpy as np

ROD = 0.4  # m
URDF = f"""<robot name="paddle"><link name="base"/><link name="slide"/><link name="rod">
<collision><origin xyz="{ROD / 2} 0 0"/><geometry><box size="{ROD} 0.04 0.04"/></geometry></collision></link>
<joint name="along" type="prismatic"><parent link="base"/><child link="slide"/><axis xyz="1 0 0"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<joint name="turn" type="continuous"><parent link="slide"/><child link="rod"/><axis xyz="0 0 1"/></joint></robot>"""
MOTIONS, FRAMES, STILL = 36, 120, 10
STEPS = 400  # of MuJoCo between two frames
STEP_S = 0.0005
# Of the damping that `palpate convert` writes: with all of it, MuJoCo would need seconds to come to rest.
DAMPING_SHARE = 0.03
LEAST = 0.05  # N·m; smaller pushes are not compared
STIFF = "--stiff" in sys.argv


def body(rng):
    segments = []

    def rod(parent, start, end, radius, branch):
        length = np.linalg.norm(np.subtract(end, start))
        segments.append(dict(parent=parent, kind="wood", start_m=list(map(float, start)), end_m=list(map(float, end)),
                             bare_m=0.0, radius_m=radius, half_width_m=[0.0, 0.0, 0.0],
                             joint_stiffness=4.8e8 * np.pi / 4 * radius**4 / length, branch=branch))
        return len(segments) - 1

    branch = 0
    for stem in range(3):
        foot = np.array([0.14 + 0.06 * stem, 0.1, -0.25]) + rng.uniform(-0.01, 0.01, 3) * [1, 1, 0]
        lean = rng.uniform(-0.06, 0.06, 2)
        at = lambda way: foot + way * np.array([lean[0], lean[1], 1.0])
        parent = None
        for piece in range(9):
            parent = rod(parent, at(0.06 * piece), at(0.06 * (piece + 1)), 0.006 - 0.0003 * piece, branch)
            if piece == 4:
                fork = parent
        branch += 1
        way = rng.uniform(-1, 1, 3) * [1, 1, 0.3]
        way *= 0.03 / np.linalg.norm(way)
        start, parent = at(0.30), fork
        for piece in range(4):
            parent = rod(parent, start + piece * way, start + (piece + 1) * way, 0.003, branch)
        branch += 1
    return {"segments": segments}


def motions(rng):
    """Positions of slide and hinge: still, then a smooth push, and half back."""
    for _ in range(MOTIONS):
        x, turn, slide = rng.uniform(-0.05, 0.05), rng.uniform(0.3, 0.5), rng.uniform(-0.03, 0.03)
        s = np.concatenate([np.zeros(STILL), np.linspace(0, 1, FRAMES - STILL)])
        push = np.where(s < 0.7, np.sin(np.pi / 2 * s / 0.7), 1 - 0.5 * (s - 0.7) / 0.3)
        yield np.stack([x + slide * push, -0.1 + turn * push], axis=1)


def with_contact(field, friction):
    """Sets what only touches can determine (friction, no creep) in the body of a field's file."""
    arrays = dict(np.load(field))
    body = json.loads(arrays["elastic"].tobytes())
    body.update(friction=friction, creep_s=0.0)
    arrays["elastic"] = np.frombuffer(json.dumps(body).encode(), np.uint8)
    np.savez(field, **arrays)


def simulated(xml, path, friction):
    """Force along the slide and torque about the hinge that MuJoCo's contacts put on the rod, frames x 2."""
    contact = 'solref="0.002 1" solimp="0.99 0.999 0.0002"' if STIFF else ""
    rod = (f'<body name="rod" mocap="true" pos="0 0 0"><geom name="rod" type="box" pos="{ROD / 2} 0 0" '
           f'size="{ROD / 2} 0.02 0.02" contype="2" conaffinity="1" priority="1" friction="{friction}" condim="3" {contact}/>'
           "</body>\n  </worldbody>")
    option = f'timestep="{STEP_S}" cone="elliptic" impratio="20" noslip_iterations="20"'
    xml = xml.replace("</worldbody>", rod).replace('gravity="0 0 0"', f'gravity="0 0 0" {option}')
    less = lambda found: f'damping="{float(found[1]) * DAMPING_SHARE:.9g}"'
    xml = re.sub(r'damping="([^"]*)"', less, xml)
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    rod = model.geom("rod").id
    torques = np.zeros((len(path), 2))
    before = path[0]
    for frame, now in enumerate(path):
        sums = np.zeros(2)
        for step in range(STEPS):
            x, turn = before + (now - before) * min(1.0, (step + 1) / (STEPS / 2))
            data.mocap_pos[0] = [x, 0, 0]
            data.mocap_quat[0] = [np.cos(turn / 2), 0, 0, np.sin(turn / 2)]
            mujoco.mj_step(model, data)
            if step < STEPS - 10:
                continue
            for number in range(data.ncon):  # the mean of the last steps, in which the rod stands still
                contact = data.contact[number]
                wrench = np.zeros(6)
                mujoco.mj_contactForce(model, data, number, wrench)
                force = contact.frame.reshape(3, 3).T @ wrench[:3] * (1 if contact.geom2 == rod else -1)
                sums += [force[0], np.cross(contact.pos - [x, 0, 0], force)[2]]
        torques[frame] = sums / 10
        before = now
    return torques


def compared(palpate, folder, paths, friction):
    field, robot = folder / "field.npz", ["--robot", str(folder / "paddle.urdf"), "--no-cache", "--bake-spacing-m", "0.004"]
    run = lambda *args: subprocess.run([palpate, *map(str, args), "--quiet"], check=True, capture_output=True)
    run("map", "--body", folder / "body.json", "-o", field, *robot)
    with_contact(field, friction)
    run("convert", field, "-o", folder / "body.xml")
    run("predict", field, folder / "log", "-o", folder / "torques.npz", "--gravity", "removed", *robot)
    predicted, xml = np.load(folder / "torques.npz"), (folder / "body.xml").read_text()
    print(f"friction {friction}\nmotion  largest torque [N·m]  largest force [N]  torque off by  force off by  both off by")
    all_off = []
    for number, path in enumerate(paths):
        ours = predicted[f"push_{number:02}/predicted"]
        theirs = simulated(xml, path, max(friction, 1e-5))[predicted[f"push_{number:02}/frame"].astype(int)]
        size = np.abs(theirs).max(axis=0)
        if size[1] < LEAST:
            continue
        # In units of torque: the force has the lever of the rod's end.
        scale = np.array([ROD, 1.0])
        off = np.linalg.norm((ours - theirs) * scale, axis=1)
        both = np.sqrt((off**2).sum() / ((theirs * scale) ** 2).sum())
        force, torque = np.sqrt(((ours - theirs) ** 2).sum(axis=0) / np.maximum((theirs**2).sum(axis=0), 1e-12))
        all_off.append([torque, both])
        print(f"{number:6}  {size[1]:20.3f}  {size[0]:17.3f}  {torque:11.1%}  {force:12.1%}  {both:11.1%}", flush=True)
    (torque, both), (worst, worst_both) = np.median(all_off, axis=0), np.max(all_off, axis=0)
    print(f"median of {len(all_off)} motions: torque off by {torque:.1%}, torque and force by {both:.1%}; "
          f"worst {worst:.1%} and {worst_both:.1%}; within 5 %: {sum(off[0] <= 0.05 for off in all_off)} and "
          f"{sum(off[1] <= 0.05 for off in all_off)}")


def main():
    palpate, rng = sys.argv[1], np.random.default_rng(7)
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        (folder / "paddle.urdf").write_text(URDF)
        (folder / "body.json").write_text(json.dumps(body(rng)))
        paths = list(motions(rng))
        for number, path in enumerate(paths):
            touch = folder / "log" / f"push_{number:02}"
            touch.mkdir(parents=True)
            np.save(touch / "angles.npy", path)
            np.save(touch / "torques.npy", np.zeros_like(path))
        for friction in [0.0, 0.4]:
            compared(palpate, folder, paths, friction)


if __name__ == "__main__":
    main()
