"""Corrects joint commands for a controller that keeps its nominal model.

    python compensator.py calibrated.toml 0.3 0.6 -0.2 -1.2 0.4 0.9 0.1

It needs Python 3.11 and numpy, nothing of spherecal: copy it into your controller.
docs/compensate.md has the formula.
"""

import sys
import tomllib

import numpy as np

GRAVITY = 9.81  # m/s^2
CLOSE = 1e-9  # m and rad that may be left
MOST = 0.2  # rad: a larger correction is no error of a robot, but a singular posture


class Unreachable(ValueError):
    """The real robot does not reach the pose near the commanded posture."""


def _frames(rows, q):
    """Poses (4, 4) of the frames in F0, base to flange, of a modified DH table."""
    frame, frames = np.eye(4), []
    for alpha, a, beta, theta, d, angle in zip(
        rows["alpha_rad"], rows["a_m"], rows["beta_rad"], rows["theta_rad"], rows["d_m"], q, strict=True
    ):
        (sa, ca), (sb, cb) = (np.sin(alpha), np.cos(alpha)), (np.sin(beta), np.cos(beta))
        s, c = np.sin(theta + angle), np.cos(theta + angle)
        fixed = np.array([[cb, 0, sb], [sa * sb, ca, -sa * cb], [-ca * sb, sa, ca * cb]])
        link = np.eye(4)
        link[:3, :3] = fixed @ [[c, -s, 0], [s, c, 0], [0, 0, 1]]
        link[:3, 3] = fixed[:, 2] * d + [a, 0, 0]
        frame = frame @ link
        frames.append(frame)
    return frames


def _point(frame, p):
    return frame[:3, :3] @ p + frame[:3, 3]


class Compensator:
    """The nominal and the calibrated robot of a ``calibrated.toml``."""

    def __init__(self, path):
        with open(path, "rb") as file:
            self.full = tomllib.load(file)["calibration"]
        self.nominal = self.full["nominal"]

    def nominal_pose(self, q):
        """TCP (m) and flange (4, 4) of the controller's own model in F0."""
        flange = _frames(self.nominal, q)[-1]
        return _point(flange, np.array(self.nominal["tcp_m"])), flange

    def _load(self, q):
        """Moments (N m) that hold the joints, each in its frame's axes, and the base."""
        mass, moment, joints = 0.0, np.zeros(3), []
        up = np.array([0.0, 0.0, GRAVITY])
        frames = _frames(self.nominal, q)
        for frame, m, com in zip(reversed(frames), reversed(self.nominal["mass_kg"]), reversed(self.nominal["com_m"])):
            mass += m
            moment = moment + m * _point(frame, np.array(com))
            joints.append(frame[:3, :3].T @ np.cross(moment - mass * frame[:3, 3], up))
        return joints[::-1], np.cross(moment, up)

    def tcp(self, q):
        """TCP (m, F0) of the real robot where its encoders read ``q`` (rad), by the full model."""
        q = np.asarray(q, float)
        joints, base = self._load(q)
        angles = q.copy()
        for j, waves in enumerate(self.full["harmonics_rad"]):
            angles[j] -= self.full["compliance_rad_per_nm"][j] * joints[j][2]
            for order, (cosine, sine) in enumerate(waves, 1):
                angles[j] += cosine * np.cos(order * q[j]) + sine * np.sin(order * q[j])
        frames = _frames(self.full, angles)
        rigid = _point(frames[-1], np.array(self.full["tcp_m"]))
        tcp = rigid.copy()
        for frame, moment, (x, y) in zip(frames, joints, self.full["bending_rad_per_nm"], strict=True):
            turn = -x * moment[0] * frame[:3, 0] - y * moment[1] * frame[:3, 1]
            tcp += np.cross(turn, rigid - frame[:3, 3])
        x, y = self.full["tilt_rad_per_nm"]
        return tcp + np.cross([-x * base[0], -y * base[1], 0.0], rigid)

    def command(self, nominal):
        """The command (rad) with which the real robot reaches the controller's pose at ``nominal``."""
        nominal = np.asarray(nominal, float)
        if nominal.shape != (len(self.full["alpha_rad"]),) or not np.isfinite(nominal).all():
            raise ValueError(f"give one finite angle for each of the {len(self.full['alpha_rad'])} joints")
        wanted, flange = self.nominal_pose(nominal)
        q = nominal.copy()
        for _ in range(20):
            frames = _frames(self.full, q)
            tcp = self.tcp(q)
            r = flange[:3, :3] @ frames[-1][:3, :3].T
            turn = np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]]) / 2
            off = np.concatenate([wanted - tcp, turn])
            if np.linalg.norm(off[:3]) < CLOSE and np.linalg.norm(off[3:]) < CLOSE:
                return q
            jacobian = np.array([[*np.cross(f[:3, 2], tcp - f[:3, 3]), *f[:3, 2]] for f in frames]).T
            square = jacobian @ jacobian.T
            square += 1e-9 * square.diagonal().max() * np.eye(6)
            q = q + jacobian.T @ np.linalg.solve(square, off)
            if not (np.abs(q - nominal) <= MOST).all():
                break
        raise Unreachable("the real robot does not reach its pose near this posture: keep away from singular postures")


if __name__ == "__main__":
    compensator = Compensator(sys.argv[1])
    angles = np.array([float(word) for word in sys.argv[2:]])
    print("command (rad):", *compensator.command(angles))
    off = np.linalg.norm(compensator.tcp(angles) - compensator.nominal_pose(angles)[0])
    print(f"without it the TCP would be {off * 1e3:.3f} mm off")
