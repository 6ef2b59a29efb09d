"""A controller for any drive of spherecal in a page of standard-library Python.

It holds the arm where it finds it: the torque that the sensors show at rest
carries the weight, a spring and a damper do the rest.

    spherecal plant --listen 7401
    python3 drive_client.py 127.0.0.1:7401 --ticks 2000

The drive gives the beat, in lock-step and in real time alike: each state is
answered once (docs/drive-link.md).
"""

import argparse
import socket
import sys

from drive_link import OF_LINK, PROTOCOL, READY, Wire

STIFFNESS = [600.0, 600.0, 400.0, 400.0, 100.0, 60.0, 20.0]  # N m/rad
DAMPING = [60.0, 60.0, 25.0, 25.0, 4.0, 2.0, 0.4]  # N m s/rad


class Hold:
    """A spring and damper in each joint about the first state."""

    def __init__(self, hello):
        self.hello, self.start, self.weight = hello, None, None
        # Of the measured torque, the drive carries the weight itself or we do.
        self.sign = -1.0 if hello["torque_sign"] == OF_LINK else 1.0

    def torque(self, state):
        if self.start is None:
            self.start = state["q"]
            carried = self.hello["compensates_gravity"]
            self.weight = [0.0 if carried else self.sign * tau for tau in state["tau"]]
        joints = zip(self.weight, STIFFNESS, DAMPING, self.start, state["q"], state["dq"], self.hello["limits"])
        torque = []
        for weight, stiffness, damping, q0, q, dq, limit in joints:
            wanted = weight + stiffness * (q0 - q) - damping * dq
            torque.append(max(-limit[3], min(limit[3], wanted)))
        return torque


def main():
    parser = argparse.ArgumentParser(description="holds the arm behind a drive link")
    parser.add_argument("drive", help="HOST:PORT")
    parser.add_argument("--ticks", type=int, default=2000, help="how long")
    args = parser.parse_args()
    host, _, port = args.drive.rpartition(":")
    connection = socket.create_connection((host, int(port)), timeout=30)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    wire = Wire(connection)
    hello = wire.receive("hello")
    if hello is None:
        sys.exit("the drive closed the connection: its own output says why")
    if hello["protocol"] != PROTOCOL:
        sys.exit(f"the drive speaks protocol {hello['protocol']}, this example {PROTOCOL}: use versions that belong together")
    joints = len(hello["limits"])
    if joints > len(STIFFNESS):
        sys.exit(f"the drive has {joints} joints: add stiffness and damping for the others here")
    print(f"{joints} joints, {hello['period_us']} us, {'lock-step' if hello['lock_step'] else 'real time'}")
    hold, moved, not_ready = Hold(hello), 0.0, 0
    for _ in range(args.ticks):
        state = wire.receive("state")
        if state is None:
            sys.exit("the drive closed the connection")
        not_ready += state["status"] != READY
        if state["session"] != hello["session"]:
            sys.exit("the drive has started again: start this example again")
        command = {"session": hello["session"], "tick": state["tick"], "tau": hold.torque(state), "follow": [], "enable": True}
        wire.send("command", command, state["tick"] * hello["period_us"])
        moved = max(moved, *(abs(a - b) for a, b in zip(state["q"], hold.start)))
    speed = max(abs(v) for v in state["dq"])
    print(f"held for {args.ticks} ticks within {moved:.6f} rad, last speed {speed:.6f} rad/s, {not_ready} ticks not ready")


if __name__ == "__main__":
    main()
