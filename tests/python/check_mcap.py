"""Reads an MCAP file whole with the mcap package, every checksum compared.

Prints one line of JSON: messages by topic, the first and last time, and the largest distance (m) and
the largest difference of rotation between the TCP of `/tcp` and the end of the chain of `/tf`.
"""

import json
import sys

import numpy

from mcap.reader import NonSeekingReader, make_reader

counts, times, tcps, chains = {}, [], {}, {}


def rotation(q):
    x, y, z, w = q["x"], q["y"], q["z"], q["w"]
    return numpy.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])


def pose(position, orientation):
    out = numpy.eye(4)
    out[:3, :3] = rotation(orientation)
    out[:3, 3] = [position["x"], position["y"], position["z"]]
    return out


with open(sys.argv[1], "rb") as file:
    for schema, channel, message in NonSeekingReader(file, validate_crcs=True).iter_messages():
        value = json.loads(message.data)
        fields = json.loads(schema.data)["properties"]
        assert set(value) <= set(fields), f"{channel.topic}: {set(value) - set(fields)} not in the schema"
        counts[channel.topic] = counts.get(channel.topic, 0) + 1
        times.append(message.log_time)
        if channel.topic == "/tcp":
            tcps[message.log_time] = (value["frame_id"], pose(value["pose"]["position"], value["pose"]["orientation"]))
        if channel.topic == "/tf":
            frames = {}
            for t in value["transforms"]:
                assert t["child_frame_id"] not in frames, f"{t['child_frame_id']} has two parents"
                frames[t["child_frame_id"]] = (t["parent_frame_id"], pose(t["translation"], t["rotation"]))
            chains[message.log_time] = frames
with open(sys.argv[1], "rb") as file:
    summary = make_reader(file, validate_crcs=True).get_summary()
    told = {summary.channels[k].topic: n for k, n in summary.statistics.channel_message_counts.items()}
assert told == counts, f"the summary says {told}, the file holds {counts}"
assert times == sorted(times), "times go back"


def in_root(frames, name):
    if name not in frames:
        return numpy.eye(4)
    parent, own = frames[name]
    return in_root(frames, parent) @ own


distance = turn = 0.0
for time, frames in chains.items():
    f0, told = tcps[time]
    found = numpy.linalg.inv(in_root(frames, f0)) @ in_root(frames, "spherecal_tcp")
    distance = max(distance, float(numpy.linalg.norm(found[:3, 3] - told[:3, 3])))
    turn = max(turn, float(abs(found[:3, :3] - told[:3, :3]).max()))
print(json.dumps({"counts": counts, "first_ns": times[0], "last_ns": times[-1], "instants": len(chains),
                  "distance_m": distance, "rotation": turn}))
