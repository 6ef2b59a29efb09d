"""`identify`: the numbers of the command, what the result says, refusals."""

import copy
import pickle
import subprocess
import sys

import numpy as np
import pytest
from conftest import DATA, same, summary_of

import spherecal
from spherecal import Robot

SOCKETS_TOML = DATA.parents[1] / "host" / "crates" / "identify" / "examples" / "sockets.toml"


@pytest.fixture(scope="module")
def contacts(mukca):
    """The calibration of the public data."""
    return spherecal.identify(**mukca)


def simulated(rows, seed=5, noise=2e-5):
    """A UR5e whose second link is 0.4 mm longer and whose fourth encoder is 1 mrad off, and its points."""
    nominal = Robot("ur5e", tool=(0.02, 0, 0.12))
    text = nominal.to_toml()
    real = Robot(_with(text, nominal))
    rng = np.random.default_rng(seed)
    q = rng.uniform(-2, 2, (rows, 6))
    return nominal, real, q, real.fk(q)[:, :3, 3] + rng.normal(0, noise, (rows, 3))


def _with(text, nominal):
    # Row 3 of the table holds the length of link 2, row 4 the angle of joint 4.
    parts = text.split("[[joint]]")
    mdh = nominal.mdh
    for part, name, value, error in [(3, ", a", mdh[2, 1], 4e-4), (4, "theta", mdh[3, 3], 1e-3)]:
        before = f"{name} = {float(value)!r}"
        assert before in parts[part]
        parts[part] = parts[part].replace(before, f"{name} = {float(value) + error!r}", 1)
    return "[[joint]]".join(parts)


# Fails if Python's arrays take another path than the table of the command: any number of the
# summary, or the calibrated files, would differ by more than 1e-12.
def test_contacts_give_the_numbers_of_the_command(mukca, contacts, command, tmp_path):
    ran = command(
        "identify", "--robot", mukca["robot"], "--data", DATA / "mukca_iiwa14.csv", "--plate", SOCKETS_TOML,
        "--out", tmp_path,
    )  # fmt: skip
    assert ran.returncode == (0 if contacts.verdict.may_be_used else 3), ran.stderr
    theirs = summary_of(tmp_path)
    same(contacts.summary, theirs)
    assert len(contacts.parameters) == len(theirs["parameters"]) > 30
    assert contacts.to_toml() == (tmp_path / "calibrated.toml").read_text()
    assert contacts.to_urdf() == (tmp_path / "calibrated.urdf").read_text()
    assert contacts.to_kinematics_yaml() == (tmp_path / "kinematics.yaml").read_text()
    assert contacts.to_offsets_yaml() == (tmp_path / "offsets.yaml").read_text()


