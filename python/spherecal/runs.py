"""Plans, and the recordings and telemetry of runs."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _native
from .errors import JobFailed, SpherecalError, refuse, with_command
from .robot import Floats


def pandas() -> Any:
    """The module pandas, which is optional.

    Raises :class:`spherecal.SpherecalError` where it is missing.
    """
    try:
        import pandas as module
    except ImportError:
        raise SpherecalError(
            "pandas is missing: pip install 'spherecal[pandas]'", "pandas", "missing", "pip install 'spherecal[pandas]'"
        ) from None
    return module


class Plan:
    """Where the arm touches which sphere, in which poses; :func:`plan` makes it."""

    def __init__(self, document: dict[str, Any]) -> None:
        #: The document that the command ``spherecal plan`` writes as ``plan.json``.
        self.document = document
        rows = [
            (visit["sphere_id"], visit["place"], pose["id"], pose["joints"])
            for visit in document["spheres"]
            for pose in visit["poses"]
            if not pose["via"]
        ]
        #: Id of the sphere of each recorded pose: (N,).
        self.sphere: NDArray[np.int64] = np.array([row[0] for row in rows], dtype=np.int64)
        #: Number of the plate's placement of each: (N,).
        self.place: NDArray[np.int64] = np.array([row[1] for row in rows], dtype=np.int64)
        #: Number of each pose: (N,).
        self.pose: NDArray[np.int64] = np.array([row[2] for row in rows], dtype=np.int64)
        #: Joint angles of each, in rad: (N, joints).
        self.q: Floats = np.array([row[3] for row in rows], dtype=np.float64)

    @property
    def robot(self) -> str:
        """Name of the robot."""
        return str(self.document["robot"])

    @property
    def robot_seconds(self) -> float:
        """Time that the plan takes on the robot, in s."""
        return float(self.document["robot_s"])

    def __len__(self) -> int:
        return len(self.q)

    def __repr__(self) -> str:
        return f"<Plan of {len(self)} poses for {self.robot}>"


def plan(
    config: str | os.PathLike[str] = "",
    *,
    robot: str | None = None,
    poses: int | None = None,
    accuracy: float | None = None,
    seed: int | None = None,
) -> Plan:
    """Plans where to touch: the path of the command ``spherecal plan``.

    ``config`` is the path of a configuration (TOML), or its text; empty for the defaults
    (``spherecal config --print`` shows all fields). ``robot`` is a built-in name or a file,
    ``poses`` the number of poses, ``accuracy`` the mean error of the TCP (m) for which the fewest
    poses are planned.

    >>> made = plan(poses=6)
    >>> made.robot, made.q.shape
    ('iiwa7', (6, 7))
    """
    if poses is not None and accuracy is not None:
        raise refuse("poses", poses, "give poses or accuracy, not both")
    if poses is not None and poses < 1:
        raise refuse("poses", poses, "give at least 1")
    if seed is not None and not 0 <= seed < 2**64:
        raise refuse("seed", seed, "give an integer from 0 to 2**64 - 1")
    text = os.fspath(config)
    if text and "\n" not in text and "=" not in text:
        try:
            text = Path(text).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise refuse("config", text, f"{error}: give a TOML file, or TOML text") from None
    accuracy_mm = None if accuracy is None else accuracy * 1e3
    made = with_command(_native, "plan")(text, robot=robot, poses=poses, accuracy_mm=accuracy_mm, seed=seed)
    return Plan(json.loads(made))


def read_run(
    database: str | os.PathLike[str],
    *,
    run: int | None = None,
    telemetry: str | os.PathLike[str] | None = None,
) -> Mapping[str, Any]:
    """Reads a run into pandas DataFrames, one for each table that has rows.

    ``database`` is a folder of a run, its ``calibration.db``, or another store as the command takes it.
    ``run`` is the number of the run (default: the last). ``telemetry`` is an MCAP file of that run; in a
    folder, the run's own ``telemetry-run-N.mcap`` is found without being named, and further pieces of a
    run that was resumed are joined. The number of the run is in ``attrs["run"]`` of each table.

    Tables: ``recordings``, ``poses`` (as :func:`spherecal.identify` takes them), ``contacts``,
    ``couplings``, ``phases``, ``faults``, ``laser``, ``parameters``, ``telemetry``. The columns' names
    have the units.
    """
    frames = pandas()
    where = os.fspath(database)
    file = None if telemetry is None else Path(telemetry)
    if file is not None and not file.is_file():
        raise refuse("telemetry", file, "is no file: give the telemetry-run-N.mcap of the run")
    if os.path.isdir(where):
        where, beside = os.path.join(where, "calibration.db"), Path(where)
    else:
        beside = None
    found, number, torn = with_command(_native, "tables")(where, run, file, beside)
    pieces: dict[str, list[Any]] = {}
    for name, columns in found:
        pieces.setdefault(name, []).append(frames.DataFrame(dict(columns)))
    tables = {name: frames.concat(parts, ignore_index=True) for name, parts in pieces.items()}
    for piece in torn:
        print(f"spherecal: {piece} ends in the middle of a record: what stands before it is read", file=sys.stderr)
    for table in tables.values():
        table.attrs["run"] = number
    return tables


def simulate(
    folder: str | os.PathLike[str],
    *,
    robot: str | None = None,
    preset: str | None = None,
    poses: int | None = None,
    seed: int | None = None,
    config: str | os.PathLike[str] | None = None,
) -> Mapping[str, Any]:
    """Runs the whole job with a simulated arm, as the command ``spherecal run``; the tables of :func:`read_run`.

    ``folder`` gets the files of the run. ``robot``, ``preset``, ``poses``, ``seed`` and ``config`` (a file) are those of
    the command. A result that must not be used is returned: ``summary.json`` in ``folder`` says so. Raises
    :class:`spherecal.JobFailed` if the run does not finish.
    """
    pandas()
    given = {"robot": robot, "preset": preset, "poses": poses, "seed": seed, "config": config, "out": folder}
    options = [f"--{name}={value}" for name, value in given.items() if value is not None]
    command = [sys.executable, "-m", "spherecal", "run", *options]
    # The package is the installed one, not a folder of this name beside.
    safe = {**os.environ, "PYTHONSAFEPATH": "1"}
    ran = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, check=False, env=safe)
    if ran.returncode not in (0, 3):
        # Progress comes first, the reason last.
        raise JobFailed(ran.stderr.strip().rsplit("\n\n", 1)[-1])
    return read_run(folder)
