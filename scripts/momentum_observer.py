#!/usr/bin/env python3
"""The textbook momentum observer for external joint torques, and a comparison of `palpate torque` with it.

    scripts/momentum_observer.py LOG -o OUT [--bandwidth-hz 2] [--robot arm.urdf] [--arm arm.toml]
    scripts/momentum_observer.py compare IDENTIFY FREE CONTACT --command target/release/palpate

The observer of first order (De Luca and Mattone 2003; Haddadin, De Luca and Albu-Schaeffer 2017), with p = M(q) v:

    r = K (p - integral of (motor torque - friction + C^T v - g + r) dt),    K = 2 pi bandwidth

so r is the external torque (environment on robot, N·m) behind a low-pass. M, C and g come from MuJoCo, velocities
from causal differences behind another low-pass. The first form writes OUT/seq_000_external.npy for every motion of
a log; the arm is identified by `palpate identify LOG -o arm.toml --urdf arm.urdf`.

The second form takes three folders of simulated_arm_logs.py with the same arms (--seed, --motions) in other motions
(--motion-seed), the third with --contact. It identifies each arm on IDENTIFY, and runs `palpate torque` and the
observer on FREE and CONTACT. The observer has all of the identified model (masses, friction with its hysteresis,
bias, gains, delay), or only the URDF. The tables show

- noise on FREE, and lag: where the cross-correlation with the true external torque is highest. The observer's
  bandwidth is the one at which it lags as much as the palpate row above it, 50 Hz at most.
- contacts that are missed, and the median time to detect one (a missed one counts as never), at equal false alarms
  on FREE. Torques are divided by palpate's standard deviation, or by their own noise in the arm's motions on FREE.
- whether palpate's standard deviations and its threshold for 1 false alarm an hour hold on FREE.

Needs numpy and mujoco (both on PyPI), and Python 3.11.
"""

import argparse
import csv
import json
import shlex
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

import mujoco
import numpy as np

from simulated_arm_logs import GEN3, Arm

VELOCITY_CUTOFF_HZ = 10.0
MIN_PRESLIDING = 1e-9  # rad
DIFFERENCE_S = 1e-5  # step of the derivative of M along the motion
MAX_LAG_S = 1.0
ALARM_S = 0.5  # crossings of the threshold within this time are one alarm
CAUSAL = {"palpate": ["--causal"]} | {f"palpate, {hz} Hz": ["--causal", "--bandwidth-hz", str(hz)] for hz in (8, 4, 2)}
VARIANTS = CAUSAL | {"palpate, not causal": []}


class Momentum:
    """Momentum p and the part of its rate known without the external torque, at every sample, T x n."""

    def __init__(self, arm, log, motion, known, args):
        q, torques, t = (np.load(log / motion / f"{name}.npy").astype(float) for name in ("angles", "torques", "time"))
        if known:  # the positions wait for the torques
            q = np.stack([np.interp(t - known["delay_s"], t, column) for column in q.T], axis=1)
        self.t, v = t, velocities(q, t, args.velocity_cutoff_hz)
        torques, rotor = torques * (1 if args.torque_sign == "plus" else -1), np.zeros(q.shape[1])
        if known:
            joints, rotor = known["joint"], np.array([joint["rotor_inertia"] for joint in known["joint"]])
            bias, gain = (np.array([joint[key] for joint in joints]) for key in ("bias", "gain"))
            torques = (torques - bias[:, 0] - bias[:, 1] * np.cos(q) - bias[:, 2] * np.sin(q)) / gain
        tau = -torques - (friction(joints, q, v) if known else 0)
        self.p, self.rate = np.empty_like(q), np.empty_like(q)
        for k in range(len(t)):
            mass, _ = mass_and_bias(arm, q[k] - DIFFERENCE_S * v[k], v[k])
            ahead, _ = mass_and_bias(arm, q[k] + DIFFERENCE_S * v[k], v[k])
            mass_rate = (ahead - mass) / (2 * DIFFERENCE_S)
            mass, bias = mass_and_bias(arm, q[k], v[k])
            self.p[k] = mass @ v[k] + rotor * v[k]
            # With bias = C v + g and M' = C + C^T, this is tau + C^T v - g.
            self.rate[k] = tau[k] + mass_rate @ v[k] - bias
        still = t - t[0] < args.tare_s
        if still.any():
            self.rate -= self.rate[still].mean(axis=0)

    def observe(self, bandwidth_hz):
        """External torques, T x n. Integrals are trapezoids, so that every bandwidth is stable."""
        gain, step = 2 * np.pi * bandwidth_hz, np.diff(self.t)[:, None]
        known = np.cumsum((self.rate[1:] + self.rate[:-1]) * step / 2, axis=0)
        error = self.p - self.p[0] - np.concatenate([np.zeros((1, self.p.shape[1])), known])
        r, integral = np.zeros_like(self.p), np.zeros(self.p.shape[1])
        for k, h in enumerate(step[:, 0], start=1):
            integral = integral + h / 2 * r[k - 1]
            r[k] = gain * (error[k] - integral) / (1 + gain * h / 2)
            integral = integral + h / 2 * r[k]
        return r