# The same for measured points, in m here and in mm there.
def test_points_give_the_numbers_of_the_command(command, tmp_path):
    nominal, _, q, points = simulated(80)
    table = np.column_stack([q, points * 1e3])
    header = ",".join([*(f"q{k}" for k in range(1, 7)), "x_mm", "y_mm", "z_mm"])
    lines = [header, *(",".join(repr(float(v)) for v in row) for row in table)]
    (tmp_path / "poses.csv").write_text("\n".join(lines) + "\n")
    ran = command(
        "identify", "--robot", "ur5e", "--tool-mm", "20,0,120", "--data", tmp_path / "poses.csv", "--out", tmp_path,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr
    # The points as the command reads them: mm to m and back is not exact.
    found = spherecal.identify(q, points=points * 1e3 * 1e-3, robot=nominal)
    same(found.summary, summary_of(tmp_path))


# The same for two targets, of which the second was hidden in some rows, and for poses.
@pytest.mark.parametrize("poses", [False, True])
def test_targets_and_poses_give_the_numbers_of_the_command(command, tmp_path, poses):
    nominal, real, q, points = simulated(60)
    points = points * 1e3 * 1e-3
    turned = real.fk(q)[:, :3, :3]
    header = [f"q{k}" for k in range(1, 7)]
    if poses:
        header += ["x_m", "y_m", "z_m", *(f"r{i}{k}" for i in (1, 2, 3) for k in (1, 2, 3))]
        rows = np.column_stack([q, points, turned.reshape(-1, 9)])
        given = {"points": points, "orientations": turned}
    else:
        second = points + turned @ (-0.1, 0.05, 0.02)
        second[::7] = np.nan
        header += [f"{axis}{k}_m" for k in (1, 2) for axis in "xyz"]
        rows = np.column_stack([q, points, second])
        given = {"points": np.stack([points, second], axis=1)}
    cells = [",".join("" if np.isnan(v) else repr(float(v)) for v in row) for row in rows]
    (tmp_path / "poses.csv").write_text("\n".join([",".join(header), *cells]) + "\n")
    ran = command(
        "identify", "--robot", "ur5e", "--tool-mm", "20,0,120", "--data", tmp_path / "poses.csv", "--out", tmp_path,
    )  # fmt: skip
    assert ran.returncode in (0, 3), ran.stderr
    found = spherecal.identify(q, **given, robot=nominal)
    same(found.summary, summary_of(tmp_path))
    assert len(found.summary["targets"]) == (1 if poses else 2)


# Fails if the calibration does not bring the nominal robot to the true one.
def test_a_known_error_is_found_and_compensated():
    nominal, real, q, points = simulated(120)
    found = spherecal.identify(q, points=points, robot=nominal).require()
    assert found.verdict and found.expected_error.mean < 2e-4 < found.nominal_error.mean
    low, high = found.expected_error.interval
    assert 0 < low <= found.expected_error.mean <= high
    a2 = found.parameters["a2"]
    assert abs(a2.value - a2.nominal - 4e-4) < 4 * a2.sigma + 1e-5
    # A controller that keeps the nominal model aims at these poses.
    aim = np.random.default_rng(9).uniform(0.4, 1.2, (30, 6))
    wanted = nominal.fk(aim)[:, :3, 3]
    before = np.linalg.norm(real.fk(aim)[:, :3, 3] - wanted, axis=1).mean()
    commands = found.compensate(aim)
    after = np.linalg.norm(real.fk(commands)[:, :3, 3] - wanted, axis=1).mean()
    assert after < 0.15 * before, (before, after)
    # The formula: the full model's TCP at the command is the nominal one at the aim.
    np.testing.assert_allclose(found.predict(commands), wanted, atol=2e-9)
    assert np.abs(commands - aim).max() < 0.02


# Fails if a result, its verdict or its parameters say another thing than the command, or fill a screen; or if a notebook gets
# no headline, no file, or a figure that the summary does not have.
def test_results_show_their_headline():
    nominal, _, q, points = simulated(80)
    found = spherecal.identify(q, points=points, robot=nominal)
    headline = found.summary["verdict"]["headline"]
    assert headline in repr(found) and str(found).startswith(headline)
    page = found._repr_html_()
    assert headline.replace(">", "&gt;") in page
    for file in found.summary["files"]:
        assert file["name"] in page and f"{file['expected_error_mm']['mean']:.3f}" in page
    assert "OK to use" in repr(found.verdict) and len(repr(found.verdict)) < 100
    assert repr(found.parameters).startswith(f"<Parameters: {len(found.parameters)}, ")


# Fails if a copy says another thing or cannot compute, or if results of other data are
# equal.
def test_a_result_is_copied_and_compared():
    nominal, _, q, points = simulated(80)
    found = spherecal.calibrate(nominal, q, points)
    other = pickle.loads(pickle.dumps(found))
    assert other == found == copy.deepcopy(found)
    np.testing.assert_array_equal(other.predict(q), found.predict(q))
    assert found != spherecal.calibrate(nominal, q[:70], points[:70])


# Fails if the table is not that of the residuals, the file not the command's text, or the figure shows another mean.
def test_a_result_as_table_file_and_figure(contacts, tmp_path):
    frame = contacts.to_frame()
    np.testing.assert_array_equal(frame["distance_m"], contacts.residuals.distance)
    # One recording has one name: that of the remarks, which count rows from 1.
    listed = contacts.summary["residual"]["outlier_rows"]
    doubted = frame["name"][frame["deviation"] > 5]
    assert [entry["row"] for entry in listed] == list(doubted)
    assert frame["name"].iloc[0].startswith(f"row {frame['row'].iloc[0] + 1} (sphere ")
    contacts.save_urdf(tmp_path / "arm.urdf")
    assert (tmp_path / "arm.urdf").read_text() == contacts.to_urdf()
    before, _ = contacts.plot().axes
    widths = [bar.get_width() for bar in before.patches]
    files = {file["name"]: file["expected_error_mm"]["mean"] for file in contacts.summary["files"]}
    assert len(widths) == 1 + len(files) and set(files.values()) <= set(widths)


# Fails if a compensation is invented where the arm has no solution nearby.
def test_a_compensation_beyond_a_limit_is_refused():
    nominal, _, q, points = simulated(80)
    found = spherecal.identify(q, points=points, robot=nominal)
    stretched = np.array([0.3, -0.6, 0.0, 0.2, 0.0, 0.1])
    with pytest.raises(spherecal.Unreachable, match="row 1 of q_nominal"):
        found.compensate(np.vstack([stretched]))


# Fails if the parts of a result do not belong together.
def test_the_result_is_consistent(mukca, contacts):
    free = [p for p in contacts.parameters.values() if p.free]
    assert [p.name for p in free] == contacts.covariance_names
    np.testing.assert_allclose(np.sqrt(np.diag(contacts.covariance)), [p.sigma for p in free], rtol=1e-9)
    np.testing.assert_allclose(contacts.covariance, contacts.covariance.T, atol=1e-18)
    residuals = contacts.residuals
    rms = np.sqrt(np.mean(residuals.distance**2))
    assert abs(rms * 1e3 - contacts.summary["residual"]["rms_mm"]) < 1e-9
    assert residuals.row.max() < len(mukca["q"])
    sigma = contacts.predicted_sigma(mukca["q"])
    assert sigma.shape == (len(mukca["q"]),) and (sigma > 0).all()
    assert contacts.robot.joints == 7 and "mean" in str(contacts)
    assert {c.name for c in contacts.verdict.checks} and contacts.verdict.next
    if not contacts.verdict:
        with pytest.raises(spherecal.Refused, match="must not be used"):
            contacts.require()


# Fails if a result that must not be used passes `require`.
def test_require_refuses_a_result_that_must_not_be_used(mukca):
    few = {key: value[:40] if key in ("q", "sphere", "place") else value for key, value in mukca.items()}
    found = spherecal.identify(**few, accuracy=2e-6)
    assert not found.verdict.may_be_used and found.verdict.reasons
    with pytest.raises(spherecal.Refused, match="must not be used") as caught:
        found.require()
    assert caught.value.remedy == found.verdict.next


# Fails if the files are not those of the command.
def test_files_are_written(contacts, tmp_path):
    paths = contacts.write(tmp_path / "out")
    names = {"summary.json", "calibrated.toml", "calibrated.urdf", "kinematics.yaml", "offsets.yaml", "report.html"}
    assert {path.rsplit("/", 1)[-1] for path in paths} == names
    q = np.zeros((1, 7))
    np.testing.assert_allclose(Robot(tmp_path / "out" / "calibrated.toml").fk(q), contacts.robot.fk(q), atol=1e-15)


def _call(mukca, **changes):
    return lambda: spherecal.identify(**{**mukca, **changes})


# Fails if one of these is taken, or its message does not name the field and what to do.
def test_what_cannot_be_used_is_refused(mukca):
    q, n = mukca["q"], len(mukca["q"])
    bad = q.copy()
    bad[2, 1] = np.nan
    cases = [
        (_call(mukca, q=q[:, :6]), r"q is an array of shape \(180, 6\): give shape \(N, 7\), in rad"),
        (_call(mukca, q=q[0]), r"q is an array of shape \(7,\)"),
        (_call(mukca, q=q[:0]), "q is empty"),
        (_call(mukca, q=bad), "row 3, column q2 is NaN"),
        (_call(mukca, q=np.degrees(q)), "give rad: numpy.radians"),
        (_call(mukca, plate=None), "plate is missing: contacts with spheres give the robot no scale"),
        (_call(mukca, plate={1: (0, 0)}), r"plate is \{1: \(0, 0\)\}: give \{id"),
        (_call(mukca, plate={"a": (0, 0, 0)}), "plate is .*give {id"),
        (_call(mukca, plate={1: (0, 0, 0), 2: (0, 0, 0)}), "two spheres cannot be in the same place"),
        (_call(mukca, plate={1: (0, 0, 0, -1e-6), 2: (0.05, 0, 0)}), "sigma"),
        (_call(mukca, plate={1: (0, 0, 0)}), "sphere 2 is not on the plate"),
        (_call(mukca, plate="no such file.toml"), "no such file.toml"),
        (_call(mukca, sphere=None), "points and sphere is both missing"),
        (_call(mukca, points=np.zeros((n, 3))), "points and sphere is both given"),
        (_call(mukca, sphere=None, points=np.zeros((n, 2))), r"points is .*\(180, K, 3\) for K targets"),
        (_call(mukca, sphere=None, points=np.ones((n, 7, 3))), "at most 6|target"),
        (_call(mukca, orientations=np.zeros((n, 3, 3))), "orientations is given without points"),
        (_call(mukca, sphere=None, points=np.ones((n, 3)), orientations=np.zeros((n, 4))), r"orientations is .*\(180, 3, 3\)"),
        (_call(mukca, sphere=mukca["sphere"][:5]), r"sphere is an array of shape \(5,\)"),
        (_call(mukca, sphere=mukca["sphere"] * 1.5), "sphere is .*float64.*integer id"),
        (_call(mukca, place=["a", "b"]), "place is a list of 2: give one value for each of the 180 rows"),
        (_call(mukca, place=["a\nb"] * n), "without line breaks"),
        (_call(mukca, set=["train"] * n), "train"),
        (_call(mukca, tau=np.zeros((n, 3))), r"tau is an array of shape .*\(180, 7\), in N m"),
        (_call(mukca, robot="kr6"), "neither built in nor a file"),
        (_call(mukca, tool=(0, 0)), "tool is .*three finite numbers"),
        (_call(mukca, payload_com=(0, 0, 0)), "payload_com_mm is .*payload_kg|payload-kg"),
        (_call(mukca, payload_kg=-1.0), "payload_kg is -1"),
        (_call(mukca, method="best"), "method is \"best\".*full"),
        (_call(mukca, options="noise = 3\n"), "options"),
        (_call(mukca, options="[noise]\nseating_m = -1.0\n"), "seating_m is -1"),
        (_call(mukca, accuracy=1.0), "accuracy is 1.0: give a length in m"),
        (_call(mukca, seed=-1), "seed is -1"),
        (_call(mukca, holdout="operator"), "operator"),
        (_call(mukca, validate={"points": q[:, :3]}), "validate is .*give q"),
    ]  # fmt: skip
    for call, words in cases:
        with pytest.raises(spherecal.InputError, match=words):
            call()


# Fails if millimetres are taken as metres.
def test_points_in_mm_are_refused():
    nominal, _, q, points = simulated(60)
    with pytest.raises(spherecal.InputError, match="in m"):
        spherecal.identify(q, points=points * 1e3, robot=nominal)


# Fails if data of another robot give a result.
def test_data_of_another_robot_are_refused():
    _, _, q, points = simulated(60)
    with pytest.raises(spherecal.InputError, match="these are not data of this robot"):
        spherecal.identify(q, points=points, robot="ur10e")


# Fails if the work keeps the interpreter's lock: the other thread would not count.
def test_other_threads_run_meanwhile(tmp_path):
    script = (
        "import threading, spherecal, sys; sys.setswitchinterval(1e-4)\n"
        "count, end = [0], threading.Event()\n"
        "def work():\n"
        "    while not end.wait(0.001): count[0] += 1\n"
        "t = threading.Thread(target=work); t.start()\n"
        "import numpy as np; r = spherecal.Robot('ur5e'); q = np.random.default_rng(1).uniform(-2, 2, (200, 6))\n"
        "p = r.fk(q)[:, :3, 3] + np.random.default_rng(2).normal(0, 2e-5, (200, 3)); before = count[0]\n"
        "spherecal.identify(q, points=p, robot=r); print(count[0] - before); end.set(); t.join()\n"
    )
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=600, check=False, cwd=tmp_path)
    assert ran.returncode == 0, ran.stderr
    assert int(ran.stdout) > 5


