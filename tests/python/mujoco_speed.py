"""Times MuJoCo's mj_step on the plant's model: free, seated on three pads, with joint friction.

    pip install mujoco
    python tests/python/mujoco_speed.py       (prints JSON: microseconds a step of 0.25 ms)

`scripts/speed` times it and our plant in one run; a tick of ours is four such steps.
"""
import json
import time

import mujoco
import numpy as np

from mujoco_model import model, rows


def pose(m, d, q):
    d.qpos[:] = q
    mujoco.mj_forward(m, d)
    return d.site("tcp").xpos.copy()


def timed(seated, coulomb, steps=40_000, rounds=5):
    q = np.array([0.0, 0.55, 0.0, -1.70, 0.0, np.pi - 0.55 - 1.70, 0.0])
    bare = mujoco.MjModel.from_xml_string(model(rows(), 2.5e-4, "Euler"))
    data = mujoco.MjData(bare)
    sphere = pose(bare, data, q)
    hold = data.qfrc_bias.copy()
    m = mujoco.MjModel.from_xml_string(
        model(rows(), 2.5e-4, "Euler", coulomb, 0.5, seated=(sphere - [0, 0, 1e-5] if seated else None), spring=q.tolist() if seated else None)
    )
    best = np.inf
    contacts = 0
    for _ in range(rounds):
        d = mujoco.MjData(m)
        d.qpos[:] = q
        d.ctrl[:] = hold
        if seated:
            # The magnet, as a constant pull at the TCP into the sphere.
            mujoco.mj_forward(m, d)
            tool = m.body("tool").id
            force = np.array([0.0, 0.0, -26.5])
            arm = d.site("tcp").xpos - d.xipos[tool]
            d.xfrc_applied[tool] = np.concatenate([force, np.cross(arm, force)])
        mujoco.mj_step(m, d, nstep=2000)
        begin = time.process_time()
        mujoco.mj_step(m, d, nstep=steps)
        best = min(best, (time.process_time() - begin) / steps)
        contacts = d.ncon
    return best * 1e6, contacts


if __name__ == "__main__":
    result = dict(mujoco=mujoco.__version__)
    for name, seated, coulomb in [("free", False, 0.0), ("seated", True, 0.0), ("seated_friction", True, 0.1)]:
        us, contacts = timed(seated, coulomb)
        result[name] = dict(us_per_step=round(us, 3), contacts=contacts)
    print(json.dumps(result))
