#!/usr/bin/env python3
"""Logs of a simulated arm in free motion with known faults, to judge `palpate identify` by.

    scripts/simulated_arm_logs.py OUT --seed 1 --draws 20 [--motion-seed 2] [--contact 4] [--without friction ...]
    scripts/simulated_arm_logs.py score OUT --command "target/release/palpate identify"

The first form writes OUT/draw_000/log/seq_000/{angles,torques,time}.npy (T x n rad, T x n N·m, T s), some motions
a draw, and everything injected into OUT/draw_000/truth.json, in the keys of the command's JSON. The torques come
from MuJoCo's inverse dynamics, which share no code with palpate. Injected are a payload, errors of the URDF's
masses, friction, bias and drift, a delay of the torques, gains of the drives, and noise. One seed gives the same
motions and faults whatever is left out, with contact or without; --motion-seed gives other motions of the same arms.
--contact pushes the last link; the true external torques (environment on robot, N·m, without delay) and the times of
contact are then in OUT/draw_000/truth/.

With --torque-sign plus the torques are those that gravity and the environment exert, as in palpate's data sets:

    motor  = inverse dynamics + friction - external
    torque = -gain * motor(t - delay) + bias + drift + noise        (+gain * motor with minus)

The second form runs the command on every draw and prints its errors, how often its 95 % intervals cover the
truth, and the errors of taking the URDF as it is. Needs numpy and mujoco (both on PyPI).
"""

import argparse
import json
import shlex
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np

GEN3 = Path(__file__).resolve().parents[1] / "crates/palpate/src/robot/kinova_gen3.urdf"
BIG_N_M = 30.0  # joints of at least this effort limit have the friction of big joints
BASE_HZ, HARMONICS = 0.1, 4  # of every joint's Fourier series
STILL_S, RAMP_S, END_S = 1.0, 2.0, 0.5  # still, ramp in; ramp out, still
RANGE_SHARE, SPEED_SHARE = 0.8, 0.6  # of the URDF's limits that a motion may use
FINE_HZ, LEAD_S = 4000.0, 0.05  # rate of the simulated friction, and how long before the log it begins
RISE_S, HOLD_S, GAP_S = 0.2, 0.5, 1.0  # of a push (it falls as it rises), and the least time between two
FIRST_PUSH_S = 2.0
FAULTS = ["payload", "links", "friction", "bias", "delay", "gain", "noise"]


def text(numbers):
    return " ".join(f"{x:.17g}" for x in np.atleast_1d(numbers))


