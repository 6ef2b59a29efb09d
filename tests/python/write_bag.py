"""Writes a ROS 2 bag with the rosbags package: an arm that rests at poses, and what was measured there.

    write_bag.py SPECIFICATION.json BAG_FOLDER

The specification has `joints` (names), `rows` (each with `q` in rad, and `point` in m or `sphere` with `place`), `kind`
(point, pose or number) and `compressed` (true: messages in chunks of Zstandard). Joint states come at 100 Hz, in the
reverse order of the joints and with a gripper; the arm rests for 0.8 s at each row and moves for 0.4 s between. Points come at
20 Hz all the time, wrong ones while the arm moves.
"""

import json
import pathlib
import sys

import numpy as np
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

store = get_typestore(Stores.ROS2_JAZZY)
types = store.types
told = json.loads(pathlib.Path(sys.argv[1]).read_text())
names = [*reversed(told["joints"]), "gripper_finger"]
START = 1_790_000_000_000_000_000


def header(time_ns, frame):
    stamp = types["builtin_interfaces/msg/Time"](sec=time_ns // 10**9, nanosec=time_ns % 10**9)
    return types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)


def joint_state(time_ns, q):
    position = np.array([*reversed(q), 0.04])
    empty = np.zeros(0)
    return types["sensor_msgs/msg/JointState"](
        header=header(time_ns, "base"), name=names, position=position, velocity=empty, effort=empty)


def target(time_ns, row, moving):
    if told["kind"] == "number":
        return types["std_msgs/msg/Int32"](data=row["sphere"])
    at, frame = [0.0, 0.0, 0.0], "tracker"
    if "sphere" in row:
        frame = f"{row.get('place', 'a')}/sphere_{row['sphere']}"
    else:
        at = [x + 0.1 * moving for x in row["point"]]
    point = types["geometry_msgs/msg/Point"](x=at[0], y=at[1], z=at[2])
    if told["kind"] == "point":
        return types["geometry_msgs/msg/PointStamped"](header=header(time_ns, frame), point=point)
    turn = types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
    pose = types["geometry_msgs/msg/Pose"](position=point, orientation=turn)
    return types["geometry_msgs/msg/PoseStamped"](header=header(time_ns, frame), pose=pose)


KINDS = {
    "point": "geometry_msgs/msg/PointStamped",
    "pose": "geometry_msgs/msg/PoseStamped",
    "number": "std_msgs/msg/Int32",
}
writer = Writer(pathlib.Path(sys.argv[2]), version=9, storage_plugin=StoragePlugin.MCAP)
if told.get("compressed"):
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
with writer:
    joints = writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=store)
    kind = KINDS[told["kind"]]
    targets = writer.add_connection("/measured", kind, typestore=store)

    def write(connection, time_ns, message):
        writer.write(connection, time_ns, store.serialize_cdr(message, connection.msgtype))

    tick = 0
    rows = told["rows"]
    for number, row in enumerate(rows):
        here = np.array(row["q"])
        then = np.array(rows[(number + 1) % len(rows)]["q"])
        for step in range(80 if number + 1 == len(rows) else 120):
            time_ns = START + tick * 10_000_000
            tick += 1
            moving = step >= 80
            q = here if not moving else here + (then - here) * (step - 79) / 41
            write(joints, time_ns, joint_state(time_ns, q))
            if step % 5 == 0 and not (told["kind"] == "number" and moving):
                write(targets, time_ns, target(time_ns, row, moving))
print(json.dumps({"joint_states": tick}))
