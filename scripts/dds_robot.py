"""A robot on a ROS 2 network, played from a set of touches by CycloneDDS, and what it receives.

    dds_robot.py SET --rate HZ --seconds S ...

Publishes joint states (sensor_msgs/msg/JointState on /joint_states), one touch after the other, over
and over; the arm stands still before each. Meanwhile it reads every topic that palpate publishes.
Prints one JSON object: what was sent and received, and the time from writing a sample to reading its
prediction. Loopback only. Libraries: requirements.txt, pinned.
"""

import argparse
import json
import multiprocessing
import os
import threading
import time
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault(
    "CYCLONEDDS_URI",
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo' multicast='false'/>"
    "</Interfaces><AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto"
    "</ParticipantIndex><MaxAutoParticipantIndex>20</MaxAutoParticipantIndex><Peers>"
    "<Peer address='127.0.0.1'/></Peers></Discovery></Domain></CycloneDDS>",
)

import numpy as np
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float64, int32, int64, sequence, uint8, uint32, uint64
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

JOINTS = [f"Actuator{joint}" for joint in range(1, 8)]


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
class JointState(IdlStruct, typename="sensor_msgs::msg::dds_::JointState_"):
    header: Header
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64]
    effort: sequence[float64]


@dataclass
class PointField(IdlStruct, typename="sensor_msgs::msg::dds_::PointField_"):
    name: str
    offset: uint32
    datatype: uint8
    count: uint32


@dataclass
class PointCloud2(IdlStruct, typename="sensor_msgs::msg::dds_::PointCloud2_"):
    header: Header
    height: uint32
    width: uint32
    fields: sequence[PointField]
    is_bigendian: bool
    point_step: uint32
    row_step: uint32
    data: sequence[uint8]
    is_dense: bool


@dataclass
class String(IdlStruct, typename="std_msgs::msg::dds_::String_"):
    data: str


@dataclass
class Bool(IdlStruct, typename="std_msgs::msg::dds_::Bool_"):
    data: bool


@dataclass
class KeyValue(IdlStruct, typename="diagnostic_msgs::msg::dds_::KeyValue_"):
    key: str
    value: str


@dataclass
class DiagnosticStatus(IdlStruct, typename="diagnostic_msgs::msg::dds_::DiagnosticStatus_"):
    level: uint8
    name: str
    message: str
    hardware_id: str
    values: sequence[KeyValue]


@dataclass
class DiagnosticArray(IdlStruct, typename="diagnostic_msgs::msg::dds_::DiagnosticArray_"):
    header: Header
    status: sequence[DiagnosticStatus]


@dataclass
class TriggerRequest(IdlStruct, typename="std_srvs::srv::dds_::Trigger_Request_"):
    """As rmw_cyclonedds writes it: who asks and which question it is come first."""

    client: uint64
    number: int64
    nothing: uint8


@dataclass
class TriggerResponse(IdlStruct, typename="std_srvs::srv::dds_::Trigger_Response_"):
    client: uint64
    number: int64
    success: bool
    message: str


RELIABLE = Qos(
    Policy.Reliability.Reliable(duration(milliseconds=100)),
    Policy.History.KeepLast(2000),
)
BEST_EFFORT = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(2000))
KEPT = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.Durability.TransientLocal, Policy.History.KeepLast(1))
# Whatever is waited for must come within this, s.
DEADLINE_S = 60
RECEIVED = {
    "rt/palpate/torque_predicted": JointState,
    "rt/palpate/torque_external": JointState,
    "rt/palpate/contacts": PointCloud2,
    "rt/palpate/field": PointCloud2,
    "rt/palpate/stop": Bool,
    "rt/palpate/guard": DiagnosticArray,
    "rt/diagnostics": DiagnosticArray,
}
# Beside an arm that was identified, which maps nothing.
IDENTIFIED = {
    "rt/palpate/torque_external": JointState,
    "rt/palpate/torque_std": JointState,
    "rt/palpate/touched": Bool,
}


def frames(folder, still):
    """Positions and torques of all touches in a row; between them the arm stands still."""
    q, tau = [], []
    for touch in sorted(folder.glob("seq_*")):
        angles, torques = np.load(touch / "angles.npy"), np.load(touch / "torques.npy")
        q += [np.repeat(angles[:1], still, axis=0), angles]
        tau += [np.repeat(torques[:1], still, axis=0), torques]
    return np.concatenate(q).astype(float).tolist(), np.concatenate(tau).astype(float).tolist()


def now_ns():
    return time.time_ns()


def wait_until(condition, deadline_s=DEADLINE_S):
    """Waits for a condition; whether it came true in time."""
    deadline = time.monotonic() + deadline_s
    while not (holds := condition()) and time.monotonic() < deadline:
        time.sleep(0.005)
    return holds


