"""The drive link of spherecal in Python, standard library only.

docs/drive-link.md describes every byte of it; this file is that page as code.
A frame is  COBS(key[8] | sequence u32 | time_us u64 | body | crc32c u32) 00,
all little-endian; a body is postcard: fields in order, integers as varints,
f64 as 8 bytes, lists with their length in front.

    python3 drive_link.py < FRAMES.hex      decodes frames, one a line, to JSON
"""

import json
import struct
import sys
import time

# First eight bytes of each message type's schema hash: another layout, another key.
HELLO_KEY = bytes.fromhex("d29dfd2ece190cb5")
STATE_KEY = bytes.fromhex("a14694c683ea7ec3")
COMMAND_KEY = bytes.fromhex("cc7d322984ea49db")

PROTOCOL = 2
NO_SESSION = 0  # of a command: the controller asks for the hello
MAX_FRAME = 2304
# What may come without a valid frame.
NOISE_BYTES, NOISE_S = 1 << 20, 5.0

READY, DISABLED, EMERGENCY_STOP, FAILED = range(4)
OF_ACTUATOR, OF_LINK = range(2)


class LinkError(Exception):
    """Bytes that are no message of the drive link."""


# Checksum: CRC-32C (Castagnoli), reflected, as in iSCSI.


def _crc_table():
    table = []
    for byte in range(256):
        for _ in range(8):
            byte = (byte >> 1) ^ (0x82F63B78 if byte & 1 else 0)
        table.append(byte)
    return table


_TABLE = _crc_table()


def crc32c(data):
    """CRC-32C; crc32c(b"123456789") is 0xE3069283."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc = (crc >> 8) ^ _TABLE[(crc ^ byte) & 0xFF]
    return crc ^ 0xFFFFFFFF


# COBS: no zero byte inside a frame, one behind it.


def stuff(data):
    """COBS-encodes; the zero byte that ends a frame is not added."""
    out = bytearray()
    runs = data.split(b"\0")
    for index, run in enumerate(runs):
        while len(run) >= 254:
            out += b"\xff" + run[:254]
            run = run[254:]
            if not run and index == len(runs) - 1:
                # A full block at the very end stands for no zero after it.
                return bytes(out)
        out += bytes([len(run) + 1]) + run
    return bytes(out)


def unstuff(data):
    """Undoes COBS; `data` comes without the zero byte behind the frame."""
    out = bytearray()
    at = 0
    while at < len(data):
        code = data[at]
        block = data[at + 1 : at + code]
        if code == 0 or len(block) != code - 1:
            raise LinkError("a frame is not COBS")
        out += block
        at += code
        if code != 0xFF and at < len(data):
            out.append(0)
    return bytes(out)


# Postcard: the body.


def varint(value):
    """Unsigned LEB128: seven bits a byte, lowest first, high bit on all but the last."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def floats(values):
    """A list of f64: its length as a varint, then 8 bytes each."""
    return varint(len(values)) + struct.pack(f"<{len(values)}d", *values)


class Reader:
    """Reads a body field by field."""

    def __init__(self, data):
        self.data, self.at = data, 0

    def take(self, count):
        piece = self.data[self.at : self.at + count]
        if len(piece) != count:
            raise LinkError("a body ends too early")
        self.at += count
        return piece

    def varint(self):
        value, shift = 0, 0
        while True:
            byte = self.take(1)[0]
            value |= (byte & 0x7F) << shift
            if byte < 0x80:
                return value
            shift += 7
            if shift > 63:
                raise LinkError("a varint is too long")

    def flag(self):
        return self.take(1) != b"\0"

    def floats(self):
        count = self.varint()
        if count > 8:
            raise LinkError("more than eight joints")
        return list(struct.unpack(f"<{count}d", self.take(8 * count)))


def hello_body(hello):
    body = varint(hello["protocol"]) + varint(hello["session"]) + varint(len(hello["limits"]))
    for limit in hello["limits"]:
        body += struct.pack("<4d", *limit)
    body += varint(hello["period_us"]) + bytes([hello["compensates_gravity"]])
    body += varint(hello["torque_sign"]) + bytes([hello["lock_step"]])
    body += floats(hello["motor_kg_m2"]) + varint(hello["latency_us"])
    return body + bytes([hello["follows"], hello["simulated"]])


def state_body(state):
    joints = floats(state["q"]) + floats(state["dq"]) + floats(state["tau"])
    return varint(state["session"]) + varint(state["tick"]) + joints + varint(state["status"])


