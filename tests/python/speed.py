"""Our plant against MuJoCo's mj_step, and our arm against Pinocchio, in one run on one core.

    scripts/speed       builds what is compared, and calls this

Both sides are timed in turn, several times over, and the least of each counts,
so that a loaded machine does as little harm as it can. Prints JSON:

* plant: a seated sub-step of 0.25 ms, three pads of a cube corner on a sphere,
  pulled on by the magnet, without and with dry friction in the joints (a tick of
  our plant is four sub-steps); a free step of 1 ms is our Runge-Kutta against
  MuJoCo's of 0.25 ms, so our four accelerations stand against its one;
* arm: frames, Jacobian, gravity and mass matrix of the iiwa 7 (Pinocchio's C++,
  header only, at -O3, as rustc also compiles for any x86-64).

Fails where a seated step takes more than half of MuJoCo's.
"""
import json
import subprocess
import sys

from mujoco_model import TOOL, rows

ROUNDS = 5
CASES = {
    "free": "plant: free, ideal",
    "seated": "plant: seated, ideal",
    "seated_friction": "plant: seated, joint friction",
}


def ours(program, case):
    out = subprocess.run([program, "--time", case], check=True, stdout=subprocess.PIPE, text=True).stdout
    return float(out)


def arm_rows():
    """The arm and its tool, as pinocchio_speed.cpp reads them."""
    lines = []
    for row in rows():
        lines.append([row["alpha"], row["a"], row["d"], row["mass"], *row["com"], *row["inertia"]])
    lines.append([0, 0, 0, TOOL["mass"], *TOOL["com"], *TOOL["inertia"], 0, 0, 0])
    return "\n".join(" ".join(repr(float(v)) for v in line) for line in lines) + "\n"


def main(program, pinocchio):
    least = {}

    def keep(name, value):
        least[name] = min(value, least.get(name, float("inf")))

    try:
        import mujoco

        from mujoco_speed import timed
    except ImportError:
        mujoco = None
    for _ in range(ROUNDS):
        for name, case in CASES.items():
            keep(f"our {name}", ours(program, case) / 4e3)
            if mujoco:
                seated, coulomb = name != "free", 0.1 if name.endswith("friction") else 0.0
                keep(f"mujoco {name}", timed(seated, coulomb, steps=4_000, rounds=1)[0])
        for part, case in [("kinematics", "arm: FK and Jacobian"), ("all", "arm: FK, Jacobian, gravity and mass matrix")]:
            keep(f"our {part}", ours(program, case))
        keep("our loop", ours(program, "loop: controller, links and plant") / 1e3)
        if pinocchio:
            out = subprocess.run([pinocchio], input=arm_rows(), check=True, stdout=subprocess.PIPE, text=True).stdout
            for name, value in json.loads(out).items():
                keep(f"pinocchio {name}", value)
            gravity = float(subprocess.run([program, "--gravity"], check=True, stdout=subprocess.PIPE, text=True).stdout)
            if abs(gravity - least["pinocchio gravity2_nm"]) > 1e-9:
                sys.exit(f"not the same arm: gravity at joint 2 is {gravity} and {least['pinocchio gravity2_nm']} N m")
    result = {"loop": {"us_per_tick": least["our loop"], "real_time_factor": 1e3 / least["our loop"]}}
    if mujoco:
        result["plant, us a step"] = {
            name: {
                "ours": round(least[f"our {name}"], 3),
                "mujoco": round(least[f"mujoco {name}"], 3),
                "ratio": round(least[f"our {name}"] / least[f"mujoco {name}"], 3),
            }
            for name in CASES
        } | {"mujoco version": mujoco.__version__}
    if pinocchio:
        result["arm, ns"] = {
            part: {
                "ours": least[f"our {part}"],
                "pinocchio": least[f"pinocchio {part}"],
                "ratio": round(least[f"our {part}"] / least[f"pinocchio {part}"], 3),
            }
            for part in ("kinematics", "all")
        }
    print(json.dumps(result, indent=2))
    if mujoco:
        slow = [n for n in ("seated", "seated_friction") if result["plant, us a step"][n]["ratio"] > 0.5]
        if slow:
            sys.exit(f"more than half of MuJoCo's time: {', '.join(slow)}")


main(*sys.argv[1:3])