class Receiver(threading.Thread):
    """Reads all that palpate publishes."""

    def __init__(self, participant, limit, kinds=RECEIVED):
        super().__init__(daemon=True)
        self.kinds = kinds
        self.readers = {
            name: DataReader(participant, Topic(participant, name, kind), RELIABLE)
            for name, kind in kinds.items()
        }
        self.counts = dict.fromkeys(kinds, 0)
        self.latencies_ms, self.last = [], {}
        self.limit, self.passed_ns = limit, {"predicted": [], "external": []}
        self.going = True

    def run(self):
        while self.going:
            for name, reader in self.readers.items():
                for message in reader.take(N=500):
                    if not isinstance(message, self.kinds[name]):
                        continue  # a writer that left
                    self.receive(name, message)
            time.sleep(0.0005)

    def every_topic(self):
        """Whether there was a message on every topic."""
        return all(self.counts.values())

    def both_torques(self):
        """Whether as many predicted as external torques have come: a sample has one of each."""
        other = "rt/palpate/torque_std" if self.kinds is IDENTIFIED else "rt/palpate/torque_predicted"
        return self.counts[other] == self.counts["rt/palpate/torque_external"]

    def receive(self, name, message):
        self.counts[name] += 1
        self.last[name] = message
        if not name.startswith("rt/palpate/torque_"):
            return
        stamp = message.header.stamp
        sent_ns = stamp.sec * 1_000_000_000 + stamp.nanosec
        which = name.rsplit("_", 1)[1]
        if which == "predicted":
            self.latencies_ms.append((now_ns() - sent_ns) * 1e-6)
        if self.limit and max(map(abs, message.effort)) > self.limit:
            self.passed_ns[which].append(sent_ns)


def watch_flag(domain, flags):
    """What a safety node does: waits for the flag to stop, in a process of its own; `flags` gets
    (when, whether to stop), time in ns."""
    participant = DomainParticipant(domain)
    reader = DataReader(participant, Topic(participant, "rt/palpate/stop", Bool), RELIABLE)
    threading.Thread(target=end_with_parent, daemon=True).start()
    for message in reader.take_iter(timeout=duration(seconds=3600)):
        flags.send((now_ns(), message.data))


def end_with_parent():
    """A process that is killed takes nobody with it; this one goes when its parent has."""
    multiprocessing.parent_process().join()
    os._exit(0)


class Flag:
    """The flag to stop, as the process that watches it has received it."""

    def __init__(self, domain):
        spawn = multiprocessing.get_context("spawn")
        self.end, end_of_process = spawn.Pipe(duplex=False)
        self.received = []
        self.process = spawn.Process(target=watch_flag, args=(domain, end_of_process), daemon=True)
        self.process.start()

    def history(self):
        """All of (when, whether to stop) so far, time in ns."""
        while self.end.poll():
            self.received.append(self.end.recv())
        return self.received

    def is_raised(self):
        return bool(rises(self.history()))


def rises(flags):
    """When the flag went up after it had been down, ns: it is up before the first tare."""
    return [at_ns for (_, was_up), (at_ns, up) in zip(flags, flags[1:]) if up and not was_up]


def play_another_type(domain):
    """Publishes another type on the topic of the joint states, for ever."""
    participant = DomainParticipant(domain)
    writer = DataWriter(participant, Topic(participant, "rt/joint_states", Bool), RELIABLE)
    while True:
        writer.write(Bool(True))
        time.sleep(0.02)


class Tare(threading.Thread):
    """Calls the service /palpate/tare twice, as a client on rmw_cyclonedds does."""

    def __init__(self, participant):
        super().__init__(daemon=True)
        self.answers = []
        request = Topic(participant, "rq/palpate/tareRequest", TriggerRequest)
        response = Topic(participant, "rr/palpate/tareReply", TriggerResponse)
        self.writer = DataWriter(participant, request, RELIABLE)
        self.reader = DataReader(participant, response, RELIABLE)

    def has_server(self):
        readers, writers = self.writer.get_matched_subscriptions, self.reader.get_matched_publications
        return bool(readers() and writers())

    def run(self):
        wait_until(self.has_server)
        for number in (1, 2):
            self.answers.append(self.call(number))

    def call(self, number):
        """Calls until it is answered: the server may not know yet where its answers go."""
        for _ in range(round(DEADLINE_S)):
            self.writer.write(TriggerRequest(4711, number, 0))
            for answer in self.reader.take_iter(timeout=duration(seconds=1)):
                if answer.number == number:
                    return [answer.client, answer.number, answer.success, answer.message]
        raise TimeoutError(f"nobody answers call {number}")

    def is_answered(self):
        return len(self.answers) == 2


def spoil(state, before, number, broken):
    """Every fiftieth joint state as a broken robot would send it."""
    if broken and number % 50 == 7:
        if broken == "nan":
            state.effort = [float("nan")] * 7
        elif broken == "effort":
            state.effort = []
        elif broken == "names":
            state.name = [name.lower() for name in JOINTS]
        elif broken == "clock" and number == 107:
            state.header.stamp.sec -= 100
        elif broken == "still":
            state.header.stamp = before
    return state