def lifted(bend=0.0):
    """An arm on a lift; `bend` is an error of its origins, in m and rad."""
    kinds = [("lift", "prismatic", "0 0 1")]
    kinds += [(f"j{k}", "revolute", axis) for k, axis in enumerate(["0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0"], 1)]
    text = '<robot name="lifted"><link name="l0"/>'
    for k, (name, kind, axis) in enumerate(kinds):
        error = bend * (-1) ** k
        text += (
            f'<link name="l{k + 1}"/><joint name="{name}" type="{kind}"><origin xyz="{0.05 + error} 0.02 {0.25 - error}" '
            f'rpy="{error} 0 {2 * error}"/><parent link="l{k}"/><child link="l{k + 1}"/><axis xyz="{axis}"/>'
            '<limit lower="-2" upper="2" velocity="1" effort="10"/></joint>'
        )
    return text + "</robot>"


# Fails if a chain with a slide is refused, if kinematics or Jacobian of one are wrong, if its calibrated robot is further from
# the arm than 0.1 mm, or if what does not know slides takes it in silence.
def test_an_arm_on_a_lift_is_identified():
    nominal, real = (Robot(lifted(bend)).with_tool((0.02, 0.01, 0.12)) for bend in (0.0, 1e-3))
    assert nominal.joints == 7 and nominal.joint_names[0] == "lift"
    assert nominal.limits.shape == (7, 2)
    rng = np.random.default_rng(4)
    q = rng.uniform(-1.5, 1.5, (200, 7))
    points = real.fk(q)[:, :3, 3]
    step = 1e-6
    for k in range(7):
        moved = q[0] + step * np.eye(7)[k]
        assert np.allclose((real.fk(moved)[:3, 3] - points[0]) / step, real.jacobian(q[0])[:3, k], atol=1e-5)
    found = spherecal.identify(q, robot=nominal, points=points + rng.normal(0, 5e-5, points.shape))
    assert found.robot.joints == 7

    def off(robot):
        own = robot.fk(q)[:, :3, 3]
        a, b = own - own.mean(0), points - points.mean(0)
        u, _, vt = np.linalg.svd(a.T @ b)
        turn = u @ np.diag([1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt
        return np.linalg.norm(a @ turn - b, axis=1).mean()

    assert off(found.robot) < 1e-4 < 1e-3 < off(nominal)
    for refused in [lambda: nominal.ik(nominal.fk(q[0])), lambda: found.predict(q), lambda: found.compensate(q)]:
        with pytest.raises(spherecal.InputError, match="prismatic"):
            refused()
