#!/usr/bin/env python3
"""The textbook momentum observer for external joint torques, to compare palpate's estimates with.

    scripts/momentum_observer.py LOG -o OUT [--bandwidth-hz 2] [--payload LINK,KG,X,Y,Z] [--friction identified.json]
    scripts/momentum_observer.py compare FREE CONTACT --other NAME [--identified NAME.json]

The observer of first order (De Luca and Mattone 2003; Haddadin, De Luca and Albu-Schaeffer 2017), with p = M(q) v:

    r = K (p - integral of (motor torque - friction + C^T v - g + r) dt),    K = 2 pi bandwidth

so r is the external torque (environment on robot, N·m) behind a low-pass. M, C and g come from MuJoCo, velocities
from causal differences behind another low-pass. The first form writes OUT/seq_000_external.npy for every motion of
a log; --friction takes friction, bias, gain and delay from the JSON of `palpate identify` or of a truth.json.

The second form compares it with another estimator on draws of simulated_arm_logs.py: FREE without contact, CONTACT
with --contact. In both, each draw holds the other's estimates in NAME/seq_000.csv, or in seq_000_external.npy and
seq_000_std.npy, and optionally a JSON for the observer. It reports the noise on FREE at equal delay, where a delay
is the lag of the highest cross-correlation with the true external torque, and how soon and how many contacts are
detected at equal false alarms on FREE. Needs numpy and mujoco (both on PyPI).
"""

import argparse
import json
import sys
from pathlib import Path

import mujoco
import numpy as np

from simulated_arm_logs import GEN3, Arm, parameters

VELOCITY_CUTOFF_HZ = 10.0
FRICTION_SPEED = 0.02  # rad/s; Coulomb friction is tanh(v / this), as the sign of a noisy velocity flutters
DIFFERENCE_S = 1e-5  # step of the derivative of M along the motion
MOST_LAG_S = 1.0
ALARM_S = 0.5  # crossings of the threshold within this time are one alarm
SWEEP_HZ = [0.5, 1.0, 2.0, 4.0, 8.0]


class Momentum:
    """Momentum p and the part of its rate known without the external torque, at every sample, T x n."""

    def __init__(self, arm, log, motion, known, args):
        q, torques, t = (np.load(log / motion / f"{name}.npy").astype(float) for name in ("angles", "torques", "time"))
        value = lambda name, default: np.nan_to_num(known[name][0], nan=default) if known else default
        if known:  # the positions wait for the torques
            q = np.stack([np.interp(t - value("delay", 0.0), t, column) for column in q.T], axis=1)
        self.t, v = t, velocities(q, t, args.velocity_cutoff_hz)
        tau = (torques - value("bias", 0.0)) / value("gain", 1.0) * (-1 if args.torque_sign == "plus" else 1)
        tau = tau - value("coulomb", 0.0) * np.tanh(v / FRICTION_SPEED) - value("viscous", 0.0) * v
        self.p, self.rate = np.empty_like(q), np.empty_like(q)
        for k in range(len(t)):
            mass, _ = mass_and_bias(arm, q[k] - DIFFERENCE_S * v[k], v[k])
            ahead, _ = mass_and_bias(arm, q[k] + DIFFERENCE_S * v[k], v[k])
            mass_rate = (ahead - mass) / (2 * DIFFERENCE_S)
            mass, bias = mass_and_bias(arm, q[k], v[k])
            self.p[k] = mass @ v[k]
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
    payload = None
    if args.payload:
        link, *numbers = args.payload.split(",")
        payload = (link, float(numbers[0]), np.array(numbers[1:], float))
    known = parameters(json.loads(args.friction.read_text())) if args.friction else None
    arm = Arm(args.robot, payload=payload)
    args.output.mkdir(parents=True, exist_ok=True)
    for motion in motions(args.log):
        external = Momentum(arm, args.log, motion, known, args).observe(args.bandwidth_hz)
        np.save(args.output / f"{motion}_external.npy", external)


def other_estimate(folder, motion):
    """The other estimator's external torques and their standard deviations, T x n each. The only place that knows
    its files: a CSV with a header, a column of time, n of torques and n of deviations, or two arrays."""
    if (folder / f"{motion}.csv").exists():
        columns = np.genfromtxt(folder / f"{motion}.csv", delimiter=",", skip_header=1)[:, 1:]
        return np.split(columns, 2, axis=1)
    return [np.load(folder / f"{motion}_{name}.npy") for name in ("external", "std")]


class Recording:
    """One motion of a draw: what the observer and the other estimator make of it, and the truth if there is contact."""

    def __init__(self, arm, draw, motion, known, args):
        self.observer = Momentum(arm, draw / "log", motion, known, args)
        self.t = self.observer.t
        self.other, self.std = other_estimate(draw / args.other, motion)
        truth = draw / "truth" / f"{motion}_external.npy"
        self.external = np.load(truth) if truth.exists() else None
        if truth.exists():
            contact = np.diff(np.load(draw / "truth" / f"{motion}_contact.npy").astype(int), prepend=0, append=0)
            self.contacts = list(zip(np.flatnonzero(contact == 1), np.flatnonzero(contact == -1)))


