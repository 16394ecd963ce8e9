"""A robot on a ROS 2 network, played from a set of touches by CycloneDDS, and what it receives.

    dds_robot.py SET --rate HZ --seconds S ...

Publishes joint states (sensor_msgs/msg/JointState on /joint_states), one touch after the other, over
and over; the arm stands still before each. Meanwhile it reads every topic that palpate publishes, and
with --call calls every service.
Prints one JSON object: what was sent and received, and the time from writing a sample to reading its
prediction. Loopback only. Libraries: requirements.txt, pinned.
"""

import argparse
import json
import multiprocessing
import os
import threading
import time
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
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from dds_messages import *  # noqa: F403

JOINTS = [f"Actuator{joint}" for joint in range(1, 8)]
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
    "rt/palpate/wrench": WrenchStamped,
    "rt/palpate/stop": Bool,
    "rt/palpate/guard": DiagnosticArray,
    "rt/diagnostics": DiagnosticArray,
}
# Beside an arm that was identified, which maps nothing.
IDENTIFIED = {
    "rt/palpate/torque_external": JointState,
    "rt/palpate/torque_std": JointState,
    "rt/palpate/touched": Bool,
    "rt/palpate/wrench": WrenchStamped,
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


def watch_flag(domain, flags, clock):
    """What a safety node does: waits for the flag to stop, in a process of its own; `flags` gets
    (when, whether to stop), time by `clock`."""
    participant = DomainParticipant(domain)
    reader = DataReader(participant, Topic(participant, "rt/palpate/stop", Bool), RELIABLE)
    threading.Thread(target=end_with_parent, daemon=True).start()
    for message in reader.take_iter(timeout=duration(seconds=3600)):
        if isinstance(message, Bool):  # else a writer that left
            flags.send((clock(), message.data))


def end_with_parent():
    """A process that is killed takes nobody with it; this one goes when its parent has."""
    multiprocessing.parent_process().join()
    os._exit(0)


class Flag:
    """The flag to stop, as the process that watches it has received it; times are by `clock`, by default in ns."""

    def __init__(self, domain, clock=now_ns):
        spawn = multiprocessing.get_context("spawn")
        self.end, end_of_process = spawn.Pipe(duplex=False)
        self.received = []
        self.process = spawn.Process(target=watch_flag, args=(domain, end_of_process, clock), daemon=True)
        self.process.start()

    def history(self):
        """All of (when, whether to stop) so far."""
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


class Client:
    """Calls a service as a client on rmw_cyclonedds does."""

    def __init__(self, participant, service, request, response):
        self.service, self.request, self.number = service, request, 0
        self.writer = DataWriter(participant, Topic(participant, f"rq{service}Request", request), RELIABLE)
        self.reader = DataReader(participant, Topic(participant, f"rr{service}Reply", response), RELIABLE)

    def has_server(self):
        readers, writers = self.writer.get_matched_subscriptions, self.reader.get_matched_publications
        return bool(readers() and writers())

    def call(self, *values):
        """Calls until it is answered: the server may not know yet where its answers go."""
        wait_until(self.has_server)
        self.number += 1
        for _ in range(round(DEADLINE_S)):
            self.writer.write(self.request(4711, self.number, *values))
            for answer in self.reader.take_iter(timeout=duration(seconds=1)):
                if (answer.client, answer.number) == (4711, self.number):
                    return answer
        raise TimeoutError(f"nobody answers call {self.number} of {self.service}")


class Caller(threading.Thread):
    """Calls services while the robot is played; `answers` has what came, `failed` why it ended."""

    def __init__(self, calls):
        super().__init__(daemon=True)
        self.calls, self.answers, self.failed = calls, None, None

    def run(self):
        try:
            self.answers = self.calls()
        except Exception as error:
            self.failed = f"{type(error).__name__}: {error}"

    def is_done(self):
        return not self.is_alive()


def tares(participant):
    """Two calls of the service /palpate/tare."""
    tare = Client(participant, "/palpate/tare", TriggerRequest, TriggerResponse)
    answers = [tare.call(0), tare.call(0)]
    return [[answer.client, answer.number, answer.success, answer.message] for answer in answers]


def every_service(participant, name, path):
    """What every service of a node answers; `path` are rows of positions, in the reverse order of the joints."""
    node, services = f"/{name}", {}
    for trigger in ("save", "reset", "tare"):
        answer = Client(participant, f"/palpate/{trigger}", TriggerRequest, TriggerResponse).call(0)
        services[trigger] = [answer.success, answer.message]
    points = [JointTrajectoryPoint(row[::-1], [], [], [], Time(number, 0)) for number, row in enumerate(path)]
    header = Header(Time(0, 0), "base_link")
    ask = Client(participant, "/palpate/ask", AskRequest, AskResponse)
    answer = ask.call(JointTrajectory(header, JOINTS[::-1], points), 0.0)
    services["ask"] = {
        "success": answer.success, "message": answer.message, "peak": answer.peak, "level": answer.level,
        "peak_with_band": answer.peak_with_band, "half_width": [list(point.effort) for point in answer.half_width.points],
        "joint_names": list(answer.predicted.joint_names), "contacts": list(answer.contacts),
        "positions": [list(point.positions) for point in answer.predicted.points],
        "torque": [list(point.effort) for point in answer.predicted.points],
        "times": [point.time_from_start.sec for point in answer.predicted.points],
    }
    few = [JointTrajectoryPoint(row[:6], [], [], [], Time(0, 0)) for row in path]
    refused = ask.call(JointTrajectory(header, JOINTS[:6], few), 0.0)
    services["refused"] = [refused.success, refused.message]
    refused = ask.call(JointTrajectory(header, JOINTS[:6], points), 0.0)
    services["uneven"] = [refused.success, refused.message]
    parameters = lambda service, *kinds: Client(participant, f"{node}/{service}", *kinds)  # noqa: E731
    listed = parameters("list_parameters", ListRequest, ListResponse).call([], 0)
    names = services["names"] = list(listed.result.names)
    got = parameters("get_parameters", NamesRequest, ValuesResponse).call([*names, "nonsense"])
    services["values"] = [[v.type, v.bool_value, v.double_value, v.string_value] for v in got.values]
    types = parameters("get_parameter_types", TypesRequest, TypesResponse).call([*names, "nonsense"])
    services["types"] = list(types.types)
    described = parameters("describe_parameters", DescribeRequest, DescribeResponse).call(names)
    services["described"] = [[d.name, d.type, d.description, d.read_only] for d in described.descriptors]
    same = [Parameter(name, value) for name, value in zip(names, got.values)]
    other = [Parameter("guard", ParameterValue(3, False, 0, 5.0, "", [], [], [], [], []))]
    results = parameters("set_parameters", SetRequest, SetResponse).call(same + other).results
    services["set"] = [[result.successful, result.reason] for result in results]
    set_all = parameters("set_parameters_atomically", SetAllRequest, SetAllResponse)
    services["set_all"] = [set_all.call(all_of_it).result.successful for all_of_it in (same, same + other)]
    return services


def nodes(participant):
    """The nodes that the tools of ROS would list, with how many readers and writers they have."""
    topic = Topic(participant, "ros_discovery_info", ParticipantEntitiesInfo)
    reader, found = DataReader(participant, topic, KEPT), {}

    def changes():
        before = dict(found)
        for message in reader.take(N=100):
            for node in getattr(message, "node_entities_info_seq", []):
                name = f"{node.node_namespace.rstrip('/')}/{node.node_name}"
                found[name] = [len(node.reader_gid_seq), len(node.writer_gid_seq)]
        return found != before

    wait_until(changes)
    while wait_until(changes, 0.5):
        pass
    return found


def spoil(state, before, number, broken):
    """Every fiftieth joint state as a broken robot would send it."""
    if broken and number % 50 == 7:
        if broken == "nan":
            state.effort = [float("nan")] * 7
        elif broken == "effort":
            state.effort = []
        elif broken == "names":
            state.name = [f"panda_joint{joint}" for joint in range(1, 8)]
        elif broken == "clock" and number == 107:
            state.header.stamp.sec -= 100
        elif broken == "still":
            state.header.stamp = before
    return state


def dynamic(state):
    """A joint state as ros2_control has it, beside something that is no joint."""
    names = ["position", "velocity", "effort"]
    values = [InterfaceValue(names, [q, 0.0, tau]) for q, tau in zip(state.position, state.effort)]
    sensor = InterfaceValue(["force.x"], [1.0])
    return DynamicJointState(state.header, ["wrist_sensor", *state.name], [sensor, *values])


class Simulation:
    """The clock of a simulation that goes at a fraction of real time; joint states have no stamp then."""

    START_S, FRACTION = 1000.0, 0.5

    def __init__(self, participant):
        self.writer = DataWriter(participant, Topic(participant, "rt/clock", Clock), RELIABLE)
        self.start = time.perf_counter()

    def tick(self):
        now_s = self.START_S + self.FRACTION * (time.perf_counter() - self.start)
        self.writer.write(Clock(Time(int(now_s), int(now_s % 1 * 1e9))))
        time.sleep(0.001)  # it comes before what is of this moment


def play(writer, q, tau, rate, seconds, broken, enough, simulation=None):
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
        if simulation:
            simulation.tick()
            header = Header(Time(0, 0), "base_link")
        state = JointState(header, list(JOINTS), q[at], [], tau[at])
        state = spoil(state, before, sent, broken)
        writer.write(dynamic(state) if writer.topic.data_type is DynamicJointState else state)
        before = state.header.stamp
        sent += 1
    return sent


def stop_ms(receiver, flags):
    """From the samples that passed the limit first, by what was predicted and by what was measured, to
    the flag: it follows whichever is earlier, but a prediction waits for the mapper."""
    ups = rises(flags)
    passed = {which: min(ns) for which, ns in receiver.passed_ns.items() if ns}
    return {which: (ups[0] - ns) * 1e-6 for which, ns in passed.items()} if ups else None


def last_stamp(receiver):
    """Stamp of the last prediction."""
    last = receiver.last.get("rt/palpate/torque_predicted")
    return last and last.header.stamp


def wrench_of(receiver):
    """Link, force and torque of the last wrench."""
    last = receiver.last.get("rt/palpate/wrench")
    vector = lambda v: [v.x, v.y, v.z]  # noqa: E731
    return last and [last.header.frame_id, vector(last.wrench.force), vector(last.wrench.torque)]


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
    parser.add_argument("--break", dest="broken", default="", help="fault of the messages: see `spoil`")
    parser.add_argument("--guard", type=float, help="limit of the guard, N·m, to measure the time until the flag")
    parser.add_argument("--identified", action="store_true", help="palpate runs with an identified arm: see IDENTIFIED")
    parser.add_argument("--another-type", action="store_true", help="publish only another type, on the same topic")
    parser.add_argument("--description", type=Path, help="a URDF to keep on /robot_description")
    parser.add_argument("--tare", action="store_true", help="call the service, and play on until it answers")
    parser.add_argument("--call", metavar="NODE", help="call every service of this node, and play on until all answer")
    parser.add_argument("--dynamic", action="store_true", help="publish DynamicJointState on /dynamic_joint_states")
    parser.add_argument("--simulation", action="store_true", help="publish /clock, stamp nothing; play until a prediction comes")
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
    q, tau = frames(args.set, round(args.still * args.rate))
    caller = None
    if args.tare or args.call:
        path = q[:: len(q) // 20][:12]
        calls = (lambda: tares(participant)) if args.tare else (lambda: every_service(participant, args.call, path))
        caller = Caller(calls)
        caller.start()

    def enough():
        received = receiver.every_topic() and (args.guard is None or flag.is_raised())
        stamped = not args.simulation or last_stamp(receiver) is not None
        answered = caller is None or caller.is_done()
        return (received or not args.until_received) and answered and stamped

    qos = BEST_EFFORT if args.best_effort else RELIABLE
    topic = Topic(participant, "rt/joint_states", JointState)
    if args.dynamic:
        topic = Topic(participant, "rt/dynamic_joint_states", DynamicJointState)
    writer = DataWriter(participant, topic, qos)
    simulation = Simulation(participant) if args.simulation else None
    wait_until(writer.get_matched_subscriptions)
    if args.guard:
        wait_until(flag.history)  # up, as long as nothing is known
    matched = len(writer.get_matched_subscriptions())
    started = time.perf_counter()
    sent = play(writer, q, tau, args.rate, args.seconds, args.broken, enough, simulation)
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
        "tare": caller.answers if args.tare else None,
        "called": caller.answers if args.call else None,
        "failed": caller and caller.failed,
        "nodes": nodes(participant) if args.call else None,
        "stamp": stamp.sec + stamp.nanosec * 1e-9 if (stamp := last_stamp(receiver)) else None,
        "wrench": wrench_of(receiver),
        "diagnostics": {v.key: v.value for v in diagnostics.status[0].values} if diagnostics else None,
        "points": {name: receiver.last[name].width for name in clouds},
    }))


if __name__ == "__main__":
    main()
