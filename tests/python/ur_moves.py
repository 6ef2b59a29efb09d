"""ur-rtde 1.6.5, unchanged, moves the robot side at 127.0.0.1:30004 by the robot's own position control.

`servoJ` follows a path for 2 s, `speedJ` turns the last joint, `moveJ` goes home, and the program is stopped.
"""
import time

import numpy as np
from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

RATE_HZ = 500.0
AMPLITUDE_RAD = 0.1
LOOKAHEAD_S = 0.05


def main():
    control = RTDEControlInterface("127.0.0.1", RATE_HZ)
    robot = RTDEReceiveInterface("127.0.0.1", RATE_HZ)
    assert control.isProgramRunning()
    home = np.array(robot.getActualQ())

    # All joints swing once, from rest to rest. A setpoint acts later: by the look-ahead, and by the delay of both ways.
    def path(at_s):
        return home + AMPLITUDE_RAD * (1 - np.cos(np.pi * np.clip(at_s, 0.0, 2.0)))

    begun, missed = time.monotonic(), []
    while (at_s := time.monotonic() - begun) < 2.5:
        period = control.initPeriod()
        assert control.servoJ(list(path(at_s)), 0.0, 0.0, 1 / RATE_HZ, LOOKAHEAD_S, 300)
        missed.append(np.abs(np.array(robot.getActualQ()) - path(at_s - LOOKAHEAD_S - 0.01)).max())
        control.waitPeriod(period)
    missed = np.median(missed)
    still = np.abs(np.array(robot.getActualQ()) - home).max()
    assert missed < 0.01 and still < 0.003, (missed, still)
    control.servoStop()

    control.speedJ([0.0, 0.0, 0.0, 0.0, 0.0, 0.2], 2.0)
    time.sleep(0.6)
    speed = robot.getActualQd()[5]
    assert abs(speed - 0.2) < 0.05, speed
    control.speedStop(2.0)
    turned = robot.getActualQ()[5] - home[5]
    assert turned > 0.05, turned

    begun = time.monotonic()
    assert control.moveJ(list(home), 0.3, 1.0)
    moved_s = time.monotonic() - begun
    time.sleep(0.3)
    left = np.abs(np.array(robot.getActualQ()) - home).max()
    assert left < 0.003 and moved_s > turned / 0.3, (left, moved_s)
    assert robot.getSafetyMode() == 1
    control.stopScript()
    print(
        f"ur-rtde: servoJ was {missed:.4f} rad off its path, speedJ turned the last joint by {turned:.3f} rad, moveJ ended "
        f"{left:.4f} rad from home after {moved_s:.2f} s"
    )
    control.disconnect()
    robot.disconnect()


if __name__ == "__main__":
    main()
