"""Reads a ROS 2 bag with the rosbags package, and compares it with the telemetry that it was made of.

    check_ros2.py BAG_FOLDER TELEMETRY.mcap

Prints one line of JSON: messages by topic.
"""

import json
import pathlib
import sys

from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

told = {}
with open(sys.argv[2], "rb") as file:
    for schema, channel, message in make_reader(file).iter_messages():
        if not schema.name.startswith("spherecal_msgs/"):
            told.setdefault(channel.topic, []).append((message.log_time, schema.name, message.data))

counts = {}
with AnyReader([pathlib.Path(sys.argv[1])]) as reader:
    for connection, time_ns, raw in reader.messages():
        message = reader.deserialize(raw, connection.msgtype)
        topic = connection.topic
        assert (time_ns, connection.msgtype, raw) == told[topic][counts.get(topic, 0)], f"{topic} at {time_ns}"
        counts[topic] = counts.get(topic, 0) + 1
        if topic == "/contact":
            assert message.header.frame_id.startswith("sphere_")
            assert [message.point.x, message.point.y, message.point.z] == [0, 0, 0]
            stamp = message.header.stamp
            assert 0 <= time_ns - (stamp.sec * 10**9 + stamp.nanosec) < 5 * 10**9
assert counts == {topic: len(messages) for topic, messages in told.items()}, counts
print(json.dumps({"counts": counts}))