class Arm:
    """The moving joints of a URDF in MuJoCo: without shapes, friction and rotor inertia, gravity along -z."""

    def __init__(self, path, links=None, payload=None):
        """`links`: by name, (mass factor, shift of the centre [m], inertia factor); `payload`: (link, kg, [m])."""
        robot = ElementTree.parse(path).getroot()
        for part in list(robot):
            if part.tag not in ("link", "joint"):
                robot.remove(part)
            for detail in list(part):
                if detail.tag in ("visual", "collision", "dynamics", "mimic"):
                    part.remove(detail)
        self.links = [link.get("name") for link in robot.findall("link[inertial]")]
        for name, errors in (links or {}).items():
            add_errors(robot.find(f"link[@name='{name}']/inertial"), *errors)
        moving = {joint.get("name"): joint for joint in robot.findall("joint") if joint.get("type") != "fixed"}
        children = {}
        for joint in robot.findall("joint"):
            children.setdefault(joint.find("parent").get("link"), []).append(joint)
        if payload and payload[1] > 0:
            add_payload(robot, *payload)
        # By itself MuJoCo would merge links that do not move against each other.
        keep = dict(fusestatic="false", balanceinertia="false", discardvisual="true", strippath="true")
        ElementTree.SubElement(ElementTree.SubElement(robot, "mujoco"), "compiler", keep)
        self.model = mujoco.MjModel.from_xml_string(ElementTree.tostring(robot, encoding="unicode"))
        self.model.opt.gravity[:] = [0, 0, -9.81]
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
        self.data = mujoco.MjData(self.model)
        n = self.model.nv
        if list(self.model.dof_parentid) != list(range(-1, n - 1)):
            sys.exit(f"{path}: the moving joints are not one chain")
        masses = sum(float(mass.get("value")) for mass in robot.iter("mass"))
        assert np.isclose(self.model.body_mass.sum(), masses), "MuJoCo has left out the mass of a link"
        self.names = [self.model.joint(j).name for j in range(n)]
        self.link = moving[self.names[-1]].find("child").get("link")
        while self.link in children:  # on through fixed joints, to the tip
            self.link = children[self.link][0].find("child").get("link")
        limit = lambda joint, key, default: float(getattr(joint.find("limit"), "attrib", {}).get(key, default))
        column = lambda key, default: np.array([limit(moving[name], key, default) for name in self.names])
        self.effort, self.speed = column("effort", BIG_N_M), column("velocity", 1.0)
        # Joints without limits turn by half a turn either way.
        turns = np.array([moving[name].get("type") == "continuous" for name in self.names])
        self.lower = np.where(turns, -np.pi, column("lower", -np.pi))
        self.upper = np.where(turns, np.pi, column("upper", np.pi))

    def motor(self, q, v, a):
        """Motor torques of the rigid arm, T x n, N·m."""
        torques, data = np.empty_like(q), self.data
        for k in range(len(q)):
            data.qpos[:], data.qvel[:], data.qacc[:] = q[k], v[k], a[k]
            mujoco.mj_inverse(self.model, data)
            torques[k] = data.qfrc_inverse
        return torques

    def pose(self, link, q):
        """Origin and axes of a link in the world; also sets the state for Jacobians."""
        self.data.qpos[:] = q
        mujoco.mj_fwdPosition(self.model, self.data)
        return self.data.body(link).xpos.copy(), self.data.body(link).xmat.reshape(3, 3).copy()

    def push(self, q, force):
        """Joint torques of a force (world frame, N) at the last link's origin."""
        self.pose(self.link, q)
        jacobian = np.zeros((3, self.model.nv))
        mujoco.mj_jacBody(self.model, self.data, jacobian, None, self.model.body(self.link).id)
        return jacobian.T @ force


def add_errors(inertial, mass_factor, shift_m, inertia_factor):
    mass, inertia, origin = inertial.find("mass"), inertial.find("inertia"), inertial.find("origin")
    if origin is None:
        origin = ElementTree.SubElement(inertial, "origin")
    mass.set("value", text(float(mass.get("value")) * mass_factor))
    origin.set("xyz", text(np.array(origin.get("xyz", "0 0 0").split(), float) + shift_m))
    for key in inertia.attrib:
        inertia.set(key, text(float(inertia.get(key)) * inertia_factor))


def add_payload(robot, link, mass_kg, centre_m, radius_m=0.04):
    """Fixes a solid sphere to a link."""
    inertial = ElementTree.SubElement(ElementTree.SubElement(robot, "link", name="payload"), "inertial")
    moment = text(0.4 * mass_kg * radius_m**2)
    ElementTree.SubElement(inertial, "mass", value=text(mass_kg))
    ElementTree.SubElement(inertial, "inertia", ixx=moment, iyy=moment, izz=moment, ixy="0", ixz="0", iyz="0")
    joint = ElementTree.SubElement(robot, "joint", name="payload", type="fixed")
    ElementTree.SubElement(joint, "origin", xyz=text(centre_m))
    ElementTree.SubElement(joint, "parent", link=link)
    ElementTree.SubElement(joint, "child", link="payload")


def smooth(s):
    """A step of s = 0..1 with continuous second derivative, and its first two derivatives."""
    s = np.clip(s, 0, 1)
    return s**3 * (10 - 15 * s + 6 * s**2), 30 * s**2 * (1 - s) ** 2, 60 * s * (1 - s) * (1 - 2 * s)


