"""Makes tests/data/ref_friction.json: trajectories with joint friction and armature, by MuJoCo.

    pip install mujoco
    python tests/python/mujoco_oracle.py

Torque A sin(w t), sampled at 1 kHz and held; Coulomb friction as MuJoCo's
`frictionloss` (made nearly rigid by solref/solimp), viscous as `damping`,
rotors as `armature`. The step is halved until the result at 0.1 s no longer
moves by more than 1e-5 rad; the last difference is written into the file.
"""
import json
import math
import random

import mujoco
import numpy as np

from mujoco_model import DATA, model, reflected_rotors, rows

COULOMB, VISCOUS = 1.0, 0.5


def simulate(q0, amplitude, w, timestep, coulomb, viscous, armature):
    m = mujoco.MjModel.from_xml_string(
        model(rows(), timestep, "implicitfast", coulomb, viscous, armature, solver='solver="Newton" tolerance="1e-14"', rigid_friction=True)
    )
    d = mujoco.MjData(m)
    d.qpos[:] = q0
    per_tick = round(1e-3 / timestep)
    out = []
    for tick in range(100):
        d.ctrl[:] = amplitude * np.sin(w * tick * 1e-3)
        mujoco.mj_step(m, d, nstep=per_tick)
        if tick + 1 in (20, 50, 100):
            out.append(dict(t=(tick + 1) * 1e-3, q=d.qpos.tolist(), dq=d.qvel.tolist()))
    return out


def main():
    random.seed(5)
    cases = []
    for kind in range(6):
        coulomb = COULOMB if kind % 3 != 1 else 0.0
        viscous = VISCOUS if kind % 3 != 2 else 0.0
        armature = reflected_rotors() if kind % 3 != 2 else [0.0] * 7
        q0 = np.array([random.uniform(-1.2, 1.2) for _ in range(7)])
        amplitude = np.array([random.uniform(-1, 1) * s for s in (40, 60, 40, 40, 10, 10, 4)])
        w = np.array([random.uniform(20, 60) for _ in range(7)])
        last, change = None, math.inf
        for step in (1e-5, 5e-6, 2.5e-6, 1.25e-6):
            record = simulate(q0, amplitude, w, step, coulomb, viscous, armature)
            before, last = last, np.array(record[-1]["q"])
            if before is not None:
                change = float(np.abs(last - before).max())
            if change < 1e-5:
                break
        print(f"case {kind}: coulomb {coulomb} viscous {viscous} armature {sum(armature):.2f}: step {step}, moved by {change:.2e} rad, travel {np.abs(last - q0).max():.3f} rad")
        cases.append(
            dict(
                q0=q0.tolist(), A=amplitude.tolist(), w=w.tolist(), coulomb=coulomb, viscous=viscous,
                armature=armature, timestep=step, halving_moved_rad=change, rec=record,
            )
        )
    note = "tau = A sin(w t) at 1 kHz zero-order hold from rest; default tool (1.5 kg, com 25,0,50 mm); gravity -9.81 z"
    (DATA / "ref_friction.json").write_text(
        json.dumps(dict(source=f"MuJoCo {mujoco.__version__}, tests/python/mujoco_oracle.py", note=note, traj=cases), indent=1)
    )


main()
