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


def watch(domain, pipe):
    """What a watchdog sees, in a process of its own: (time, whether to stop) of every flag."""
    participant = DomainParticipant(domain)
    reader = dds.DataReader(participant, Topic(participant, "rt/palpate/stop", dds.Bool), dds.RELIABLE)
    threading.Thread(target=dds.end_with_parent, daemon=True).start()
    while True:
        for message in reader.take_iter(timeout=dds.duration(milliseconds=5)):
            if isinstance(message, dds.Bool):
                pipe.send((time.monotonic(), message.data))


class Watchdog:
    def __init__(self, domain):
        spawn = multiprocessing.get_context("spawn")
        self.end, theirs = spawn.Pipe(duplex=False)
        self.process = spawn.Process(target=watch, args=(domain, theirs), daemon=True)
        self.process.start()
        self.flags = []

    def seen(self):
        while self.end.poll():
            self.flags.append(self.end.recv())
        return self.flags

    def stops(self, until):
        """When it would hold the robot: intervals (from, to), up to a time."""
        holds, since, last = [], 0.0, None
        for at, up in [*self.seen(), (until, True)]:
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
        return not any(start <= now <= end for start, end in self.stops(now)) and bool(self.flags)


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


def now():
    return time.monotonic()


# Each returns since when the robot must be stopped, and until when.


def pushed(scene, seconds=1.0, **how):
    started = now()
    scene.robot.hold(seconds, PUSH, at=100, **how)
    return started, now()


def limit_passed(scene):
    return pushed(scene)


def all_efforts_nan(scene):
    return pushed_with(scene, NAN * np.ones(7))


def all_efforts_infinite(scene):
    return pushed_with(scene, float("inf") * np.ones(7))


def one_effort_nan_the_others_pushed(scene):
    return pushed_with(scene, np.r_[NAN, scene.robot.tau[100][1:] + 300])


def pushed_with(scene, tau, q=None):
    started, robot = now(), scene.robot
    while now() < started + 1:
        robot.send(robot.q[100] if q is None else q, tau)
    return started, now()


def one_position_nan_and_pushed(scene):
    return pushed_with(scene, scene.robot.tau[100] + PUSH, np.r_[NAN, scene.robot.q[100][1:]])


def all_positions_nan(scene):
    return pushed_with(scene, scene.robot.tau[100], NAN * np.ones(7))


def stamp_repeats_and_pushed(scene):
    return pushed(scene, stamp_ns=time.time_ns())


def stamp_repeats(scene):
    started = now()
    scene.robot.hold(1.0, at=100, stamp_ns=time.time_ns())
    return started, now()


def one_stamp_ahead_then_pushed(scene):
    scene.robot.send(scene.robot.q[100], scene.robot.tau[100], stamp_ns=time.time_ns() + 990_000_000)
    return pushed(scene)


def clock_set(scene, off_s):
    started, robot = now(), scene.robot
    while now() < started + 1:
        robot.send(robot.q[100], robot.tau[100] + PUSH, stamp_ns=time.time_ns() + int(off_s * 1e9))
    return started, now()


def clock_half_a_second_back_and_pushed(scene):
    return clock_set(scene, -0.5)


def clock_an_hour_back_and_pushed(scene):
    return clock_set(scene, -3600)


def clock_a_day_ahead_and_pushed(scene):
    return clock_set(scene, 86400)


def stamps_run_backwards_and_pushed(scene):
    started, robot, ns = now(), scene.robot, time.time_ns()
    while now() < started + 1:
        robot.send(robot.q[100], robot.tau[100] + PUSH, stamp_ns=ns - int((now() - started) * 1e8))
    return started, now()


def joints_of_another_arm(scene):
    return pushed(scene, names=[f"panda_joint{n}" for n in range(1, 8)])


def no_efforts(scene):
    return pushed_with(scene, [])


def robot_falls_silent(scene):
    started = now()
    time.sleep(1)
    return started, now()


def robot_leaves(scene):
    started, scene.robot.writer = now(), None
    time.sleep(1)
    return started, now()


def signalled(scene, pid, signum):
    started = now()
    os.kill(pid, signum)
    threading.Thread(target=scene.robot.hold, args=(1.0,), kwargs={"at": 100}, daemon=True).start()
    time.sleep(1)
    return started, now()


def palpate_is_killed(scene):
    return signalled(scene, scene.palpate.pid, signal.SIGKILL)


def palpate_gets_sigterm(scene):
    return signalled(scene, scene.palpate.pid, signal.SIGTERM)


def palpate_gets_ctrl_c(scene):
    return signalled(scene, scene.palpate.pid, signal.SIGINT)


def palpate_is_halted(scene):
    return signalled(scene, scene.palpate.pid, signal.SIGSTOP)


def network_process_is_killed(scene):
    started, end = signalled(scene, scene.network_process(), signal.SIGKILL)
    return started, started + 0.5  # another one is there soon


