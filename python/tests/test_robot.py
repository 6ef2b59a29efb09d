"""Robots: kinematics against an independent reference, text, refusals."""

import copy
import json
import pickle

import numpy as np
import pytest

import spherecal
from spherecal import Robot


# Fails if the TCP's frame differs from an independent NumPy formulation by more than 1e-12 m.
@pytest.mark.parametrize(("case", "tool"), [("nominal_flange", (0, 0, 0)), ("nominal_tool", (0.05, 0, 0.1))])
def test_fk_is_that_of_the_reference(data, case, tool):
    reference = json.loads((data / "reference_kinematics.json").read_text())
    q = np.array([c["q"] for c in reference["configs"]])
    frames = Robot("iiwa7", tool=tool).fk(q)
    assert frames.shape == (10, 4, 4)
    for frame, config in zip(frames, reference["configs"]):
        wanted = config[case]
        np.testing.assert_allclose(frame[:3, 3] * 1e3, wanted["tcp_mm"], atol=1e-9, rtol=0)
        np.testing.assert_allclose(frame[:3, :3], wanted["R"], atol=1e-12, rtol=0)
        assert frame[3].tolist() == [0, 0, 0, 1]


# Fails if the frames of a URDF are not those of the built-in arm of the same make: the flange or
# the base frame of the file would be lost.
def test_a_urdf_and_the_built_in_robot_agree(data):
    q = np.random.default_rng(1).uniform(-1.5, 1.5, (50, 7))
    file, built_in = Robot(data / "iiwa7.urdf"), Robot("iiwa7", tool=(0, 0, 0))
    np.testing.assert_allclose(file.fk(q), built_in.fk(q), atol=2e-6)


# Fails if a robot that went through pickle or copy is another one, or if two different robots are equal.
@pytest.mark.parametrize("source", ["ur5e", "iiwa14.urdf"])
def test_a_robot_is_copied_and_compared(data, source):
    robot = Robot(data / source if "." in source else source, tool=(0.01, -0.02, 0.1))
    q = np.random.default_rng(3).uniform(-1, 1, (20, robot.joints))
    for again in (pickle.loads(pickle.dumps(robot)), copy.deepcopy(robot)):
        assert again == robot and hash(again) == hash(robot)
        np.testing.assert_array_equal(again.fk(q), robot.fk(q))
    assert robot != robot.with_tool((0, 0, 0)) and robot != source


# Fails if the Jacobian is not the derivative of the frames, in a file with a base of its own.
@pytest.mark.parametrize("name", ["iiwa14.urdf", "panda.urdf", "ur5e.urdf"])
def test_the_jacobian_is_the_derivative(data, name):
    robot = Robot(data / name, tool=(0.01, -0.02, 0.1))
    q = np.random.default_rng(2).uniform(-1, 1, robot.joints)
    jacobian = robot.jacobian(q)
    step = 1e-6
    for k in range(robot.joints):
        d = np.zeros(robot.joints)
        d[k] = step
        after, before = robot.fk(q + d), robot.fk(q - d)
        np.testing.assert_allclose(jacobian[:3, k], (after[:3, 3] - before[:3, 3]) / (2 * step), atol=1e-8)
        turn = (after[:3, :3] - before[:3, :3]) @ robot.fk(q)[:3, :3].T / (2 * step)
        np.testing.assert_allclose(jacobian[3:, k], [turn[2, 1], turn[0, 2], turn[1, 0]], atol=1e-8)


# Fails if a solution misses its pose or leaves the limits, for any built-in arm.
@pytest.mark.parametrize("name", spherecal.BUILT_IN)
def test_ik_meets_the_pose(name):
    robot = Robot(name, tool=(0.0, 0.03, 0.12))
    low, high = robot.limits.T
    for share in np.random.default_rng(3).uniform(0.3, 0.7, (10, robot.joints)):
        q = low + share * (high - low)
        found = robot.ik(robot.fk(q), near=q + 0.02)
        np.testing.assert_allclose(robot.fk(found), robot.fk(q), atol=1e-10)
        assert ((found >= low) & (found <= high)).all()
        np.testing.assert_allclose(robot.fk(robot.ik(robot.fk(q))), robot.fk(q), atol=1e-10)


# Fails if a robot does not read back from its own text.
def test_text_reads_back(data):
    robot = Robot(data / "fr3.urdf", tool=(0, 0, 0.1034))
    q = np.random.default_rng(4).uniform(-1, 1, (5, robot.joints))
    np.testing.assert_allclose(Robot(robot.to_toml()).fk(q), robot.fk(q), atol=1e-15)
    np.testing.assert_allclose(Robot(robot.to_urdf(), tool=robot.tool).fk(q), robot.fk(q), atol=1e-12)


# Fails if a pose out of reach gives angles, or another exception.
def test_a_pose_out_of_reach_is_refused():
    far = np.eye(4)
    far[0, 3] = 3.0
    with pytest.raises(spherecal.Unreachable, match=r"3\.0000"):
        Robot("ur10e").ik(far)
    assert Robot("ur10e").ik_all(far).shape == (0, 6)


# Fails if one of these is taken, or its message does not name the field and what to do.
@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: Robot("ur5ee"), r'"ur5ee" is neither built in nor a file: did you mean ur5e\? Else give one of iiwa7'),
        (lambda: Robot("missing.urdf"), "missing.urdf"),
        (lambda: Robot(7), "robot is 7: give a built-in name"),
        (lambda: Robot("<robot"), "urdf text"),
        (lambda: Robot("name = 1\n"), "toml text"),
        (lambda: Robot("ur5e", tool=(0, 0)), "tool is .*three finite numbers"),
        (lambda: Robot("ur5e", tool=(0, 0, float("nan"))), "tool is .*three finite numbers"),
        (lambda: Robot("ur5e").fk(np.zeros(7)), r"q is an array of shape \(7,\): the robot has 6 joints"),
        (lambda: Robot("ur5e").fk([[1, 2], [3]]), "q is no array of real numbers"),
        (lambda: Robot("ur5e").fk(np.zeros(6, dtype=complex)), "q is no array of real numbers"),
        (lambda: Robot("ur5e").fk([0, 0, float("nan"), 0, 0, 0]), r"q\[0, 2\] is NaN: give finite"),
        (lambda: Robot("ur5e").ik(np.eye(3)), r"pose is .*shape \(4, 4\)"),
        (lambda: Robot("ur5e").ik(np.full((4, 4), np.nan)), "pose is not finite"),
        (lambda: Robot("ur5e").ik(np.diag([1, 1, -1, 1.0])), "right-handed"),
        (lambda: Robot("ur5e").ik(np.diag([2, 1, 1, 1.0])), "rotation"),
        (lambda: Robot("ur5e").ik(np.ones((4, 4))), "last row"),
        (lambda: Robot("ur5e").ik(np.eye(4), near=np.zeros(5)), "near is .*6 finite angles"),
        (lambda: Robot("ur5e").save("robot.txt"), "end it with .toml or .urdf"),
    ],
)
def test_what_cannot_be_used_is_refused(call, words):
    with pytest.raises(spherecal.InputError, match=words):
        call()


# Fails if the hierarchy changes: programs catch these classes.
def test_exceptions_have_their_classes():
    for error in (spherecal.InputError, spherecal.Refused, spherecal.Unreachable, spherecal.JobFailed):
        assert issubclass(error, spherecal.SpherecalError)
    with pytest.raises(ValueError, match="neither built in") as caught:
        Robot("ur5ee")
    assert (caught.value.field, caught.value.value) == ("robot", "ur5ee")
