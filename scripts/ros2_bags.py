"""Writes a set of touches as ROS 2 bags, and reads bags, with libraries that are not palpate's.

    ros2_bags.py write SET FOLDER       mcap_zstd/, mcap_plain/, sqlite/: the touches of SET
    ros2_bags.py states SET FOLDER      franka_new/, franka_old/, lbr/, kortex/: messages of makers, see STATES
    ros2_bags.py read BAG               what `rosbags` finds, a line of JSON a message
    ros2_bags.py read-mcap FILE         the same by `mcap` and `mcap_ros2`

SET is a folder of touches as npy. Joints are written in another order than the robot's, with a
finger among them, and between a marker of `std_msgs/msg/String` a touch; all of it is what a
reader must cope with. Libraries: requirements.txt, pinned.
"""

import json
import sys
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

JOINTS = [f"Actuator{joint}" for joint in range(1, 8)]
PAUSE_NS = 10_000_000_000  # between touches, so that the clock never goes back
EPOCH_NS = 1_700_000_000_000_000_000
FRANKA = "franka_msgs/msg/FrankaRobotState"
# Types of messages and their definitions, those of inner messages after lines of `===`; with fewer fields than the
# makers' messages.
STATES = {
    "franka_new": (
        FRANKA,
        "std_msgs/Header header\n"
        "string robot_mode\n"
        "sensor_msgs/JointState measured_joint_state\n"
        "sensor_msgs/JointState tau_ext_hat_filtered\n"
        "bool[3] flags\n",
    ),
    "franka_old": (
        FRANKA,
        "std_msgs/Header header\n"
        "float64[7] q\n"
        "uint8 collided\n"
        "float64[7] tau_J\n"
        "float64[7] tau_ext_hat_filtered\n",
    ),
    "lbr": (
        "lbr_fri_idl/msg/LBRState",
        "float64 sample_time\n"
        "int8 control_mode\n"
        "uint32 time_stamp_sec\n"
        "uint32 time_stamp_nano_sec\n"
        "float64[7] measured_joint_position\n"
        "float64[7] measured_torque\n"
        "float64[7] commanded_torque\n"
        "float64[7] external_torque\n"
        "float64 tracking_performance\n",
    ),
    "kortex": (
        "kortex_driver/msg/BaseCyclic_Feedback",
        "uint32 frame_id\n"
        "kortex_driver/ActuatorFeedback[] actuators\n"
        "kortex_driver/MotorFeedback[] motors\n",
    ),
}
INNER = {
    "kortex_driver/msg/ActuatorFeedback": "uint32 command_id\nfloat32 position\nfloat32 velocity\n"
    "float32 torque\nfloat32 current_motor\n",
    "kortex_driver/msg/MotorFeedback": "uint32 motor_id\nfloat32 position\n",
}


def touches(folder):
    """Name, times in ns that go on from touch to touch, angles and torques of each touch."""
    start_ns = EPOCH_NS
    for touch in sorted(folder.glob("seq_*")):
        time_ns = start_ns + np.rint(np.load(touch / "time.npy") * 1e9).astype(np.int64)
        yield touch.name, time_ns, np.load(touch / "angles.npy"), np.load(touch / "torques.npy")
        start_ns = int(time_ns[-1]) + PAUSE_NS