class Motion:
    """Fourier series about a random pose, faded in and out."""

    def __init__(self, rng, arm, seconds):
        self.end, n, span = seconds - END_S, len(arm.names), arm.upper - arm.lower
        self.centre = arm.lower + rng.uniform(0.25, 0.75, n) * span
        self.waves = rng.normal(size=(2, HARMONICS, n)) / np.arange(1, HARMONICS + 1)[:, None]
        q, v, _ = self.at(np.arange(0, seconds, 1e-3))
        reach = np.minimum(self.centre - arm.lower, arm.upper - self.centre) - (1 - RANGE_SHARE) / 2 * span
        most = np.minimum(reach / np.abs(q - self.centre).max(axis=0), SPEED_SHARE * arm.speed / np.abs(v).max(axis=0))
        self.waves *= rng.uniform(0.6, 1.0, n) * most

    def at(self, t):
        """Positions, velocities and accelerations at times [s], T x n each."""
        omega = 2 * np.pi * BASE_HZ * np.arange(1, HARMONICS + 1)
        angle = np.outer(t, omega)
        sine, cosine = np.sin(angle), np.cos(angle)
        f = sine @ self.waves[0] + cosine @ self.waves[1]
        df = (cosine * omega) @ self.waves[0] - (sine * omega) @ self.waves[1]
        ddf = -(sine * omega**2) @ self.waves[0] - (cosine * omega**2) @ self.waves[1]
        fade_in, fade_out = smooth((t - STILL_S) / RAMP_S), smooth((self.end - t) / RAMP_S)
        w = (fade_in[0] * fade_out[0])[:, None]
        dw = ((fade_in[1] * fade_out[0] - fade_in[0] * fade_out[1]) / RAMP_S)[:, None]
        ddw = (fade_in[2] * fade_out[0] - 2 * fade_in[1] * fade_out[1] + fade_in[0] * fade_out[2])[:, None] / RAMP_S**2
        return self.centre + w * f, dw * f + w * df, ddw * f + 2 * dw * df + w * ddf


def draw_faults(rng, arm, args):
    n, big = len(arm.names), arm.effort >= BIG_N_M
    on = {fault: fault not in args.without and "all" not in args.without for fault in FAULTS}
    sized = lambda of_big, of_wrist: np.where(big, rng.uniform(*of_big, n), rng.uniform(*of_wrist, n))
    faults = dict(
        mass_kg=rng.uniform(0.3, 2.5) * on["payload"],
        centre_m=np.append(rng.uniform(-0.06, 0.06, 2), rng.uniform(0, 0.15)),
        coulomb=sized((0.2, 1.0), (0.1, 0.5)) * on["friction"],
        viscous=sized((0.1, 1.5), (0.05, 0.5)) * on["friction"],
        asymmetry=rng.uniform(-0.15, 0.15, n),  # of the Coulomb friction between the directions
        breakaway=rng.uniform(0, 0.3, n),  # excess at standstill, as a share of the Coulomb friction
        stribeck=rng.uniform(0.01, 0.05, n),  # rad/s
        presliding=rng.uniform(0.2e-3, 2e-3, n),  # rad
        bias=rng.normal(0, 0.3, n) * on["bias"],
        offset=rng.normal(0, 0.05, (args.motions, n)) * on["bias"],
        drift=rng.normal(0, 0.1, (args.motions, n)) * on["bias"],  # over a whole motion
        delay=rng.uniform(0, args.max_delay_ms * 1e-3) * on["delay"],
        gain=rng.normal(1, args.gain_std * on["gain"], n),
        noise=rng.uniform(*args.noise_n_m, args.motions) * on["noise"],
    )
    e = args.link_error * on["links"]
    faults["links"] = {link: (rng.normal(1, e), rng.normal(0, e * 0.1, 3), rng.normal(1, e)) for link in arm.links}
    return faults


def friction(rng, motion, faults, t):
    """Friction of every joint at times [s], T x n: it rises over the presliding distance after every turn, falls
    off from the breakaway with speed, and at standstill stays as the last motion left it."""
    fine = np.arange(-LEAD_S, t[-1] + 1 / FINE_HZ, 1 / FINE_HZ)
    moved = np.diff(motion.at(fine)[0], axis=0)
    stretch = np.empty((len(fine), moved.shape[1]))
    limit = faults["presliding"]
    stretch[0] = limit * rng.uniform(-1, 1, len(limit))
    for k, step in enumerate(moved):
        stretch[k + 1] = np.minimum(np.maximum(stretch[k] + step, -limit), limit)
    level = np.stack([np.interp(t, fine, column) for column in (stretch / limit).T], axis=1)
    v = motion.at(t)[1]
    coulomb = faults["coulomb"] * (1 + np.sign(level) * faults["asymmetry"] / 2)
    breakaway = faults["breakaway"] * np.exp(-((v / faults["stribeck"]) ** 2))
    return level * coulomb * (1 + breakaway) + faults["viscous"] * v


