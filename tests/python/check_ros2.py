"""Reads a ROS 2 bag with the rosbags package, and compares it with the telemetry that it was made of.

    check_ros2.py BAG_FOLDER TELEMETRY.mcap

Prints one line of JSON: messages by topic, the first and last time, and the largest difference of
angles, forces and frames (relative beyond 1).
"""

import json
import pathlib
import sys

from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

told = {}
with open(sys.argv[2], "rb") as file:
    for _, channel, message in make_reader(file).iter_messages(topics=["/joint_states", "/wrench", "/tf"]):
        told.setdefault(channel.topic, []).append((message.log_time, json.loads(message.data)))


def xyz(v):
    return [v["x"], v["y"], v["z"]] if isinstance(v, dict) else [v.x, v.y, v.z]


def stamp(header):
    return header.stamp.sec * 10**9 + header.stamp.nanosec


counts, times, worst, contacts = {}, [], 0.0, 0
with AnyReader([pathlib.Path(sys.argv[1])]) as reader:
    for connection, time_ns, raw in reader.messages():
        message = reader.deserialize(raw, connection.msgtype)
        topic = connection.topic
        if topic == "/contact":
            assert connection.msgtype == "geometry_msgs/msg/PointStamped"
            assert message.header.frame_id.startswith("sphere_") and xyz(message.point) == [0, 0, 0]
            assert abs(stamp(message.header) - time_ns) < 5 * 10**9
            contacts += 1
            continue
        number = counts.get(topic, 0)
        counts[topic] = number + 1
        times.append(time_ns)
        log_time, value = told[topic][number]
        assert log_time == time_ns, f"{topic} {number}: {time_ns} where telemetry has {log_time}"
        if topic == "/joint_states":
            assert connection.msgtype == "sensor_msgs/msg/JointState" and list(message.name) == value["name"]
            assert stamp(message.header) == time_ns
            pairs = zip([*message.position, *message.velocity, *message.effort],
                        [*value["position"], *value["velocity"], *value["effort"]])
        elif topic == "/wrench":
            assert connection.msgtype == "geometry_msgs/msg/WrenchStamped"
            assert message.header.frame_id == value["frame_id"] and stamp(message.header) == time_ns
            pairs = zip([*xyz(message.wrench.force), *xyz(message.wrench.torque)],
                        [*xyz(value["wrench"]["force"]), *xyz(value["wrench"]["torque"])])
        else:
            assert connection.msgtype == "tf2_msgs/msg/TFMessage"
            pairs = []
            for own, other in zip(message.transforms, value["transforms"], strict=True):
                assert own.header.frame_id == other["parent_frame_id"]
                assert own.child_frame_id == other["child_frame_id"] and stamp(own.header) == time_ns
                pairs += zip([*xyz(own.transform.translation), *xyz(own.transform.rotation), own.transform.rotation.w],
                             [*xyz(other["translation"]), *xyz(other["rotation"]), other["rotation"]["w"]])
        worst = max([worst, *(abs(a - b) / max(1.0, abs(b)) for a, b in pairs if b is not None)])
assert counts == {topic: len(messages) for topic, messages in told.items()}, counts
print(json.dumps({"counts": counts, "contacts": contacts, "first_ns": times[0], "last_ns": times[-1], "largest_difference": worst}))