class Messages:
    """Messages of a type store, serialized."""

    def __init__(self, store):
        self.store, self.types = store, store.types

    def stamp(self, time_ns):
        sec, nanosec = divmod(int(time_ns), 1_000_000_000)
        stamp = self.types["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
        return self.types["std_msgs/msg/Header"](stamp=stamp, frame_id="base_link")

    def joint_state(self, time_ns, names, position, effort):
        return self.types["sensor_msgs/msg/JointState"](
            header=self.stamp(time_ns),
            name=list(names),
            position=np.asarray(position, np.float64),
            velocity=np.zeros(len(names)),
            effort=np.asarray(effort, np.float64),
        )


def write_touches(source, path, plugin, compression):
    """One bag of all touches: joint states, a marker a touch, and a topic of no interest."""
    store = get_typestore(Stores.ROS2_JAZZY)
    messages, text = Messages(store), store.types["std_msgs/msg/String"]
    order = [3, 0, 6, 1, 5, 2, 4]
    names = [JOINTS[joint] for joint in order]
    names.insert(2, "finger")
    with_finger = lambda row: np.insert(row[order], 2, 0.01)
    writer = Writer(path, version=9, storage_plugin=plugin)
    if compression:
        writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        topics = {"/joint_states": "sensor_msgs/msg/JointState"}
        topics |= {"/marker": "std_msgs/msg/String", "/rosout": "std_msgs/msg/String"}
        topic = {
            name: writer.add_connection(name, kind, typestore=store)
            for name, kind in topics.items()
        }
        put = lambda name, kind, time_ns, message: writer.write(
            topic[name], int(time_ns), store.serialize_cdr(message, kind)
        )
        for name, times_ns, angles, torques in touches(source):
            put("/marker", topics["/marker"], times_ns[0], text(data=name))
            for time_ns, q, tau in zip(times_ns, angles, torques):
                state = messages.joint_state(time_ns, names, with_finger(q), with_finger(tau))
                put("/joint_states", topics["/joint_states"], time_ns, state)
            put("/rosout", topics["/rosout"], times_ns[-1], text(data=f"{name} is over"))


def write_states(source, path):
    """The first touch as messages of one maker; external torques of KUKA have the other sign."""
    store = get_typestore(Stores.ROS2_JAZZY)
    kind, definition = STATES[path.name]
    for name, text in [*INNER.items(), (kind, definition)]:
        store.register(get_types_from_msg(text, name))
    messages, state = Messages(store), store.types[kind]
    of = {
        "franka_new": lambda time_ns, q, tau: state(
            header=messages.stamp(time_ns),
            robot_mode="moving",
            measured_joint_state=messages.joint_state(time_ns, JOINTS, q, 2 * tau),
            tau_ext_hat_filtered=messages.joint_state(time_ns, JOINTS, 0 * q, tau),
            flags=np.array([True, False, True]),
        ),
        "franka_old": lambda time_ns, q, tau: state(
            header=messages.stamp(time_ns),
            q=q,
            collided=1,
            tau_J=2 * tau,
            tau_ext_hat_filtered=tau,
        ),
        "lbr": lambda time_ns, q, tau: state(
            sample_time=0.005,
            control_mode=3,
            time_stamp_sec=int(time_ns) // 1_000_000_000,
            time_stamp_nano_sec=int(time_ns) % 1_000_000_000,
            measured_joint_position=q,
            measured_torque=tau,
            commanded_torque=0 * tau,
            external_torque=-tau,
            tracking_performance=1.0,
        ),
        "kortex": lambda _, q, tau: state(
            frame_id=1,
            actuators=[
                store.types["kortex_driver/msg/ActuatorFeedback"](
                    command_id=joint,
                    position=np.degrees(q[joint]) % 360,
                    velocity=0.0,
                    torque=tau[joint],
                    current_motor=2 * tau[joint],
                )
                for joint in range(7)
            ],
            motors=[store.types["kortex_driver/msg/MotorFeedback"](motor_id=1, position=99.0)],
        ),
    }[path.name]
    _, times_ns, angles, torques = next(touches(source))
    plugin = StoragePlugin.SQLITE3 if path.name == "lbr" else StoragePlugin.MCAP
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        topic = writer.add_connection("/robot_state", kind, typestore=store)
        for time_ns, q, tau in zip(times_ns, angles, torques):
            message = of(time_ns, q, tau)
            writer.write(topic, int(time_ns), store.serialize_cdr(message, kind))


def line_of(topic, time_ns, message):
    """A message as a line of JSON."""
    fields = {"topic": topic, "time_ns": int(time_ns)}
    if hasattr(message, "position"):
        stamp = message.header.stamp
        fields["stamp_ns"] = stamp.sec * 1_000_000_000 + stamp.nanosec
        fields["name"] = list(message.name)
        fields["position"] = [float(number) for number in message.position]
        fields["effort"] = [float(number) for number in message.effort]
    elif hasattr(message, "point_step"):
        kinds = {7: "<f4", 8: "<f8"}
        layout = {
            "names": [field.name for field in message.fields],
            "formats": [kinds[field.datatype] for field in message.fields],
            "offsets": [field.offset for field in message.fields],
            "itemsize": message.point_step,
        }
        rows = np.frombuffer(bytes(message.data), np.dtype(layout), message.width)
        fields["columns"] = {name: rows[name].astype(float).tolist() for name in layout["names"]}
    elif hasattr(message, "wrench"):
        vectors = (message.wrench.force, message.wrench.torque)
        fields["link"] = message.header.frame_id
        fields["wrench"] = [number for v in vectors for number in (v.x, v.y, v.z)]
    elif hasattr(getattr(message, "data", None), "tolist"):
        fields["data"] = message.data.tolist()
    elif hasattr(message, "data"):
        fields["data"] = message.data
    return json.dumps(fields)


def read_mcap(path):
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages():
            print(line_of(channel.topic, message.log_time, decoded))


def read(path):
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        for connection, time_ns, data in reader.messages():
            print(line_of(connection.topic, time_ns, reader.deserialize(data, connection.msgtype)))


def main(command, *paths):
    paths = [Path(path) for path in paths]
    if command == "write":
        source, folder = paths
        mcap, sqlite = StoragePlugin.MCAP, StoragePlugin.SQLITE3
        write_touches(source, folder / "mcap_zstd", mcap, CompressionMode.STORAGE)
        write_touches(source, folder / "mcap_plain", mcap, None)
        write_touches(source, folder / "sqlite", sqlite, None)
        write_touches(source, folder / "message_zstd", sqlite, CompressionMode.MESSAGE)
        write_touches(source, folder / "file_zstd", mcap, CompressionMode.FILE)
    elif command == "states":
        source, folder = paths
        for maker in STATES:
            write_states(source, folder / maker)
    elif command == "read":
        read(paths[0])
    elif command == "read-mcap":
        read_mcap(paths[0])
    else:
        sys.exit(__doc__)


if __name__ == "__main__":
    main(*sys.argv[1:])