def command_body(command):
    body = varint(command["session"]) + varint(command["tick"]) + floats(command["tau"]) + floats(command["follow"])
    return body + bytes([command["enable"]])


def read_hello(reader):
    hello = {"protocol": reader.varint(), "session": reader.varint(), "limits": []}
    for _ in range(reader.varint()):
        # min rad, max rad, largest speed rad/s, largest torque N m
        hello["limits"].append(list(struct.unpack("<4d", reader.take(32))))
    hello["period_us"] = reader.varint()
    hello["compensates_gravity"] = reader.flag()
    hello["torque_sign"] = reader.varint()
    hello["lock_step"] = reader.flag()
    hello["motor_kg_m2"] = reader.floats()
    hello["latency_us"] = reader.varint()
    hello["follows"] = reader.flag()
    hello["simulated"] = reader.flag()
    return hello


def read_state(reader):
    state = {"session": reader.varint(), "tick": reader.varint()}
    state.update({"q": reader.floats(), "dq": reader.floats(), "tau": reader.floats()})
    state["status"] = reader.varint()
    return state


def read_command(reader):
    command = {"session": reader.varint(), "tick": reader.varint()}
    command.update({"tau": reader.floats(), "follow": reader.floats()})
    command["enable"] = reader.flag()
    return command


MESSAGES = {
    "hello": (HELLO_KEY, hello_body, read_hello),
    "state": (STATE_KEY, state_body, read_state),
    "command": (COMMAND_KEY, command_body, read_command),
}


def encode(kind, message, sequence, time_us):
    """One frame, its zero byte included."""
    key, body, _ = MESSAGES[kind]
    raw = key + struct.pack("<IQ", sequence & 0xFFFFFFFF, time_us) + body(message)
    return stuff(raw + struct.pack("<I", crc32c(raw))) + b"\0"


def decode(frame):
    """(kind, message, sequence, time_us) of a frame without its zero byte."""
    raw = unstuff(frame)
    if len(raw) < 24:
        raise LinkError("a frame is shorter than its header")
    covered, crc = raw[:-4], struct.unpack("<I", raw[-4:])[0]
    if crc32c(covered) != crc:
        raise LinkError("a frame's CRC-32C does not match")
    sequence, time_us = struct.unpack("<IQ", covered[8:20])
    for kind, (key, _, read) in MESSAGES.items():
        if key == covered[:8]:
            return kind, read(Reader(covered[20:])), sequence, time_us
    raise LinkError(f"schema key {covered[:8].hex()} is of another message or version: use versions that belong together")


class Wire:
    """One end of a connection: messages out, messages in."""

    def __init__(self, sock):
        self.sock, self.sent, self.bytes, self.damaged = sock, 0, b"", 0
        # Bytes since the last valid frame, and since when.
        self.noise, self.since = 0, None

    def send(self, kind, message, time_us):
        self.sock.sendall(encode(kind, message, self.sent, time_us))
        self.sent += 1

    def receive(self, expected):
        """The next message, which must be of that kind; None when the other side has gone."""
        while True:
            frame, zero, rest = self.bytes.partition(b"\0")
            if not zero:
                if len(frame) > MAX_FRAME:
                    raise LinkError("what comes has no frames")
                more = self.sock.recv(65536)
                if not more:
                    return None
                self.bytes += more
                self.noise += len(more)
                self.since = self.since or time.monotonic()
                if self.noise > NOISE_BYTES or time.monotonic() - self.since > NOISE_S:
                    raise LinkError("what comes has no valid frames")
                continue
            self.bytes = rest
            if not frame:
                continue
            try:
                kind, message, _, _ = decode(frame)
            except LinkError as error:
                if "schema key" in str(error):
                    raise
                self.damaged += 1  # damaged on the way: the next zero byte begins afresh
                continue
            self.noise, self.since = len(self.bytes), time.monotonic() if self.bytes else None
            if kind != expected:
                raise LinkError(f"a {kind} came where a {expected} belongs")
            return message


def main():
    for line in sys.stdin:
        frame = bytes.fromhex(line)
        kind, message, sequence, time_us = decode(frame.rstrip(b"\0"))
        again = encode(kind, message, sequence, time_us)
        print(json.dumps({"kind": kind, "sequence": sequence, "time_us": time_us, "message": message, "hex": again.hex()}))


if __name__ == "__main__":
    main()