def draw_pushes(rng, args):
    """Start [s] and force [N] of every push of a motion."""
    long = 2 * RISE_S + HOLD_S + GAP_S
    room = args.seconds - FIRST_PUSH_S - args.contact * long
    if args.contact and room < 0:
        sys.exit(f"{args.contact} pushes need motions of {FIRST_PUSH_S + args.contact * long:.1f} s (--seconds)")
    starts = FIRST_PUSH_S + np.sort(rng.uniform(0, max(room, 0), args.contact)) + long * np.arange(args.contact)
    ways = rng.normal(size=(args.contact, 3))
    return starts, ways * rng.uniform(5, 20, (args.contact, 1)) / np.linalg.norm(ways, axis=1, keepdims=True)


def external(arm, q, t, pushes):
    """Joint torques of the pushes, T x n, and when there is contact."""
    torques, contact = np.zeros_like(q), np.zeros(len(t), bool)
    for start, force in zip(*pushes):
        since = t - start
        size = smooth(since / RISE_S)[0] * smooth((2 * RISE_S + HOLD_S - since) / RISE_S)[0]
        contact |= size > 0
        for k in np.flatnonzero(size):
            torques[k] += arm.push(q[k], size[k] * force)
    return torques, contact


def write_draw(folder, number, args):
    seed = args.seed if args.motion_seed is None else args.motion_seed
    stream = lambda *purpose: np.random.default_rng([seed, number, *purpose])
    faults = draw_faults(np.random.default_rng([args.seed, number, 0]), Arm(args.robot), args)
    of_motions = draw_faults(stream(0), Arm(args.robot), args)
    faults |= {fault: of_motions[fault] for fault in ("offset", "drift", "noise")}
    link = Arm(args.robot).link
    arm = Arm(args.robot, faults["links"], (link, faults["mass_kg"], faults["centre_m"]))
    drawn = []
    for m in range(args.motions):
        motion, pushes = Motion(stream(1, m), arm, args.seconds), draw_pushes(stream(2, m), args)
        t = np.arange(round(args.seconds * args.rate_hz)) / args.rate_hz
        late, noise = t - faults["delay"], stream(3, m)
        moved, q = motion.at(late), motion.at(t)[0]
        motor = arm.motor(*moved) + friction(stream(4, m), motion, faults, late)
        motor -= external(arm, moved[0], late, pushes)[0]
        torques = (-1 if args.torque_sign == "plus" else 1) * faults["gain"] * motor
        torques += faults["bias"] + faults["offset"][m] + np.outer(t / args.seconds - 0.5, faults["drift"][m])
        torques += noise.normal(size=q.shape) * faults["noise"][m]
        truth, contact = external(arm, q, t, pushes)
        q = q + noise.normal(size=q.shape) * args.angle_noise_rad
        if args.angle_step_rad > 0:
            q = np.round(q / args.angle_step_rad) * args.angle_step_rad
        if args.republish_s > 0:
            stamps = np.arange(0, t[-1], args.republish_s)
            heard = np.searchsorted(t, stamps, side="right") - 1
            t, (q, torques, truth, contact) = stamps, (x[heard] for x in (q, torques, truth, contact))
        log = folder / "log" / f"seq_{m:03}"
        log.mkdir(parents=True)
        for name, values in dict(angles=q, torques=torques, time=t).items():
            np.save(log / f"{name}.npy", values)
        if args.contact:
            (folder / "truth").mkdir(exist_ok=True)
            np.save(folder / "truth" / f"seq_{m:03}_external.npy", truth)
            np.save(folder / "truth" / f"seq_{m:03}_contact.npy", contact)
        drawn.append(dict(zip(("start_s", "force_n"), map(np.ndarray.tolist, pushes))))
    options = {**vars(args), "out": args.out.name, "robot": Path(args.robot).name}
    (folder / "truth.json").write_text(json.dumps(truth_json(arm, faults, drawn) | {"options": options}, indent=1))