def friction(joints, q, v):
    """The friction of an identified arm, T x n. Its state z follows the joint over the presliding distance, from
    both ends of what it can be at the start, as in palpate."""
    value = lambda key: np.array([joint["friction"][key] for joint in joints])
    ends, states = np.array([[-1.0], [1.0]]) * np.ones(len(joints)), np.zeros_like(q)
    for k, step in enumerate(np.diff(q, axis=0) / np.maximum(value("presliding"), MIN_PRESLIDING), start=1):
        ends = np.clip(ends + step, -1, 1)
        states[k] = ends.mean(axis=0)
    coulomb = value("coulomb") + value("breakaway") * np.exp(-np.abs(v) / value("stribeck"))
    return states * coulomb + value("asymmetry") * np.abs(states) + value("viscous") * v


def velocities(q, t, cutoff_hz):
    v, steps = np.zeros_like(q), np.diff(t)
    for k, h in enumerate(steps, start=1):
        v[k] = v[k - 1] + (1 - np.exp(-2 * np.pi * cutoff_hz * h)) * ((q[k] - q[k - 1]) / h - v[k - 1])
    return v


def mass_and_bias(arm, q, v):
    model, data, mass = arm.model, arm.data, np.empty((len(q), len(q)))
    data.qpos[:], data.qvel[:] = q, v
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_fwdVelocity(model, data)
    mujoco.mj_fullM(model, data, mass)
    return mass, data.qfrc_bias.copy()


def motions(log):
    return sorted(path.name for path in log.glob("seq_*"))


def estimate(args):
    known, arm = tomllib.loads(args.arm.read_text()) if args.arm else None, Arm(args.robot)
    args.output.mkdir(parents=True, exist_ok=True)
    for motion in motions(args.log):
        external = Momentum(arm, args.log, motion, known, args).observe(args.bandwidth_hz)
        np.save(args.output / f"{motion}_external.npy", external)


def palpate(args, *words):
    """What a command of palpate prints as JSON, with the flags that all commands have in common."""
    flags = ["--json", "--robot", args.robot, "--torque-sign", args.torque_sign, "--gravity", "included"]
    command = [*shlex.split(args.command), *map(str, words), *map(str, flags)]
    run = subprocess.run(command, capture_output=True, text=True)
    if run.returncode:
        sys.exit(f"{shlex.join(command)}: {run.stderr.strip()}")
    return json.loads(run.stdout)


def torques_of(args, log, arm, variant, table):
    """Of `palpate torque`: by motion, external torques and their standard deviations, T x n each; and the number of
    contacts at its usual threshold."""
    report = palpate(args, "torque", log, "--arm", arm, "-o", table, *VARIANTS[variant])
    header, *rows = csv.reader(table.read_text().splitlines())
    pick = lambda end: [k for k, name in enumerate(header) if name.endswith(end)]
    found, names = {}, np.array([row[0] for row in rows])
    for motion in motions(log):
        numbers = np.array([row for row, name in zip(rows, names) if name == motion])
        found[motion] = [numbers[:, pick(end)].astype(float) for end in ("_torque", "_std")]
    return found, len(report["contacts"])


