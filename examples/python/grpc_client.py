"""Touches a sphere and records poses from Python, over spherecal's services.

    pip install grpcio grpcio-tools
    spherecal serve --grpc 7403 &
    spherecal plan --poses 6 --out cell
    python examples/python/grpc_client.py 127.0.0.1:7403 cell/plan.json

It asks the robot what it is, moves it over the first sphere of the plan,
approaches, records each pose, lets go, goes home, and prints one line of JSON
for each recording. Messages and their units: host/crates/services/proto/spherecal/v1/spherecal.proto.
"""

import json
import pathlib
import queue
import sys

import grpc

PROTO = pathlib.Path(__file__).resolve().parents[2] / "host" / "crates" / "services" / "proto"
sys.path.insert(0, str(PROTO))
protos, services = grpc.protos_and_services("spherecal/v1/spherecal.proto")


class Robot:
    """The robot, held from the first order until it is closed."""

    def __init__(self, channel):
        self.stub = services.RobotControllerStub(channel)
        self.about = self.stub.Describe(protos.DescribeRequest())
        self.orders = queue.Queue()
        self.outcomes = self.stub.Operate(iter(self.orders.get, None))

    def order(self, **command):
        """Carries out one order; returns its events, or raises what went wrong."""
        self.orders.put(protos.Order(**command))
        outcome = next(self.outcomes)
        if not outcome.done:
            raise RuntimeError(f"{next(iter(command))}: {outcome.reason}")
        return outcome.events

    def close(self):
        self.orders.put(None)


def main(address, plan_file):
    plan = json.loads(pathlib.Path(plan_file).read_text())
    with grpc.insecure_channel(address) as channel:
        robot = Robot(channel)
        print(f"{robot.about.robot}, {robot.about.joints} joints, {robot.about.program}", file=sys.stderr)
        visit = plan["spheres"][0]
        robot.order(move=protos.Joints(rad=plan["home"]["joints"]))
        robot.order(move=protos.Joints(rad=visit["approach"]["joints"]))
        touched = robot.order(
            approach=protos.Approach(sphere=visit["sphere_id"], direction=visit["approach_direction"])
        )
        contact = next(event.contact for event in touched if event.HasField("contact"))
        print(f"contact at {contact.force_n:.2f} N after {1e3 * contact.travel_m:.1f} mm", file=sys.stderr)
        for pose in visit["poses"]:
            events = robot.order(
                pose=protos.Pose(
                    pose=pose["id"],
                    orientation=pose["orientation"],
                    elbow_rad=pose["elbow_rad"],
                    posture_rad=pose["joints"],
                    record=not pose["via"],
                )
            )
            for event in events:
                if event.HasField("recording"):
                    recording = event.recording
                    print(
                        json.dumps(
                            {
                                "sphere": recording.sphere,
                                "pose": recording.pose,
                                "samples": recording.count,
                                "q_rad": [signal.mean for signal in recording.q],
                            }
                        )
                    )
        robot.order(decouple=protos.Decouple())
        robot.order(move=protos.Joints(rad=plan["home"]["joints"]))
        robot.close()


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main(*sys.argv[1:])