def truth_json(arm, faults, pushes):
    """What was injected; a payload of no mass has no centre."""
    value = lambda x: {"value": None if x is None else float(x)}
    joints = [
        {
            "name": name, "coulomb_n_m": value(faults["coulomb"][j]),
            "viscous_n_m_s_per_rad": value(faults["viscous"][j]),
            # The mean of the motions; each has an offset of its own, and a drift of mean zero.
            "bias_n_m": value(faults["bias"][j] + faults["offset"][:, j].mean()), "gain": value(faults["gain"][j]),
            "asymmetry": faults["asymmetry"][j], "stribeck_breakaway": faults["breakaway"][j],
            "stribeck_rad_per_s": faults["stribeck"][j], "presliding_rad": faults["presliding"][j],
            "offset_by_motion_n_m": faults["offset"][:, j].tolist(),
            "drift_by_motion_n_m": faults["drift"][:, j].tolist(),
        }
        for j, name in enumerate(arm.names)
    ]  # fmt: skip
    links = {k: dict(mass_factor=m, shift_m=list(c), inertia_factor=i) for k, (m, c, i) in faults["links"].items()}
    payload = {"link": arm.link, "mass_kg": value(faults["mass_kg"])}
    payload["com_m"] = [value(x if faults["mass_kg"] > 0 else None) for x in faults["centre_m"]]
    return {"payload": payload, "joints": joints, "delay_s": value(faults["delay"]), "link_errors": links,
            "noise_by_motion_n_m": faults["noise"].tolist(), "pushes_by_motion": pushes}  # fmt: skip


def parameters(found):
    """The quantities of a JSON of truth or of `palpate identify`: by name, values and standard deviations. A
    quantity that is absent or null is NaN. Keys are found by their beginning, so that the unit may be spelt freely."""
    entry = lambda table, name: next((table[key] for key in table if key.startswith(name)), None)
    number = lambda x: np.array([np.nan, np.nan] if x is None else [x["value"], x.get("std") or 0.0], float)
    payload = found.get("payload") or {}
    column = lambda name: np.array([number(entry(joint, name)) for joint in found["joints"]]).T
    joints = {name: column(name) for name in ("coulomb", "viscous", "bias", "gain")}
    mass, delay = (number(entry(*where))[:, None] for where in ((payload, "mass"), (found, "delay")))
    centre = np.array([number(x) for x in entry(payload, "com") or [None] * 3]).T
    return dict(link=payload.get("link"), mass=mass, centre=centre, delay=delay, **joints)


def identified(command, draw, robot):
    """What the command finds in a draw's log, or None. The only place that knows its flags."""
    sign = json.loads((draw / "truth.json").read_text())["options"]["torque_sign"]
    flags = ["--json", "--robot", robot, "--torque-sign", sign, "--gravity", "included"]
    run = subprocess.run([*shlex.split(command), str(draw / "log"), *map(str, flags)], capture_output=True, text=True)
    if run.returncode:
        print(f"{draw.name}: {run.stderr.strip()}", file=sys.stderr)
        return None
    return parameters(json.loads(run.stdout))


def in_last_link(arm, found):
    """Carries the centre of mass into the last link, if it was found in another that moves with it."""
    if found["link"] not in (None, arm.link):
        (p, r), (tip, axes) = (arm.pose(link, np.zeros(len(arm.names))) for link in (found["link"], arm.link))
        value, std = found["centre"]
        found["centre"] = np.array([axes.T @ (p + r @ value - tip), np.sqrt((axes.T @ r) ** 2 @ std**2)])
    return found