class Recording:
    """One motion of a draw: the observers and palpate's estimates, and the truth if there is contact."""

    def __init__(self, draw, motion, observers, estimates):
        self.arm, self.observers, self.estimates = draw.name, observers, estimates
        self.t = next(iter(observers.values())).t
        truth = draw / "truth" / f"{motion}_external.npy"
        self.external = np.load(truth) if truth.exists() else None
        if truth.exists():
            contact = np.diff(np.load(draw / "truth" / f"{motion}_contact.npy").astype(int), prepend=0, append=0)
            self.contacts = list(zip(np.flatnonzero(contact == 1), np.flatnonzero(contact == -1)))


def recordings(args):
    """Those of FREE, those of CONTACT, and by variant the contacts that palpate found in FREE."""
    parts, alarms = ([], []), dict.fromkeys(VARIANTS, 0)
    for name in sorted(path.name for path in args.identify.glob("draw_*")):
        with tempfile.TemporaryDirectory() as scratch:
            toml, urdf, table = (Path(scratch) / file for file in ("arm.toml", "arm.urdf", "torques.csv"))
            palpate(args, "identify", args.identify / name / "log", "-o", toml, "--urdf", urdf)
            models = {"identified": (Arm(urdf), tomllib.loads(toml.read_text())), "URDF": (Arm(args.robot), None)}
            for root, part in zip((args.free, args.contact), parts):
                draw, found = root / name, {}
                for variant in VARIANTS:
                    found[variant], contacts = torques_of(args, draw / "log", toml, variant, table)
                    alarms[variant] += contacts * (root == args.free)
                for motion in motions(draw / "log"):
                    observer = lambda arm, known: Momentum(arm, draw / "log", motion, known, args)
                    observers = {of: observer(*model) for of, model in models.items()}
                    part.append(Recording(draw, motion, observers, {of: found[of][motion] for of in VARIANTS}))
    return *parts, alarms


def lag_s(estimates, contact):
    """The lag behind the true external torques at which the estimates correlate best with them."""
    period = np.median(np.diff(contact[0].t))
    lags = np.arange(round(MAX_LAG_S / period) + 1)
    fit = [sum((e[lag:] * c.external[: len(c.t) - lag]).sum() for e, c in zip(estimates, contact)) for lag in lags]
    best = int(np.argmax(fit))
    if 0 < best < lags[-1]:  # the top of a parabola through three samples
        before, at, after = fit[best - 1 : best + 2]
        best = best + 0.5 * (before - after) / (before - 2 * at + after)
    return best * period


def at_lag(lag, contact):
    """The bandwidth [Hz] at which the observer has this lag, or the nearest to that."""
    low, high = 0.05, 50.0
    for _ in range(15):
        middle = np.sqrt(low * high)
        if lag_s([c.observers["identified"].observe(middle) for c in contact], contact) > lag:
            low = middle
        else:
            high = middle
    return high


def threshold(levels, free, false_alarms):
    """The level that is passed in this many alarms, no more: the next one's peak."""
    peaks = []
    for level, recording in zip(levels, free):
        left = level.copy()
        while left.max() > 0:
            top = int(np.argmax(left))
            peaks.append(left[top])
            left[np.abs(recording.t - recording.t[top]) < ALARM_S] = 0
    return np.sort(peaks)[::-1][false_alarms]


def detections(levels, limit, contact):
    """By contact, after how long the level passes the limit, s; infinite if it does not before the contact ends."""
    delays = []
    for level, recording in zip(levels, contact):
        for start, end in recording.contacts:
            over = np.flatnonzero(level[start:end] > limit)
            delays.append(recording.t[start + over[0]] - recording.t[start] if len(over) else np.inf)
    return np.array(delays)


