"""MuJoCo as a drive of spherecal: an iiwa 7 that touches spheres, with no plant of ours.

    pip install mujoco
    python3 mujoco_drive.py 7401
    spherecal run --link tcp:127.0.0.1:7401 --poses 12 --out mujoco-out

The arm is built from tests/data/iiwa7.json (its sources are inside), the plate
is spherecal's default one. The nest is three boxes whose faces are tangent to a
seated sphere, the magnet a pull 26.5 N / (1 + gap / 1 mm)^2 at its pole. The
sensors are ideal and the geometry is nominal: the calibration should find
nothing, which is a check of its own. What is touched, and how hard, is printed.
"""

import math
import pathlib
import sys

try:
    import mujoco
    import numpy as np
except ImportError:
    sys.exit("this example needs MuJoCo: pip install mujoco")

from drive_server import PERIOD_US, arguments, serve

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "tests" / "python"))
from mujoco_model import TOOL, model, numbers, rows  # noqa: E402

RADIUS = 0.0254  # of a sphere, m
MAGNET_N, MAGNET_SCALE, MAGNET_RANGE = 26.5, 1e-3, 0.02
TIMESTEP = 2.5e-4
# Home of the default plan: over the middle of the plate.
START = [0.0, 0.30669, 0.0, -1.20241, 0.0, 1.63250, 0.0]
# min rad, max rad, rad/s, N m: the iiwa 7 R800's.
LIMITS = [
    [-math.radians(a), math.radians(a), math.radians(v), t]
    for a, v, t in zip(
        (170, 120, 170, 120, 170, 120, 175), (98, 98, 100, 130, 140, 180, 180), (176, 176, 110, 110, 110, 40, 40)
    )
]
# The default plate: its three spheres in the plate's frame, turned by 150 degrees,
# their middle at (470, 0, 320) mm.
PLATE = [(0.0, 0.0), (0.300009, 0.0), (0.150049, 0.260051)]


def spheres():
    cosine, sine = math.cos(math.radians(150)), math.sin(math.radians(150))
    turned = [(cosine * x - sine * y, sine * x + cosine * y) for x, y in PLATE]
    middle = [sum(axis) / 3 for axis in zip(*turned)]
    return [(0.470 + x - middle[0], y - middle[1], 0.320) for x, y in turned]


def mjcf():
    # Eight steps of time constant: a harder contact chatters, with joint speeds of 10 mrad/s that move nothing.
    stiff = 'friction="0.15" solref="0.002 1"'
    pads = ""
    for k in range(3):
        phi = 2 * math.pi * k / 3
        side, depth = math.sqrt(2 / 3), -math.sqrt(1 / 3)
        u = (side * math.cos(phi), side * math.sin(phi), depth)
        centre = [t + (RADIUS + 0.004) * x for t, x in zip(TOOL["tcp"], u)]
        pads += f'<geom name="pad{k}" type="box" size="0.014 0.014 0.004" pos="{numbers(centre)}" zaxis="{numbers(u)}" mass="0" {stiff}/>\n'
    balls = "".join(
        f'<geom name="sphere{k + 1}" type="sphere" size="{RADIUS}" pos="{numbers(p)}" {stiff}/>\n'
        for k, p in enumerate(spheres())
    )
    text = model(rows(), TIMESTEP, "implicitfast")
    return text.replace('<site name="tcp"', pads + '<site name="tcp"').replace("<worldbody>", "<worldbody>" + balls)


class Arm:
    """The arm in MuJoCo, as drive_server.py wants it."""

    def __init__(self):
        self.model = mujoco.MjModel.from_xml_string(mjcf())
        self.data = mujoco.MjData(self.model)
        self.data.qpos[:] = START
        mujoco.mj_forward(self.model, self.data)
        self.tool = self.model.body("tool").id
        self.centres = [np.array(p) for p in spheres()]
        self.tau = self.data.qfrc_bias.tolist()  # at rest: gravity
        self.touched, self.ticks, self.peak = None, 0, 0.0
        self.read()

    def read(self):
        self.q, self.dq = self.data.qpos.tolist(), self.data.qvel.tolist()

    def pull(self):
        """The magnet on the tool."""
        site = self.data.site("tcp")
        pole = site.xpos - site.xmat.reshape(3, 3)[:, 2] * RADIUS
        wrench = np.zeros(6)
        for centre in self.centres:
            line = centre - pole
            distance = np.linalg.norm(line)
            gap = distance - RADIUS
            if gap < MAGNET_RANGE:
                force = line / max(distance, 1e-6) * MAGNET_N / (1 + max(gap, 0.0) / MAGNET_SCALE) ** 2
                wrench[:3] += force
                wrench[3:] += np.cross(pole - self.data.xipos[self.tool], force)
        self.data.xfrc_applied[self.tool] = wrench

    def step(self, tau, seconds):
        self.tau = [max(-limit[3], min(limit[3], torque)) for torque, limit in zip(tau, LIMITS)]
        self.data.ctrl[:] = self.tau
        for _ in range(round(seconds / TIMESTEP)):
            self.pull()
            mujoco.mj_step(self.model, self.data)
        self.read()
        self.watch()

    def brake(self):
        self.data.qvel[:] = 0.0
        mujoco.mj_forward(self.model, self.data)
        self.tau = self.data.qfrc_bias.tolist()
        self.read()

    def watch(self):
        """Tells when the nest touches a sphere and when it has left it."""
        self.ticks += 1
        touching, force = set(), np.zeros(6)
        for k in range(self.data.ncon):
            names = [self.model.geom(g).name for g in self.data.contact[k].geom]
            touching.update(name for name in names if name.startswith("sphere"))
            mujoco.mj_contactForce(self.model, self.data, k, force)
            self.peak = max(self.peak, force[0])
        sphere = min(touching, default=None)
        if sphere and sphere != self.touched:
            print(f"{self.ticks * PERIOD_US * 1e-6:8.3f} s  {sphere} touched", flush=True)
            self.touched, self.peak = sphere, 0.0
        elif not sphere and self.touched:
            centre = self.centres[int(self.touched[-1]) - 1]
            if np.linalg.norm(self.data.site("tcp").xpos - centre) > 0.03:
                seconds = self.ticks * PERIOD_US * 1e-6
                print(f"{seconds:8.3f} s  {self.touched} left; largest force of a pad {self.peak:.1f} N", flush=True)
                self.touched = None


if __name__ == "__main__":
    serve(Arm(), LIMITS, arguments("MuJoCo on spherecal's drive link").parse_args())
