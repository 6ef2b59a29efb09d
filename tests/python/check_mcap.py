"""Reads a telemetry file whole with two independent packages, mcap and rosbags, every checksum compared.

    check_mcap.py TELEMETRY.mcap

mcap checks the container: checksums, index, counts, order of the times. rosbags reads each message by the definition that
the file has of its type, and refuses bytes that are left over. Prints one line of JSON: messages by topic, the first and
last time, the names of the joints, the largest distance (m) between the TCP of `/control` and the end of the chain of
`/tf`, and the mean of the first joint's angle (rad) over each recording that an event tells of, beside what the controller
told.
"""

import json
import pathlib
import sys

import numpy

from mcap.reader import NonSeekingReader, make_reader
from rosbags.highlevel import AnyReader

path = pathlib.Path(sys.argv[1])
counts, times, raw = {}, [], []
with open(path, "rb") as file:
    for schema, channel, message in NonSeekingReader(file, validate_crcs=True).iter_messages():
        assert (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr"), channel.topic
        counts[channel.topic] = counts.get(channel.topic, 0) + 1
        times.append(message.log_time)
assert times == sorted(times), "times go back"
with open(path, "rb") as file:
    reader = make_reader(file, validate_crcs=True)
    summary = reader.get_summary()
    told = {summary.channels[k].topic: n for k, n in summary.statistics.channel_message_counts.items()}
    assert told == counts, f"the summary says {told}, the file holds {counts}"
    # By the index of the chunks.
    joints = sum(1 for _ in reader.iter_messages(topics=["/joint_states"]))
    assert joints == counts["/joint_states"], joints


def rotation(q):
    x, y, z, w = q.x, q.y, q.z, q.w
    return numpy.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])


def pose(transform):
    out = numpy.eye(4)
    t = transform.translation
    out[:3, :3] = rotation(transform.rotation)
    out[:3, 3] = [t.x, t.y, t.z]
    return out


def stamp_ns(stamp):
    return stamp.sec * 10**9 + stamp.nanosec


read, tcps, chains, names, angles, device, recordings = {}, {}, {}, None, [], None, []
with AnyReader([path]) as reader:
    types = {c.topic: c.msgtype for c in reader.connections}
    for connection, time_ns, data in reader.messages():
        message = reader.deserialize(data, connection.msgtype)
        topic = connection.topic
        read[topic] = read.get(topic, 0) + 1
        if topic == "/joint_states":
            assert stamp_ns(message.header.stamp) == time_ns
            assert names in (None, list(message.name)), "the joints change"
            names = list(message.name)
            assert len(message.position) == len(message.velocity) == len(message.effort) == len(names)
            angles.append((time_ns, message.position[0]))
        elif topic == "/control":
            tcps[time_ns] = (message.header.frame_id, [message.tcp.x, message.tcp.y, message.tcp.z])
        elif topic == "/phase":
            device = stamp_ns(message.stamp) - message.device_us * 1000
        elif topic == "/tf":
            frames = {}
            for t in message.transforms:
                assert t.child_frame_id not in frames, f"{t.child_frame_id} has two parents"
                frames[t.child_frame_id] = (t.header.frame_id, pose(t.transform))
            chains[time_ns] = frames
        elif topic == "/events" and message.kind == "Recording":
            recording = json.loads(message.data)
            recordings.append((device + recording["start_us"] * 1000, device + recording["end_us"] * 1000,
                               recording["q"][0]["mean"]))
assert read == counts, f"rosbags reads {read}, the file holds {counts}"


def in_root(frames, name):
    if name not in frames:
        return numpy.eye(4)
    parent, own = frames[name]
    return in_root(frames, parent) @ own


distance = 0.0
for time, frames in chains.items():
    f0, told = tcps[time]
    found = numpy.linalg.inv(in_root(frames, f0)) @ in_root(frames, "spherecal_tcp")
    distance = max(distance, float(numpy.linalg.norm(found[:3, 3] - told)))
angles = numpy.array(angles, dtype=object)
means = [[float(numpy.mean([q for time, q in angles if start <= time <= end])), told] for start, end, told in recordings]
print(json.dumps({"counts": counts, "types": types, "first_ns": times[0], "last_ns": times[-1], "joints": names,
                  "instants": len(chains), "distance_m": distance, "recordings": means}))