def noise_scales(on_free, free, contact):
    """Root mean squares on the arm's motions in FREE, by joint, for every recording of FREE and of CONTACT."""
    arms = {r.arm for r in free}
    of_arm = {arm: np.concatenate([e for e, r in zip(on_free, free) if r.arm == arm]) for arm in arms}
    return [[np.sqrt(np.mean(of_arm[r.arm] ** 2, axis=0)) for r in part] for part in (free, contact)]


def print_row(name, estimates, stds, free, contact, false_alarms):
    scales = stds or noise_scales(estimates[0], free, contact)
    levels = [[np.abs(e / s).max(axis=1) for e, s in zip(*pair)] for pair in zip(estimates, scales)]
    limit = threshold(levels[0], free, false_alarms)
    delays = detections(levels[1], limit, contact)
    noise, lag = np.sqrt(np.mean(np.concatenate(estimates[0]) ** 2)), lag_s(estimates[1], contact)
    print(f"{name:32} {1e3 * lag:8.1f}  {noise:11.3f}  {'std' if stds else 'noise':>7}  {limit:9.2f}  "
          f"{np.isinf(delays).sum():6}  {1e3 * np.median(delays):19.0f}", flush=True)  # fmt: skip


def print_honesty(free, alarms, hours):
    n = free[0].estimates["palpate"][0].shape[1]
    print(f"\n{'share of |torque| <= 2 std, by joint':36}{'all':>6}  {''.join(f'{j:6}' for j in range(1, n + 1))}"
          "  contacts found an hour, 1 expected")  # fmt: skip
    for variant in VARIANTS:
        inside = np.concatenate([np.abs(e) <= 2 * std for e, std in (r.estimates[variant] for r in free)])
        shares = "".join(f"{share:6.2f}" for share in inside.mean(axis=0))
        print(f"{variant:36}{inside.mean():6.2f}  {shares}  {alarms[variant] / hours:33.1f}")


def compare(args):
    free, contact, alarms = recordings(args)
    hours = sum(r.t[-1] - r.t[0] for r in free) / 3600
    false_alarms = round(args.false_alarms_per_minute * 60 * hours)
    print(f"{len(free)} motions without contact, {60 * hours:.1f} min; {len(contact)} with, "
          f"{sum(len(r.contacts) for r in contact)} contacts; {false_alarms} false alarms for each\n\n"
          f"{'':32} lag [ms]  noise [N·m]  divided  threshold  missed  detected after [ms]")  # fmt: skip
    for variant in VARIANTS:
        both = lambda which: [[r.estimates[variant][which] for r in part] for part in (free, contact)]
        print_row(variant, both(0), both(1), free, contact, false_alarms)
        print_row(variant, both(0), None, free, contact, false_alarms)
        if variant in CAUSAL:
            hz = at_lag(lag_s(both(0)[1], contact), contact)
            for model in contact[0].observers:
                observed = [[r.observers[model].observe(hz) for r in part] for part in (free, contact)]
                print_row(f"  observer, {hz:.1f} Hz, {model}", observed, None, free, contact, false_alarms)
    print_honesty(free, alarms, hours)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    comparing = sys.argv[1:2] == ["compare"]
    if comparing:
        parser.add_argument("compare", choices=["compare"])
        for root in ("identify", "free", "contact"):
            parser.add_argument(root, type=Path)
        parser.add_argument("--command", default="palpate")
        parser.add_argument("--false-alarms-per-minute", type=float, default=1.0)
    else:
        parser.add_argument("log", type=Path)
        parser.add_argument("-o", "--output", type=Path, required=True)
        parser.add_argument("--bandwidth-hz", type=float, default=2.0)
        parser.add_argument("--arm", type=Path, help="TOML of `palpate identify`: friction, bias, gains and delay")
    parser.add_argument("--robot", default=GEN3, help="URDF whose moving joints are one chain")
    parser.add_argument("--torque-sign", choices=["plus", "minus"], default="plus")
    parser.add_argument("--velocity-cutoff-hz", type=float, default=VELOCITY_CUTOFF_HZ)
    parser.add_argument("--tare-s", type=float, default=0.0, help="start at rest whose mean torque is the tare, s")
    args = parser.parse_args()
    compare(args) if comparing else estimate(args)


if __name__ == "__main__":
    main()