def score(args):
    # Name, unit, key, and how errors are printed from (value, truth, rate of the log).
    relative = lambda x, truth, rate: 100 * np.abs(x - truth) / np.where(truth > 0, truth, np.nan)
    absolute = lambda x, truth, rate: np.abs(x - truth)
    rows = [
        ("payload mass", "%", "mass", relative),
        ("payload centre", "cm", "centre", lambda x, truth, rate: [100 * np.linalg.norm(x - truth)]),
        ("Coulomb friction", "%", "coulomb", relative), ("viscous friction", "%", "viscous", relative),
        ("bias", "N·m", "bias", absolute), ("gain", "1", "gain", absolute),
        ("delay", "samples", "delay", lambda x, truth, rate: rate * np.abs(x - truth)),
    ]  # fmt: skip
    table, arm, draws = {row[2]: ([], [], []) for row in rows}, Arm(args.robot), sorted(args.out.glob("draw_*"))
    done = 0
    for draw in draws:
        truth = json.loads((draw / "truth.json").read_text())
        rate, truth, found = truth["options"]["rate_hz"], parameters(truth), identified(args.command, draw, args.robot)
        if found is None:
            continue
        done, found = done + 1, in_last_link(arm, found)
        for _, _, key, error in rows:
            true, (value, std) = truth[key][0], found[key]
            by_urdf = np.ones_like(true) if key == "gain" else np.zeros_like(true)
            inside = np.where(np.isnan(value - true), np.nan, np.abs(value - true) <= 1.96 * std)
            for cell, more in zip(table[key], (error(value, true, rate), inside, error(by_urdf, true, rate))):
                cell.extend(more)
    print(f"{done} of {len(draws)} draws\n{'':27}  median  95th percentile  covered by 95 %  by the URDF: median  95th")
    for name, unit, key, _ in rows:
        errors, inside, plain = (np.array(cell)[np.isfinite(cell)] for cell in table[key])
        if len(errors):
            (median, most), (was, was_most) = (np.percentile(x, [50, 95]) for x in (errors, plain))
            print(f"{name:16} {f'[{unit}]':>10}  {median:6.3f}  {most:15.3f}  {inside.mean():15.0%}  "
                  f"{was:19.3f} {was_most:6.3f}")  # fmt: skip


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    scoring = sys.argv[1:2] == ["score"]
    if scoring:
        parser.add_argument("score", choices=["score"])
        parser.add_argument("--command", default="palpate identify")
    parser.add_argument("out", type=Path)
    parser.add_argument("--robot", default=GEN3, help="URDF whose moving joints are one chain")
    if scoring:
        return score(parser.parse_args())
    number = lambda name, default, what: parser.add_argument(name, type=type(default), default=default, help=what)
    number("--seed", 0, "seed of all random numbers")
    parser.add_argument("--motion-seed", type=int, help="seed of motions, pushes, faults by motion (default: --seed)")
    number("--draws", 20, "number of fault sets")
    number("--motions", 3, "motions of a draw; another number gives other arms, too")
    number("--seconds", 20.0, "length of a motion")
    number("--rate-hz", 100.0, "samples per second")
    number("--republish-s", 0.0, "period of a node that repeats its last message with a new time stamp, s")
    parser.add_argument("--noise-n-m", type=float, nargs=2, default=[0.05, 0.1], metavar=("LOW", "HIGH"),
                        help="standard deviation of the torques, drawn by motion as in the data sets")  # fmt: skip
    number("--angle-noise-rad", 0.0, "noise of the positions; the data sets have none")
    number("--angle-step-rad", 0.0, "resolution of the encoders; the data sets have none")
    number("--link-error", 0.02, "relative error of masses and inertias; centres are off by this share of 0.1 m")
    number("--gain-std", 0.02, "standard deviation of the gains of the drives")
    number("--max-delay-ms", 30.0, "largest delay of the torques after the positions")
    number("--contact", 0, "pushes in every motion")
    parser.add_argument("--torque-sign", choices=["plus", "minus"], default="plus")
    parser.add_argument("--without", nargs="*", default=[], choices=[*FAULTS, "all"], help="faults to leave out")
    args = parser.parse_args()
    if args.seconds < STILL_S + 2 * RAMP_S + END_S or args.max_delay_ms * 1e-3 > LEAD_S:
        sys.exit(f"wanted motions of {STILL_S + 2 * RAMP_S + END_S} s or more, delays of {LEAD_S * 1e3:.0f} ms or less")
    if args.out.exists():
        sys.exit(f"{args.out} exists already")
    for number in range(args.draws):
        write_draw(args.out / f"draw_{number:03}", number, args)


if __name__ == "__main__":
    main()
