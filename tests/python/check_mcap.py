"""Reads an MCAP file whole with the mcap package, every checksum compared.

Prints one line of JSON: messages by topic, and the first and last time.
"""

import json
import sys

from mcap.reader import NonSeekingReader, make_reader

counts, times = {}, []
with open(sys.argv[1], "rb") as file:
    for schema, channel, message in NonSeekingReader(file, validate_crcs=True).iter_messages():
        value = json.loads(message.data)
        fields = json.loads(schema.data)["properties"]
        assert set(value) <= set(fields), f"{channel.topic}: {set(value) - set(fields)} not in the schema"
        counts[channel.topic] = counts.get(channel.topic, 0) + 1
        times.append(message.log_time)
with open(sys.argv[1], "rb") as file:
    summary = make_reader(file, validate_crcs=True).get_summary()
    told = {summary.channels[k].topic: n for k, n in summary.statistics.channel_message_counts.items()}
assert told == counts, f"the summary says {told}, the file holds {counts}"
assert times == sorted(times), "times go back"
print(json.dumps({"counts": counts, "first_ns": times[0], "last_ns": times[-1]}))
