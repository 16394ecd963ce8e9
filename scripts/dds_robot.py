"""A robot on a ROS 2 network, played from a set of touches by CycloneDDS, and what it hears back.

    dds_robot.py SET --rate HZ --seconds S [--loops] ...

Publishes joint states (sensor_msgs/msg/JointState on /joint_states), one touch after the other, over
and over, with the arm standing still at the start of each for as long as its log has it. Meanwhile it
reads every topic that palpate publishes. Prints one JSON object: what was sent and heard, and the time
from writing a sample to reading its prediction. Loopback only. Libraries: requirements.txt, pinned.
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
HEARD = {
    "rt/palpate/torque_predicted": JointState,
    "rt/palpate/torque_external": JointState,
    "rt/palpate/contacts": PointCloud2,
    "rt/palpate/field": PointCloud2,
    "rt/palpate/stop": Bool,
    "rt/diagnostics": DiagnosticArray,
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


class Ears(threading.Thread):
    """Reads all that palpate says."""

    def __init__(self, participant, limit):
        super().__init__(daemon=True)
        self.readers = {
            name: DataReader(participant, Topic(participant, name, kind), RELIABLE)
            for name, kind in HEARD.items()
        }
        self.counts = dict.fromkeys(HEARD, 0)
        self.latencies_ms, self.last = [], {}
        self.limit, self.passed_ns = limit, {"predicted": [], "external": []}
        self.going = True

    def run(self):
        while self.going:
            for name, reader in self.readers.items():
                for message in reader.take(N=500):
                    if not isinstance(message, HEARD[name]):
                        continue  # a writer that left
                    self.hear(name, message)
            time.sleep(0.0005)

    def hear(self, name, message):
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


def watch_flag(domain, seen):
    """What a safety node does: waits for the flag to stop, in a process of its own; `seen` gets
    (when, whether to stop), time in ns."""
    participant = DomainParticipant(domain)
    reader = DataReader(participant, Topic(participant, "rt/palpate/stop", Bool), RELIABLE)
    threading.Thread(target=end_with_parent, daemon=True).start()
    for message in reader.take_iter(timeout=duration(seconds=3600)):
        seen.put((now_ns(), message.data))


def end_with_parent():
    """A process that is killed takes nobody with it; this one goes when its parent has."""
    multiprocessing.parent_process().join()
    os._exit(0)


def all_of(queue):
    items = []
    while not queue.empty():
        items.append(queue.get())
    return items


class Stranger(threading.Thread):
    """Another participant, which publishes another type on the topic of the joint states."""

    def __init__(self, domain):
        super().__init__(daemon=True)
        self.participant = DomainParticipant(domain)
        topic = Topic(self.participant, "rt/joint_states", Bool)
        self.writer = DataWriter(self.participant, topic, RELIABLE)

    def run(self):
        while True:
            self.writer.write(Bool(True))
            time.sleep(0.02)


class Tare(threading.Thread):
    """Calls the service /palpate/tare as a client on rmw_cyclonedds does, after so many seconds."""

    def __init__(self, participant, after):
        super().__init__(daemon=True)
        self.after, self.answers = after, []
        request = Topic(participant, "rq/palpate/tareRequest", TriggerRequest)
        response = Topic(participant, "rr/palpate/tareReply", TriggerResponse)
        self.writer = DataWriter(participant, request, RELIABLE)
        self.reader = DataReader(participant, response, RELIABLE)

    def run(self):
        time.sleep(self.after)
        for number in (1, 2):
            self.writer.write(TriggerRequest(4711, number, 0))
            for answer in self.reader.take_iter(timeout=duration(seconds=5)):
                answered = [answer.client, answer.number, answer.success, answer.message]
                self.answers.append(answered)
                break


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


def play(writer, q, tau, rate, seconds, broken):
    """Sends frames at a steady rate; returns how many."""
    start, sent, before = time.perf_counter(), 0, Time(0, 1)
    while sent < rate * seconds:
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


def stop_ms(ears, stops):
    """From the samples that passed the limit first, by what was predicted and by what was measured, to
    the flag: it follows whichever is earlier, but a prediction waits for the mapper."""
    ups = [at_ns for at_ns, up in stops if up]
    passed = {which: min(ns) for which, ns in ears.passed_ns.items() if ns}
    return {which: (ups[0] - ns) * 1e-6 for which, ns in passed.items()} if ups else None


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("set", type=Path)
    parser.add_argument("--rate", type=float, default=1000.0)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--still", type=float, default=0.6, help="pause before each touch, s")
    parser.add_argument("--domain", type=int, default=0)
    parser.add_argument("--best-effort", action="store_true")
    parser.add_argument("--deaf", action="store_true", help="reads nothing back, which takes less time")
    parser.add_argument("--break", dest="broken", default="", help="what is wrong: see `spoil`")
    parser.add_argument("--guard", type=float, help="a limit, N·m, to time the flag against")
    parser.add_argument("--stranger", action="store_true", help="another type on the same topic")
    parser.add_argument("--tare", type=float, help="call the service after so many seconds")
    args = parser.parse_args()

    spawn = multiprocessing.get_context("spawn")
    seen = spawn.Queue()
    watcher = spawn.Process(target=watch_flag, args=(args.domain, seen), daemon=True)
    watcher.start()
    participant = DomainParticipant(args.domain)
    ears = Ears(participant, args.guard)
    if not args.deaf:
        ears.start()
    if args.stranger:
        Stranger(args.domain).start()
        time.sleep(3)  # alone for a while
    tare = None
    if args.tare is not None:
        tare = Tare(participant, args.tare)
        tare.start()
    qos = BEST_EFFORT if args.best_effort else RELIABLE
    writer = DataWriter(participant, Topic(participant, "rt/joint_states", JointState), qos)
    q, tau = frames(args.set, round(args.still * args.rate))
    deadline = time.time() + 20
    while not writer.get_matched_subscriptions() and time.time() < deadline:
        time.sleep(0.05)
    matched = len(writer.get_matched_subscriptions())
    time.sleep(0.3)
    started = time.perf_counter()
    sent = play(writer, q, tau, args.rate, args.seconds, args.broken)
    took = time.perf_counter() - started
    time.sleep(1.5)
    ears.going = False
    if not args.deaf:
        ears.join()
    stops = all_of(seen)
    watcher.terminate()
    latencies = np.array(ears.latencies_ms or [np.nan])
    diagnostics = ears.last.get("rt/diagnostics")
    print(json.dumps({
        "matched": matched, "sent": sent, "rate_hz": sent / took, "heard": ears.counts,
        "latency_ms": {"median": float(np.median(latencies)), "p99": float(np.quantile(latencies, 0.99))},
        "stops": [up for _, up in stops],
        "stop_ms": stop_ms(ears, stops),
        "tare": tare and tare.answers,
        "diagnostics": {v.key: v.value for v in diagnostics.status[0].values} if diagnostics else None,
        "points": {n: ears.last[n].width for n in ("rt/palpate/contacts", "rt/palpate/field") if n in ears.last},
    }))


if __name__ == "__main__":
    main()
