#!/usr/bin/env python3
"""Plays situations in which a robot must stop against `palpate live --guard`, and reports after how
long another process knew: by a flag that is up, or by 0.1 s of silence.

    scripts/guard_situations.py target/release/palpate data/plant_a [--only NAME,NAME] [--load]

One line of JSON for each situation, the flag's changes among them; exit code 1 if one fails open, if a
flag falls that nobody reset, or if the flag was never down before. Needs
numpy and cyclonedds (scripts/requirements.txt). DDS stays on this machine.
"""

import argparse
import json
import multiprocessing
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic

import dds_robot as dds

SILENCE_S = 0.1
NAN = float("nan")
PUSH = np.array([0, 300, 0, 0, 0, 0, 0], dtype=float)


class Watchdog(dds.Flag):
    def __init__(self, domain):
        super().__init__(domain, time.monotonic)

    def stops(self, until):
        """When it would hold the robot: intervals (from, to), up to a time."""
        holds, since, last = [], 0.0, None
        for at, up in [*self.history(), (until, True)]:
            silent = last is None or at - last > SILENCE_S
            if since is None and silent:
                since = last + SILENCE_S
            if since is not None and not up and at < until:
                holds.append((since, at))
                since = None
            if since is None and up and at < until:
                since = at
            last = at
        if since is not None:
            holds.append((since, until))
        return holds

    def is_down(self):
        now = time.monotonic()
        return not any(start <= now <= end for start, end in self.stops(now)) and bool(self.received)


