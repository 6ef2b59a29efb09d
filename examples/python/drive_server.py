"""A complete drive for spherecal in a page of standard-library Python.

Seven joints, each a point inertia without gravity; joint k turns by
inertia * acceleration = torque - damping * speed. Attach the controller:

    python3 drive_server.py 7401
    spherecal controller --drive tcp:127.0.0.1:7401 --host-link tcp:7402

point_arm.toml describes this arm to spherecal. Replace `Arm` by your simulator
or by your robot's interface; the rest is the drive link (docs/drive-link.md).
"""

import argparse
import socket
import time

from drive_link import OF_ACTUATOR, PROTOCOL, READY, LinkError, Wire

PERIOD_US = 1000
INERTIA = [2.0, 2.0, 1.0, 1.0, 0.3, 0.3, 0.1]  # kg m2, as in point_arm.toml
# Messages beyond one a period that close a connection.
FLOOD = 1000
DAMPING = 0.5  # N m s/rad
LIMITS = [[-2.9, 2.9, 2.0, 100.0]] * 7  # min rad, max rad, rad/s, N m
# Another number after each start, and never 0: the controller notices a restart.
SESSION = int(time.time()) % 0xFFFFFFFF + 1
START = [0.0, 0.6, 0.0, -1.5, 0.0, 1.0, 0.0]


class Arm:
    """The simulated arm: what your simulator takes the place of."""

    def __init__(self):
        self.q, self.dq, self.tau = list(START), [0.0] * 7, [0.0] * 7

    def step(self, tau, seconds):
        """Carries out the torques (N m) for one period."""
        for k, (torque, inertia) in enumerate(zip(tau, INERTIA)):
            largest = LIMITS[k][3]
            self.tau[k] = max(-largest, min(largest, torque))
            # Semi-implicit Euler, damping taken implicitly.
            self.dq[k] = (self.dq[k] + self.tau[k] / inertia * seconds) / (1.0 + DAMPING / inertia * seconds)
            self.q[k] += self.dq[k] * seconds

    def brake(self):
        """Brakes closed: the joints stand still."""
        self.dq, self.tau = [0.0] * 7, [0.0] * 7


def state_of(arm, tick):
    return {"session": SESSION, "tick": tick, "q": arm.q, "dq": arm.dq, "tau": arm.tau, "status": READY}


def carry_out(arm, command):
    if command["enable"] and command["session"] == SESSION:
        arm.step(command["tau"], PERIOD_US * 1e-6)
    else:
        arm.brake()


def receive(wire, hello):
    """The next command; None when the controller has gone. One that knows no session asks for the hello."""
    command = wire.receive("command")
    if command and command["session"] == 0:
        wire.send("hello", hello, 0)
    return command


def lock_step(wire, hello, arm, tick):
    """One state, one command, and so on: time stands still in between."""
    while True:
        wire.send("state", state_of(arm, tick), tick * PERIOD_US)
        command, late = receive(wire, hello), 0
        while command and command["tick"] != tick:
            command, late = receive(wire, hello), late + 1  # an answer to an older state
            if late > FLOOD:
                raise LinkError("a flood of commands that answer no state")
        if command is None:
            return tick
        carry_out(arm, command)
        tick += 1


def real_time(wire, hello, arm, tick):
    """A state every period; the newest command stands, for ten periods at most."""
    wire.sock.setblocking(False)
    due, command, age, first, came = time.monotonic(), None, 0, tick, 0
    try:
        while True:
            wire.send("state", state_of(arm, tick), tick * PERIOD_US)
            due += PERIOD_US * 1e-6
            time.sleep(max(0.0, due - time.monotonic()))
            age += 1
            try:
                while True:
                    newer = receive(wire, hello)
                    if newer is None:
                        return tick
                    command, age, came = newer, 0, came + 1
                    if came > FLOOD + 2 * (tick - first):
                        raise LinkError("far more commands than one a period")
            except BlockingIOError:
                pass
            if command and age < 10:
                carry_out(arm, command)
            else:
                arm.brake()
            tick += 1
    finally:
        wire.sock.setblocking(True)


def arguments(about):
    """What every drive of these examples may be told."""
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("port", type=int, help="port on this machine; 0 takes any")
    parser.add_argument("--real-time", action="store_true", help="by the clock, without waiting for commands")
    parser.add_argument("--once", action="store_true", help="end when the first controller disconnects")
    return parser


def serve(arm, limits, args):
    """Offers an arm (q, dq, tau, step, brake) to one controller after the other."""
    hello = {
        "protocol": PROTOCOL,
        "session": SESSION,
        "limits": limits,
        "period_us": PERIOD_US,
        "compensates_gravity": False,
        "torque_sign": OF_ACTUATOR,
        "lock_step": not args.real_time,
        # Motors that the torque of a joint has to move besides its link; none here.
        "motor_kg_m2": [],
        "latency_us": 0,
        "follows": False,
        # Results over this drive are marked as simulated.
        "simulated": True,
    }
    tick = 0
    server = socket.create_server(("127.0.0.1", args.port))
    print(f"drive link on tcp:127.0.0.1:{server.getsockname()[1]}", flush=True)
    while True:
        connection, _ = server.accept()
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        wire = Wire(connection)
        try:
            wire.send("hello", hello, 0)
            tick = (real_time if args.real_time else lock_step)(wire, hello, arm, tick)
        except ConnectionError:
            pass  # the controller went away
        except LinkError as error:
            print(f"a controller is left: {error}", flush=True)
        connection.close()
        arm.brake()
        tick += 1
        print(f"a controller disconnected at tick {tick}; {wire.damaged} damaged frames", flush=True)
        if args.once:
            return


if __name__ == "__main__":
    serve(Arm(), LIMITS, arguments("a simulated arm on spherecal's drive link").parse_args())
