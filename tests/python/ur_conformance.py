"""ur-rtde 1.6.5, unchanged, reads the robot side at 127.0.0.1:30004: angles, torques, modes, pose, rate.

The angles and the calibration are those of host/crates/ur/tests/ur/common.rs. The pose is computed here again, from the
convention that the maker documents: T = Rz(theta) Tz(d) Tx(a) Rx(alpha) for each joint.
"""
import time

import numpy as np
from rtde_receive import RTDEReceiveInterface

POSE = [0.1, -1.2, 1.3, -1.4, -1.5, 0.6]
THETA = [-2.4e-7, 1.60233952, -1.68607191, 0.08373311, -1.0e-7, 3.9e-8]
A = [2.1e-5, 0.02001713, -0.57000166, -4.6e-5, -6.4e-5, 0.0]
D = [0.12713981, 439.14097408, -446.02705981, 7.0501279, 0.11566134, 0.09132092]
ALPHA = [1.57014608, 0.00139417, 0.00693819, 1.56998469, -1.57038521, 0.0]


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
    robot = RTDEReceiveInterface("127.0.0.1", 500.0)
    assert robot.isConnected()
    assert robot.getActualQ() == POSE, robot.getActualQ()
    assert robot.getTargetMoment() == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0], robot.getTargetMoment()
    assert (robot.getRobotMode(), robot.getSafetyMode(), robot.getRuntimeState()) == (7, 1, 1)
    assert robot.isProtectiveStopped() is False and robot.isEmergencyStopped() is False
    flange = np.eye(4)
    for q, theta, a, d, alpha in zip(POSE, THETA, A, D, ALPHA):
        flange = flange @ turn(2, q + theta) @ shift(2, d) @ shift(0, a) @ turn(0, alpha)
    pose = robot.getActualTCPPose()
    assert np.abs(flange[:3, 3] - pose[:3]).max() < 1e-9, (flange, pose)
    angle = np.linalg.norm(pose[3:])
    x, y, z = np.array(pose[3:]) / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    rotation = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    assert np.abs(flange[:3, :3] - rotation).max() < 1e-9, (flange, pose)
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