def recordings(root, args):
    for draw in sorted(root.glob("draw_*")):
        known, payload = None, None
        if args.identified:
            known = parameters(json.loads((draw / args.identified).read_text()))
            if np.isfinite(known["mass"][0, 0]):
                payload = (known["link"], known["mass"][0, 0], np.nan_to_num(known["centre"][0]))
        arm = Arm(args.robot, payload=payload)
        for motion in motions(draw / "log"):
            yield Recording(arm, draw, motion, known, args)


def lag_s(estimates, contact):
    """The lag behind the true external torques at which the estimates correlate best with them."""
    period = np.median(np.diff(contact[0].t))
    lags = np.arange(round(MOST_LAG_S / period) + 1)
    fit = [sum((e[lag:] * c.external[: len(c.t) - lag]).sum() for e, c in zip(estimates, contact)) for lag in lags]
    best = int(np.argmax(fit))
    if 0 < best < lags[-1]:  # the top of a parabola through three samples
        before, at, after = fit[best - 1 : best + 2]
        best = best + 0.5 * (before - after) / (before - 2 * at + after)
    return best * period


def at_lag(lag, contact):
    """The bandwidth [Hz] at which the observer has this lag, or the nearest that it can have."""
    low, high = 0.05, 50.0
    for _ in range(25):
        middle = np.sqrt(low * high)
        if lag_s([c.observer.observe(middle) for c in contact], contact) > lag:
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
    """By contact, after how long the level passes the limit, s; NaN if it does not before the contact ends."""
    delays = []
    for level, recording in zip(levels, contact):
        for start, end in recording.contacts:
            over = np.flatnonzero(level[start:end] > limit)
            delays.append(recording.t[start + over[0]] - recording.t[start] if len(over) else np.nan)
    return np.array(delays)


def compare(args):
    free, contact = (list(recordings(root, args)) for root in (args.free, args.contact))
    minutes = sum(r.t[-1] - r.t[0] for r in free) / 60
    false_alarms = round(args.false_alarms_per_minute * minutes)
    other = [[r.other for r in part] for part in (free, contact)]
    lag = lag_s(other[1], contact)
    matched = at_lag(lag, contact)
    rows = [("other, by its own std", *other, [[r.std for r in part] for part in (free, contact)])]
    rows.append(("other, by its noise", *other, None))
    for name, bandwidth in [("observer at its lag", matched), *(("observer", hz) for hz in SWEEP_HZ)]:
        estimates = [[r.observer.observe(bandwidth) for r in part] for part in (free, contact)]
        rows.append((f"{name}, {bandwidth:.2f} Hz", *estimates, None))
    print(f"{len(free)} motions without contact, {minutes:.1f} min; {len(contact)} with, "
          f"{sum(len(r.contacts) for r in contact)} contacts; {false_alarms} false alarms for each")  # fmt: skip
    found = {}
    for name, on_free, on_contact, std in rows:
        # Of each joint, over all motions. Without a deviation of its own, an estimate is scaled by it.
        noise = np.sqrt(np.mean(np.concatenate(on_free) ** 2, axis=0))
        scales = std or [[noise] * len(part) for part in (free, contact)]
        levels = [[np.abs(e / s).max(axis=1) for e, s in zip(*pair)] for pair in zip((on_free, on_contact), scales)]
        limit = threshold(levels[0], free, false_alarms)
        found[name] = lag_s(on_contact, contact), noise, detections(levels[1], limit, contact), limit
    reference = found[rows[0][0]][2]
    print(f"{'':28} lag [ms]  noise [N·m]  threshold  missed  detected after [ms]  where both detect: this, other [ms]")
    for name, (its_lag, noise, delays, limit) in found.items():
        both = np.isfinite(delays) & np.isfinite(reference)
        mean = lambda x: 1e3 * np.mean(x) if len(x) else np.nan
        after, here, there = mean(delays[np.isfinite(delays)]), mean(delays[both]), mean(reference[both])
        noise, missed = np.sqrt(np.mean(noise**2)), np.isnan(delays).sum()
        print(f"{name:28} {1e3 * its_lag:8.1f}  {noise:11.3f}  {limit:9.2f}  {missed:6}  {after:19.0f}  "
              f"{here:28.0f} {there:5.0f}")  # fmt: skip


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    comparing = sys.argv[1:2] == ["compare"]
    if comparing:
        parser.add_argument("compare", choices=["compare"])
        parser.add_argument("free", type=Path)
        parser.add_argument("contact", type=Path)
        parser.add_argument("--other", required=True, help="folder of the other's estimates in each draw")
        parser.add_argument("--identified", help="JSON in each draw, for the observer; truth.json knows everything")
        parser.add_argument("--false-alarms-per-minute", type=float, default=1.0)
    else:
        parser.add_argument("log", type=Path)
        parser.add_argument("-o", "--output", type=Path, required=True)
        parser.add_argument("--bandwidth-hz", type=float, default=2.0)
        parser.add_argument("--payload", metavar="LINK,KG,X,Y,Z")
        parser.add_argument("--friction", type=Path, help="JSON of friction, bias, gain and delay")
    parser.add_argument("--robot", default=GEN3, help="URDF whose moving joints are one chain")
    parser.add_argument("--torque-sign", choices=["plus", "minus"], default="plus")
    parser.add_argument("--velocity-cutoff-hz", type=float, default=VELOCITY_CUTOFF_HZ)
    parser.add_argument("--tare-s", type=float, default=0.0, help="still start whose mean counts as zero")
    args = parser.parse_args()
    compare(args) if comparing else estimate(args)


if __name__ == "__main__":
    main()
