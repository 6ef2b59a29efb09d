"""The command `spherecal` of the wheel, plans, and runs as DataFrames."""

import json
import os
import signal
import subprocess

import numpy as np
import pytest
from conftest import SPHERECAL

import spherecal


# Fails if exit code, stdout or stderr are not those of the program.
def test_the_command_is_the_program(command, tmp_path):
    version = command("--version")
    assert (version.returncode, version.stdout) == (0, f"spherecal {spherecal.__version__}\n")
    wrong = command("identify", "--no-such-option")
    assert wrong.returncode == 2 and "--no-such-option" in wrong.stderr and wrong.stdout == ""
    missing = command("identify", "--robot", "ur5ee", "--data", tmp_path / "none.csv", "--out", tmp_path)
    assert missing.returncode == 2 and "neither built in nor a file" in missing.stderr
    listed = command("robot", "list")
    assert listed.returncode == 0 and all(name in listed.stdout for name in spherecal.BUILT_IN)


# Fails if Ctrl-C is held back by the interpreter: the program would run on.
@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_ctrl_c_ends_the_command(tmp_path):
    arguments = [SPHERECAL, "plant", "--listen", "127.0.0.1:0"]
    process = subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=tmp_path)
    try:
        # It has started when it says where it listens.
        said = process.stdout.readline()
        assert "127.0.0.1:" in said, said
        process.send_signal(signal.SIGINT)
        rest, _ = process.communicate(timeout=60)
        assert "KeyboardInterrupt" not in rest
        assert process.returncode in (0, 1, 130, -signal.SIGINT), (process.returncode, rest)
    finally:
        process.kill()


# Fails if the plan is not that of the command.
def test_a_plan_is_that_of_the_command(command):
    made = spherecal.plan(poses=12, seed=3)
    ran = command("plan", "--poses", 12, "--seed", 3, "--json")
    assert ran.returncode == 0, ran.stderr
    assert made.document == json.loads(ran.stdout)
    assert made.q.shape == (len(made), 7) and len(made.sphere) == len(made.place) == len(made) == 12
    assert set(made.sphere) <= {visit["sphere_id"] for visit in made.document["spheres"]}
    assert made.robot_seconds > 0


# Fails if one of these is taken.
def test_plans_that_cannot_be_made_are_refused():
    for arguments, words in [
        ({"poses": 0}, "poses is 0: give at least 1"),
        ({"poses": 5, "accuracy": 1e-4}, "not both"),
        ({"robot": "ur5ee"}, "neither built in nor a file"),
        ({"config": "missing.toml"}, "config is missing.toml"),
        ({"config": "no_such_field = 1\n"}, "no_such_field"),
        ({"seed": -1}, "seed is -1"),
    ]:
        with pytest.raises(spherecal.InputError, match=words):
            spherecal.plan(**arguments)


# Fails if a run's tables are not those of `spherecal export`, bit by bit, or its telemetry is lost.
def test_a_run_is_read_into_data_frames(command, tmp_path):
    pandas = pytest.importorskip("pandas")
    ran = command("measure", "--poses", 9, "--out", tmp_path / "cell")
    assert ran.returncode in (0, 3), ran.stderr
    tables = spherecal.read_run(tmp_path / "cell")
    poses = tables["poses"]
    assert len(poses) == 9 and {"q1", "q7", "sphere"} <= set(poses.columns)
    assert len(tables["recordings"]) == 9
    telemetry = tables["telemetry"]
    assert len(telemetry) > 1000 and {"time_ns", "q1_rad", "force_x_n"} <= set(telemetry.columns)
    assert (np.diff(telemetry["time_ns"]) > 0).all()
    assert command("export", "--csv", "--out", tmp_path / "cell").returncode == 0
    files = {file.stem: file for file in (tmp_path / "cell" / "tables").glob("*.csv")}
    assert set(files) == set(tables)
    for name, file in files.items():
        there = pandas.read_csv(file, keep_default_na=False, na_values=["NaN"])
        pandas.testing.assert_frame_equal(tables[name], there, check_exact=True)
    # A second run in the folder: each run has its own telemetry.
    ran = command("measure", "--poses", 6, "--seed", 2, "--out", tmp_path / "cell")
    assert ran.returncode in (0, 3), ran.stderr
    again = spherecal.read_run(tmp_path / "cell", run=1)
    np.testing.assert_array_equal(again["telemetry"]["q1_rad"], telemetry["q1_rad"])
    second = spherecal.read_run(tmp_path / "cell")
    assert second["telemetry"].attrs["run"] == 2 and len(second["poses"]) == 6
    assert len(second["telemetry"]) != len(telemetry)
    named = spherecal.read_run(tmp_path / "cell" / "calibration.db", run=1)
    assert "telemetry" not in named
    np.testing.assert_array_equal(named["poses"]["q1"], poses["q1"])
    with pytest.raises(spherecal.InputError, match="run is 9: give a number from 1 to 2"):
        spherecal.read_run(tmp_path / "cell", run=9)
    with pytest.raises(spherecal.InputError, match="telemetry is .*is no file"):
        spherecal.read_run(tmp_path / "cell", telemetry=tmp_path / "none.mcap")
    with pytest.raises(spherecal.InputError, match="none.db"):
        spherecal.read_run(tmp_path / "none.db")


# Fails if a simulated job is another than the command's, or a job that cannot run says nothing of the reason.
def test_a_job_is_simulated(tmp_path):
    pytest.importorskip("pandas")
    tables = spherecal.simulate(tmp_path / "cell", poses=12, preset="typical", seed=3)
    assert len(tables["poses"]) == 12 and (tmp_path / "cell" / "report.html").is_file()
    with pytest.raises(spherecal.JobFailed, match="neither built in nor a file"):
        spherecal.simulate(tmp_path / "none", robot="ur5ee")