class Robot:
    """Sends joint states at 100 Hz: those that a situation asks for."""

    def __init__(self, folder, domain):
        self.q, self.tau = (np.load(folder / "seq_000" / f"{n}.npy").astype(float) for n in ("angles", "torques"))
        self.participant = DomainParticipant(domain)
        topic = Topic(self.participant, "rt/joint_states", dds.JointState)
        self.writer = DataWriter(self.participant, topic, dds.RELIABLE)

    def send(self, q, tau, stamp_ns=None, names=None):
        ns = time.time_ns() if stamp_ns is None else stamp_ns
        header = dds.Header(dds.Time(ns // 10**9, ns % 10**9), "base")
        q, tau = [float(x) for x in q], [float(x) for x in tau]
        self.writer.write(dds.JointState(header, names or list(dds.JOINTS), q, [], tau))
        time.sleep(0.01)

    def hold(self, seconds, push=0, at=0, **how):
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            self.send(self.q[at], self.tau[at] + push, **how)

    def play(self, frames, push=0):
        for n in frames:
            self.send(self.q[n], self.tau[n] + push)


class Scene:
    """A session and its robot, which has moved freely, with the flag down."""

    def __init__(self, args, domain, folder, ready=True, more=()):
        self.folder, self.robot = folder, Robot(args.set, domain)
        self.watchdog = Watchdog(domain)
        self.ask = folder / "ask"
        self.log = folder / "log"
        command = [args.palpate, "live", "--localhost", "--domain", str(domain), "--json-lines", "--guard", "50"]
        command += ["--guard-bias", "50", "--services", "cyclone", "--ask", self.ask, "-o", folder / "field.npz"]
        self.palpate = subprocess.Popen(
            [*map(str, command), *more], stdout=self.log.open("wb"), stderr=subprocess.STDOUT
        )
        if not dds.wait_until(self.robot.writer.get_matched_subscriptions):
            sys.exit(f"nobody listens: {self.log.read_text()}")
        if ready:
            deadline = time.monotonic() + 10
            while not self.watchdog.is_down() and time.monotonic() < deadline:
                self.robot.hold(0.2)
            self.robot.play(range(100))

    def network_process(self):
        children = Path(f"/proc/{self.palpate.pid}/task").glob("*/children")
        return int(next(pid for task in children for pid in task.read_text().split()))

    def question(self, line):
        with socket.socket(socket.AF_UNIX) as stream:
            stream.connect(str(self.ask))
            stream.sendall(line.encode() + b"\n")
            return stream.recv(1000).decode()

    def end(self):
        for signum in (signal.SIGCONT, signal.SIGINT):
            if self.palpate.poll() is None:
                self.palpate.send_signal(signum)
        try:
            self.palpate.wait(10)
        except subprocess.TimeoutExpired:
            self.palpate.kill()
        self.watchdog.process.terminate()


now = time.monotonic


def load(scene):
    return scene.robot.tau[100] + PUSH


def pushed(scene, seconds=1.0, push=PUSH, **how):
    scene.robot.hold(seconds, push, at=100, **how)


def sent(scene, tau, q=None, off=lambda s: 0.0):
    """Sends torques, and positions if given, for a second; stamps are off by `off` (s after the begin), s."""
    started, robot = now(), scene.robot
    while (since := now() - started) < 1:
        robot.send(robot.q[100] if q is None else q, tau, stamp_ns=time.time_ns() + int(1e9 * off(since)))


def one_stamp_ahead_then_pushed(scene):
    scene.robot.send(scene.robot.q[100], scene.robot.tau[100], stamp_ns=time.time_ns() + 990_000_000)
    started = now()
    pushed(scene)
    return started, now()


def robot_leaves(scene):
    scene.robot.writer = None
    time.sleep(1)


def signalled(scene, pid, signum):
    os.kill(pid, signum)
    threading.Thread(target=scene.robot.hold, args=(1.0,), kwargs={"at": 100}, daemon=True).start()
    time.sleep(1)


def network_process_is_killed(scene):
    started = now()
    signalled(scene, scene.network_process(), signal.SIGKILL)
    return started, started + 0.5  # another one is there soon


def somebody_leans_on_the_still_arm_after_a_pause(scene):
    scene.robot.hold(1.0)
    started = now()
    for n in range(100):
        scene.robot.send(scene.robot.q[0], scene.robot.tau[0] + PUSH * n / 100)
    return started + 1 / 6 + 0.15, now()  # 50 N·m are passed after a sixth of it


def a_tare_over_the_socket_while_pushed(scene):
    pushed(scene, 0.3)
    scene.question('{"tare": true}')
    scene.robot.play(range(100, 250), PUSH)
    scene.robot.hold(1.2, PUSH, at=250)


def the_load_goes_away_by_itself(scene):
    pushed(scene, 0.3)
    scene.robot.hold(1.2, at=100)


def a_gap_after_which_it_presses_elsewhere(scene):
    time.sleep(1.3)
    q = scene.robot.q[100] + np.r_[0.3, np.zeros(6)]
    for _ in range(120):
        scene.robot.send(q, scene.robot.tau[100] + PUSH / 3)


def another_robot_on_the_same_topic_while_pushed(scene):
    other, started = Robot(scene.args.set, scene.domain), now()
    for n in range(80):
        scene.robot.send(scene.robot.q[100], load(scene))
        other.send(other.q[n] + 1, other.tau[n])
    return started, now()


def joint_states_faster_than_it_can_map(scene):
    robot_sleep, time.sleep = time.sleep, lambda _: None
    sent(scene, load(scene))
    time.sleep = robot_sleep


UNREADY = {
    "loaded_and_moving_before_any_tare": lambda s: s.robot.play(range(60, 260), PUSH),
    "loaded_and_still_before_any_tare": lambda s: s.robot.hold(2.0, PUSH),
}
# Each plays for its time, and returns from when until when the flag must be up, if that is not all of it.
SITUATIONS = {
    "limit_passed": pushed,
    "all_efforts_nan": lambda s: sent(s, NAN * np.ones(7)),
    "all_efforts_infinite": lambda s: sent(s, float("inf") * np.ones(7)),
    "one_effort_nan_the_others_pushed": lambda s: sent(s, np.r_[NAN, s.robot.tau[100][1:] + 300]),
    "one_position_nan_and_pushed": lambda s: sent(s, load(s), np.r_[NAN, s.robot.q[100][1:]]),
    "all_positions_nan": lambda s: sent(s, s.robot.tau[100], NAN * np.ones(7)),
    "stamp_repeats_and_pushed": lambda s: pushed(s, stamp_ns=time.time_ns()),
    "stamp_repeats": lambda s: pushed(s, push=0, stamp_ns=time.time_ns()),
    "one_stamp_ahead_then_pushed": one_stamp_ahead_then_pushed,
    "clock_half_a_second_back_and_pushed": lambda s: sent(s, load(s), off=lambda _: -0.5),
    "clock_an_hour_back_and_pushed": lambda s: sent(s, load(s), off=lambda _: -3600),
    "clock_a_day_ahead_and_pushed": lambda s: sent(s, load(s), off=lambda _: 86400),
    "stamps_run_backwards_and_pushed": lambda s: sent(s, load(s), off=lambda since: -1.1 * since),
    "joints_of_another_arm": lambda s: pushed(s, names=[f"panda_joint{n}" for n in range(1, 8)]),
    "no_efforts": lambda s: sent(s, []),
    "robot_falls_silent": lambda _: time.sleep(1),
    "robot_leaves": robot_leaves,
    "palpate_is_killed": lambda s: signalled(s, s.palpate.pid, signal.SIGKILL),
    "palpate_gets_sigterm": lambda s: signalled(s, s.palpate.pid, signal.SIGTERM),
    "palpate_gets_ctrl_c": lambda s: signalled(s, s.palpate.pid, signal.SIGINT),
    "palpate_is_halted": lambda s: signalled(s, s.palpate.pid, signal.SIGSTOP),
    "network_process_is_killed": network_process_is_killed,
    "network_process_is_halted": lambda s: signalled(s, s.network_process(), signal.SIGSTOP),
    **UNREADY,
    **{own.__name__: own for own in (
        somebody_leans_on_the_still_arm_after_a_pause, a_tare_over_the_socket_while_pushed,
        the_load_goes_away_by_itself, a_gap_after_which_it_presses_elsewhere,
        another_robot_on_the_same_topic_while_pushed, joint_states_faster_than_it_can_map,
    )},
}  # fmt: skip


def run(name, args, domain):
    """Plays a situation; again, at most twice, if the flag was up before it began, which shows nothing."""
    for again in range(3):
        result = play(name, args, domain + 40 * again)
        if not result["invalid"]:
            break
    return result


def play(name, args, domain):
    with tempfile.TemporaryDirectory() as folder:
        scene = Scene(args, domain, Path(folder), ready=name not in UNREADY)
        scene.args, scene.domain = args, domain
        was_down = scene.watchdog.is_down()
        started = now()
        should, until = SITUATIONS[name](scene) or (started, now())
        time.sleep(0.2)
        holds = scene.watchdog.stops(until)
        flags = scene.watchdog.history()
        changes = [(at, up) for (_, was), (at, up) in zip([(0, None), *flags], flags) if up != was]
        hold = next(((a, b) for a, b in holds if b > should), None)
        fails_open = hold is None or hold[1] < until
        invalid = not (was_down or name in UNREADY)
        # What has raised the flag stays up until somebody resets it.
        ready = next((n for n, (_, up) in enumerate(changes) if not up), len(changes))
        falls = any(not up for _, up in changes[ready + 1 :])
        after_ms = None if hold is None else max(0.0, hold[0] - should) * 1e3
        notes = [json.loads(line).get("note") for line in scene.log.read_text().splitlines() if line[:1] == "{"]
        scene.end()
    return {
        "situation": name, "invalid": invalid, "falls": falls, "stops_after_ms": after_ms and round(after_ms, 1),
        "fails_open": fails_open, "flags": [(round((at - should) * 1e3), up) for at, up in changes],
        "notes": [note for note in notes if note and ("STOP" in note or "process" in note)],
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("palpate", type=Path)
    parser.add_argument("set", type=Path)
    parser.add_argument("--only", default="", help="names of situations, with commas")
    parser.add_argument("--domain", type=int, default=91)
    parser.add_argument("--load", action="store_true", help="keep all cores busy meanwhile")
    args = parser.parse_args()
    only = set(filter(None, args.only.split(",")))
    busy = [multiprocessing.Process(target=spin, daemon=True) for _ in range(os.cpu_count() if args.load else 0)]
    for process in busy:
        process.start()
    results = []
    for number, name in enumerate(SITUATIONS):
        if not only or name in only:
            results.append(run(name, args, args.domain + number))
            print(json.dumps(results[-1]), flush=True)
    after = [result["stops_after_ms"] for result in results if result["stops_after_ms"] is not None]
    names = {what: [result["situation"] for result in results if result[what]]
             for what in ("fails_open", "falls", "invalid")}  # fmt: skip
    print(json.dumps({"situations": len(results), **names,
                      "stops_after_ms": {"median": float(np.median(after)), "worst": max(after)}}))
    sys.exit(any(names.values()))


def spin():
    while True:
        pass


if __name__ == "__main__":
    main()