def network_process_is_halted(scene):
    return signalled(scene, scene.network_process(), signal.SIGSTOP)


def loaded_and_moving_before_any_tare(scene):
    started = now()
    scene.robot.play(range(60, 260), PUSH)
    return started, now()


def loaded_and_still_before_any_tare(scene):
    started = now()
    scene.robot.hold(2.0, PUSH)
    return started, now()


def somebody_leans_on_the_still_arm_after_a_pause(scene):
    scene.robot.hold(1.0)
    started = now()
    for n in range(100):
        scene.robot.send(scene.robot.q[0], scene.robot.tau[0] + PUSH * n / 100)
    return started + 1 / 6 + 0.15, now()  # 50 N·m are passed after a sixth of it


def a_tare_over_the_socket_while_pushed(scene):
    started, _ = pushed(scene, 0.3)
    scene.question('{"tare": true}')
    scene.robot.play(range(100, 250), PUSH)
    scene.robot.hold(1.2, PUSH, at=250)
    return started, now()


def the_load_goes_away_by_itself(scene):
    started, _ = pushed(scene, 0.3)
    scene.robot.hold(1.2, at=100)
    return started, now()


def a_gap_after_which_it_presses_elsewhere(scene):
    started = now()
    time.sleep(1.3)
    q = scene.robot.q[100] + np.r_[0.3, np.zeros(6)]
    for _ in range(120):
        scene.robot.send(q, scene.robot.tau[100] + PUSH / 3)
    return started, now()


def another_robot_on_the_same_topic_while_pushed(scene):
    other, started = Robot(scene.args.set, scene.domain), now()
    for n in range(80):
        scene.robot.send(scene.robot.q[100], scene.robot.tau[100] + PUSH)
        other.send(other.q[n] + 1, other.tau[n])
    return started, now()


def joint_states_faster_than_it_can_map(scene):
    robot, started = scene.robot, now()
    robot_sleep, time.sleep = time.sleep, lambda _: None
    while now() < started + 1:
        robot.send(robot.q[100], robot.tau[100] + PUSH)
    time.sleep = robot_sleep
    return started, now()


UNREADY = [loaded_and_moving_before_any_tare, loaded_and_still_before_any_tare]
SITUATIONS = [
    limit_passed, all_efforts_nan, all_efforts_infinite, one_effort_nan_the_others_pushed,
    one_position_nan_and_pushed, all_positions_nan, stamp_repeats_and_pushed, stamp_repeats,
    one_stamp_ahead_then_pushed, clock_half_a_second_back_and_pushed, clock_an_hour_back_and_pushed,
    clock_a_day_ahead_and_pushed, stamps_run_backwards_and_pushed, joints_of_another_arm, no_efforts,
    robot_falls_silent, robot_leaves, palpate_is_killed, palpate_gets_sigterm, palpate_gets_ctrl_c,
    palpate_is_halted, network_process_is_killed, network_process_is_halted, *UNREADY,
    somebody_leans_on_the_still_arm_after_a_pause, a_tare_over_the_socket_while_pushed,
    the_load_goes_away_by_itself, a_gap_after_which_it_presses_elsewhere,
    another_robot_on_the_same_topic_while_pushed, joint_states_faster_than_it_can_map,
]  # fmt: skip


def run(situation, args, domain):
    """Plays a situation; again, at most twice, if the flag was up before it began, which shows nothing."""
    for again in range(3):
        result = play(situation, args, domain + 40 * again)
        if not result["invalid"]:
            break
    return result


def play(situation, args, domain):
    with tempfile.TemporaryDirectory() as folder:
        scene = Scene(args, domain, Path(folder), ready=situation not in UNREADY)
        scene.args, scene.domain = args, domain
        was_down = scene.watchdog.is_down()
        should, until = situation(scene)
        time.sleep(0.2)
        holds = scene.watchdog.stops(until)
        flags = scene.watchdog.seen()
        changes = [(at, up) for (_, was), (at, up) in zip([(0, None), *flags], flags) if up != was]
        hold = next(((a, b) for a, b in holds if b > should), None)
        fails_open = hold is None or hold[1] < until
        invalid = not (was_down or situation in UNREADY)
        # What has raised the flag stays up until somebody resets it.
        ready = next((n for n, (_, up) in enumerate(changes) if not up), len(changes))
        falls = any(not up for _, up in changes[ready + 1 :])
        after_ms = None if hold is None else max(0.0, hold[0] - should) * 1e3
        notes = [json.loads(line).get("note") for line in scene.log.read_text().splitlines() if line[:1] == "{"]
        scene.end()
    return {
        "situation": situation.__name__, "invalid": invalid, "falls": falls, "stops_after_ms": after_ms and round(after_ms, 1),
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
    for number, situation in enumerate(SITUATIONS):
        if not only or situation.__name__ in only:
            results.append(run(situation, args, args.domain + number))
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