def play(writer, q, tau, rate, seconds, broken, enough):
    """Sends frames at a steady rate, at least for some seconds and then until `enough()` or the
    deadline; returns how many."""
    start, sent, before = time.perf_counter(), 0, Time(0, 1)
    most = rate * (seconds + DEADLINE_S)
    while sent < rate * seconds or (sent < most and not enough()):
        due = start + sent / rate
        while (left := due - time.perf_counter()) > 0:
            if left > 0.0002:
                time.sleep(left / 2)
        stamp_ns, at = now_ns(), sent % len(q)
        header = Header(Time(stamp_ns // 1_000_000_000, stamp_ns % 1_000_000_000), "base_link")
        state = JointState(header, list(JOINTS), q[at], [], tau[at])
        writer.write(spoil(state, before, sent, broken))
        before = state.header.stamp
        sent += 1
    return sent


def stop_ms(receiver, flags):
    """From the samples that passed the limit first, by what was predicted and by what was measured, to
    the flag: it follows whichever is earlier, but a prediction waits for the mapper."""
    ups = rises(flags)
    passed = {which: min(ns) for which, ns in receiver.passed_ns.items() if ns}
    return {which: (ups[0] - ns) * 1e-6 for which, ns in passed.items()} if ups else None


def arguments():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("set", type=Path)
    parser.add_argument("--rate", type=float, default=1000.0)
    parser.add_argument("--seconds", type=float, default=10.0, help="how long to play; `inf`: until killed")
    parser.add_argument("--still", type=float, default=0.6, help="pause before each touch, s")
    parser.add_argument("--domain", type=int, default=0)
    parser.add_argument("--best-effort", action="store_true")
    parser.add_argument(
        "--until-received",
        action="store_true",
        help="play on until every topic of palpate was received, and with --guard the flag was raised",
    )
    parser.add_argument("--break", dest="broken", default="", help="what is wrong: see `spoil`")
    parser.add_argument("--guard", type=float, help="a limit, N·m, to time the flag against")
    parser.add_argument("--identified", action="store_true", help="the arm was identified: see IDENTIFIED")
    parser.add_argument("--another-type", action="store_true", help="publish only that, on the same topic")
    parser.add_argument("--description", type=Path, help="a URDF to keep on /robot_description")
    parser.add_argument("--tare", action="store_true", help="call the service, and play on until it answers")
    return parser.parse_args()


def main():
    args = arguments()
    if args.another_type:
        play_another_type(args.domain)
    flag = Flag(args.domain)
    participant = DomainParticipant(args.domain)
    if args.description:  # as robot_state_publisher does
        described = DataWriter(participant, Topic(participant, "rt/robot_description", String), KEPT)
        described.write(String(args.description.read_text()))
    receiver = Receiver(participant, args.guard, IDENTIFIED if args.identified else RECEIVED)
    receiver.start()
    tare = Tare(participant) if args.tare else None
    if tare:
        tare.start()

    def enough():
        received = receiver.every_topic() and (args.guard is None or flag.is_raised())
        return (received or not args.until_received) and (tare is None or tare.is_answered())

    qos = BEST_EFFORT if args.best_effort else RELIABLE
    writer = DataWriter(participant, Topic(participant, "rt/joint_states", JointState), qos)
    q, tau = frames(args.set, round(args.still * args.rate))
    wait_until(writer.get_matched_subscriptions)
    if args.guard:
        wait_until(flag.history)  # up, as long as nothing is known
    matched = len(writer.get_matched_subscriptions())
    started = time.perf_counter()
    sent = play(writer, q, tau, args.rate, args.seconds, args.broken, enough)
    took = time.perf_counter() - started
    writer.wait_for_acks(duration(seconds=DEADLINE_S))
    wait_until(receiver.both_torques, 5)  # never, if palpate had to leave some out
    receiver.going = False
    receiver.join()
    flags = flag.history()
    flag.process.terminate()
    latencies = receiver.latencies_ms
    quantile = lambda part: float(np.quantile(latencies, part)) if latencies else None  # noqa: E731
    diagnostics = receiver.last.get("rt/diagnostics")
    clouds = [name for name in ("rt/palpate/contacts", "rt/palpate/field") if name in receiver.last]
    print(json.dumps({
        "matched": matched, "sent": sent, "rate_hz": sent / took, "received": receiver.counts,
        "latency_ms": {"median": quantile(0.5), "p99": quantile(0.99)},
        "stops": [up for (_, was_up), (_, up) in zip([(0, None), *flags], flags) if up != was_up],
        "stop_ms": stop_ms(receiver, flags),
        "tare": tare and tare.answers,
        "diagnostics": {v.key: v.value for v in diagnostics.status[0].values} if diagnostics else None,
        "points": {name: receiver.last[name].width for name in clouds},
    }))


if __name__ == "__main__":
    main()
