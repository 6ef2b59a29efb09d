"""Robots: forward kinematics, Jacobian, inverse kinematics."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _native
from ._arrays import floats, joints, vector
from .errors import refuse

Floats = NDArray[np.float64]


class Robot:
    """A robot with its tool.

    ``source`` is a built-in name (:data:`spherecal.BUILT_IN`), the path of a ``.toml``, ``.urdf`` or
    ``.yaml`` file (``FILE.urdf#TIP`` or ``FILE.urdf#BASE:TIP`` for the chain to or
    between these links), or the text of a URDF or TOML.
    ``tool`` is the TCP in the flange frame, in m; without it, that of the source.

    Frames: the *root* frame is the first frame of the file (``frame_names[0]``); the TCP's axes are
    those of the flange frame (``frame_names[1]``). Angles are in rad, lengths in m. A joint that slides has a
    position in m, and one that follows another has none of its own: such a robot can be identified, and has
    no inverse kinematics here.

    >>> robot = Robot("ur5e", tool=(0, 0, 0.1))
    >>> robot.name, robot.joints
    ('ur5e', 6)
    >>> robot.fk(np.zeros((2, 6))).shape
    (2, 4, 4)
    """

    def __init__(self, source: str | os.PathLike[str], *, tool: ArrayLike | None = None) -> None:
        if isinstance(source, os.PathLike):
            source = os.fspath(source)
        if not isinstance(source, str):
            raise refuse("robot", repr(source), "give a built-in name, a path, or the text of a URDF or TOML")
        if source.lstrip().startswith("<"):
            native = _native.NativeRobot.from_urdf(source, None)
        elif "\n" in source:
            native = _native.NativeRobot.from_toml(source)
        else:
            native = _native.NativeRobot.load(source)
        self._native = native if tool is None else native.with_tool(vector("tool", tool, "m (flange frame)"))

    @classmethod
    def _of(cls, native: _native.NativeRobot) -> Robot:
        robot = cls.__new__(cls)
        robot._native = native
        return robot

    @classmethod
    def from_urdf(cls, text: str, *, tip: str | None = None, tool: ArrayLike | None = None) -> Robot:
        """A robot from the text of a URDF; ``tip`` is the last link (default: the longest chain)."""
        robot = cls._of(_native.NativeRobot.from_urdf(text, tip))
        return robot if tool is None else robot.with_tool(tool)

    @classmethod
    def from_toml(cls, text: str, *, tool: ArrayLike | None = None) -> Robot:
        """A robot from TOML text, such as that of :meth:`to_toml`."""
        robot = cls._of(_native.NativeRobot.from_toml(text))
        return robot if tool is None else robot.with_tool(tool)

    def with_tool(self, tool: ArrayLike) -> Robot:
        """The same robot with the TCP at ``tool``, in m in the flange frame."""
        return Robot._of(self._native.with_tool(vector("tool", tool, "m (flange frame)")))

    def __repr__(self) -> str:
        # To the nanometre: the digits after it differ from processor to processor when the tool was identified.
        tool = tuple(round(float(v), 9) for v in self.tool)
        return f"Robot({self.name!r}, joints={self.joints}, tool={tool})"

    def __eq__(self, other: object) -> bool:
        """Whether every length, angle, mass, limit and name is the same, and the tool."""
        return self.to_toml() == other.to_toml() if isinstance(other, Robot) else NotImplemented

    def __hash__(self) -> int:
        return hash(self.to_toml())

    def __reduce__(self) -> tuple[object, tuple[str]]:
        # For pickle and copy, and so for joblib and multiprocessing. Links and meshes of a URDF's file do not go along.
        return Robot.from_toml, (self.to_toml(),)

    @property
    def name(self) -> str:
        """Name of the robot."""
        return self._native.name

    @property
    def joints(self) -> int:
        """Number of joints."""
        return self._native.joints

    @property
    def joint_names(self) -> list[str]:
        """Names of the joints, base to flange; empty where nobody named them."""
        return self._native.joint_names

    @property
    def frame_names(self) -> tuple[str, str]:
        """Names of the root frame and of the flange frame."""
        return self._native.frame_names

    @property
    def tool(self) -> list[float]:
        """TCP in the flange frame, in m."""
        return self._native.tool

    @property
    def limits(self) -> Floats:
        """Least and greatest position of each joint, in rad (m of one that slides): (joints, 2)."""
        return self._native.limits

    @property
    def mdh(self) -> Floats:
        """Modified DH table, a row a joint: alpha, a, beta, theta, d (rad, m): (joints, 5)."""
        return self._native.mdh

    def fk(self, q: ArrayLike) -> Floats:
        """Frames of the TCP in the root frame.

        ``q`` has shape (N, joints) and gives (N, 4, 4); shape (joints,) gives (4, 4).

        >>> Robot("iiwa14").fk(np.zeros(7))[:3, 3].round(4).tolist()
        [0.0, 0.0, 1.306]
        """
        rows, single = joints("q", q, self.joints)
        frames = self._native.fk(rows)
        return frames[0] if single else frames

    def jacobian(self, q: ArrayLike) -> Floats:
        """Jacobians of the TCP in the root frame: velocity (m/rad), then angular velocity (rad/rad).

        (N, joints) gives (N, 6, joints); (joints,) gives (6, joints).

        >>> robot, q = Robot("fr3"), np.array([0.1, -0.3, 0.2, -1.8, 0.4, 1.6, 0.5])
        >>> step = np.full(7, 1e-6)
        >>> moved = robot.fk(q + step)[:3, 3] - robot.fk(q - step)[:3, 3]
        >>> np.allclose(robot.jacobian(q)[:3] @ (2 * step), moved, atol=1e-12)
        True
        """
        rows, single = joints("q", q, self.joints)
        jacobians = self._native.jacobian(rows)
        return jacobians[0] if single else jacobians

    def ik(self, pose: ArrayLike, *, near: ArrayLike | None = None) -> Floats:
        """Joint angles (joints,) that bring the TCP to ``pose`` (4 x 4, root frame), within the limits.

        With ``near``, the solution that damped Newton steps reach from there, else the nearest one that
        is found; without it, the one nearest to the middle of the limits. A robot of seven joints
        keeps its elbow near ``near``. Position and rotation are met to 1e-11 m and rad.
        Raises :class:`spherecal.Unreachable`.

        >>> robot, q = Robot("iiwa7"), np.array([0.2, 0.5, -0.1, -1.2, 0.3, 0.9, 0.0])
        >>> found = robot.ik(robot.fk(q), near=q + 0.05)
        >>> np.allclose(robot.fk(found), robot.fk(q), atol=1e-9)
        True
        """
        start = None if near is None else floats("near", near)
        if start is not None and start.ndim != 1:
            raise refuse("near", f"an array of shape {start.shape}", f"give shape ({self.joints},), in rad")
        return np.array(self._native.ik(self._pose(pose), start))

    def ik_all(self, pose: ArrayLike) -> Floats:
        """All solutions that are found within the joint limits: (K, joints); K is 0 out of reach.

        For seven joints, the solutions with the elbow angle zero.
        """
        return self._native.ik_all(self._pose(pose))

    @staticmethod
    def _pose(pose: ArrayLike) -> Floats:
        array = floats("pose", pose)
        if array.ndim != 2:
            raise refuse("pose", f"an array of shape {array.shape}", "give a homogeneous matrix of shape (4, 4)")
        return array

    def to_toml(self) -> str:
        """The robot as TOML, which reads back to the same bits."""
        return self._native.to_toml()

    def to_urdf(self) -> str:
        """The robot as URDF; a robot from a URDF keeps its links, meshes and names."""
        return self._native.to_urdf()

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the robot as ``.toml`` or ``.urdf``, by the ending of ``path``."""
        file = Path(path)
        writers = {".toml": self.to_toml, ".urdf": self.to_urdf}
        if file.suffix.lower() not in writers:
            raise refuse("path", file, "end it with .toml or .urdf")
        file.write_text(writers[file.suffix.lower()](), encoding="utf-8")
