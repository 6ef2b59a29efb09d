"""ur-rtde 1.6.5, unchanged, reads the robot side at 127.0.0.1:30004: angles, torques, modes, pose, rate.

    ur_conformance.py '{"q": [..], "within": 0, "moment": [..] or null, "theta": [..], "a": [..], "d": [..], "alpha": [..]}'

The joint angles (rad) are to be within the given distance. The pose is computed here again, from the convention that the
maker documents: T = Rz(q + theta) Tz(d) Tx(a) Rx(alpha) for each joint.
"""
import json
import sys
import time

import numpy as np
from rtde_receive import RTDEReceiveInterface


def turn(axis, angle):
    out = np.eye(4)
    c, s = np.cos(angle), np.sin(angle)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    out[i, i], out[i, j], out[j, i], out[j, j] = c, -s, s, c
    return out


def shift(axis, way):
    out = np.eye(4)
    out[axis, 3] = way
    return out


def main():
    expected = json.loads(sys.argv[1])
    robot = RTDEReceiveInterface("127.0.0.1", 500.0)
    assert robot.isConnected()
    found = robot.getActualQ()
    assert np.abs(np.subtract(found, expected["q"])).max() <= expected["within"], found
    if expected["moment"]:
        assert robot.getTargetMoment() == expected["moment"], robot.getTargetMoment()
    assert (robot.getRobotMode(), robot.getSafetyMode(), robot.getRuntimeState()) == (7, 1, 1)
    assert robot.isProtectiveStopped() is False and robot.isEmergencyStopped() is False
    flange = np.eye(4)
    for q, theta, a, d, alpha in zip(expected["q"], *(expected[name] for name in ("theta", "a", "d", "alpha"))):
        flange = flange @ turn(2, q + theta) @ shift(2, d) @ shift(0, a) @ turn(0, alpha)
    pose = robot.getActualTCPPose()
    assert np.abs(flange[:3, 3] - pose[:3]).max() <= 1e-9 + 2 * expected["within"], (flange, pose)
    angle = np.linalg.norm(pose[3:])
    x, y, z = np.array(pose[3:]) / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    rotation = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    assert np.abs(flange[:3, :3] - rotation).max() <= 1e-9 + 2 * expected["within"], (flange, pose)
    # The robot's own clock: packages of 500 Hz are 2 ms apart, whatever this computer does meanwhile.
    stamps = set()
    end = time.monotonic() + 1
    while time.monotonic() < end or len(stamps) < 50:
        stamps.add(robot.getTimestamp())
        time.sleep(0.0005)
    apart = np.diff(sorted(stamps)).min()
    assert abs(apart - 0.002) < 1e-9, apart
    print(f"ur-rtde: {len(stamps)} fresh packages, {apart * 1e3:.3f} ms apart")
    robot.disconnect()


main()
