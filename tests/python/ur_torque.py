"""ur-rtde 1.6.5, unchanged, commands torques to the robot side at 127.0.0.1:30004.

Zero torques hold the arm for 5 s: the robot adds gravity. Then a torque at the last joint turns it, and the program is stopped.
"""
import time

import numpy as np
from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

RATE_HZ = 500.0
SCALES = [0.0] * 6


def main():
    control = RTDEControlInterface("127.0.0.1", RATE_HZ)
    robot = RTDEReceiveInterface("127.0.0.1", RATE_HZ)
    assert control.isProgramRunning()

    def command(torque, seconds):
        end = time.monotonic() + seconds
        count = 0
        while time.monotonic() < end:
            begun = control.initPeriod()
            assert control.directTorque(torque, SCALES, SCALES)
            count += 1
            control.waitPeriod(begun)
        return count

    start = np.array(robot.getActualQ())
    count = command([0.0] * 6, 5.0)
    moved = np.abs(np.array(robot.getActualQ()) - start).max()
    assert count > 500, count
    assert moved < 0.05, moved
    command([0.0, 0.0, 0.0, 0.0, 0.0, 0.5], 0.3)
    turned = robot.getActualQ()[5] - start[5]
    assert turned > 0.05, turned
    assert robot.getSafetyMode() == 1
    control.stopScript()
    print(f"ur-rtde: {count} zero torques, the arm moved by {moved:.4f} rad; 0.5 N m turned the last joint by {turned:.3f} rad")
    control.disconnect()
    robot.disconnect()


if __name__ == "__main__":
    main()
