"""Identification of a robot from joint angles and where its TCP was."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _native
from ._arrays import joints, labels, rotations, table, targets, vector
from .errors import Refused, refuse
from .robot import Floats, Robot


@dataclass(frozen=True)
class Parameter:
    """One parameter of the model, in ``unit``."""

    name: str
    #: Value now.
    value: float
    #: Standard deviation now; 0 where it was fixed.
    sigma: float
    unit: str
    #: Value before the data were seen.
    nominal: float
    #: Standard deviation before the data were seen.
    prior_sigma: float
    #: Whether it was estimated at all.
    free: bool
    #: Whether the data determine it.
    identified: bool
    #: Why the prior is what it is, or why the parameter is fixed.
    reason: str


class Parameters(Mapping[str, Parameter]):
    """The parameters by name, in the order of the model."""

    def __init__(self, rows: Sequence[Parameter]) -> None:
        self._rows = {row.name: row for row in rows}

    def __getitem__(self, name: str) -> Parameter:
        return self._rows[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._rows)

    def __len__(self) -> int:
        return len(self._rows)

    def __repr__(self) -> str:
        determined = sum(row.identified for row in self._rows.values())
        return f"<Parameters: {len(self)}, {determined} of them determined by the data>"

    def to_pandas(self) -> Any:
        """A pandas DataFrame with a row for each parameter."""
        from .runs import pandas

        return pandas().DataFrame([vars(row) for row in self._rows.values()])


@dataclass(frozen=True)
class ExpectedError:
    """Error of the TCP to expect over the work region, in m."""

    mean: float
    #: 95 % of the workspace has an error below this.
    p95: float
    #: 95 % interval of the mean.
    interval: tuple[float, float]

    @classmethod
    def _of(cls, found: Mapping[str, Any] | None) -> ExpectedError | None:
        if found is None:
            return None
        low, high = found["interval"]
        return cls(found["mean"] / 1e3, found["p95"] / 1e3, (low / 1e3, high / 1e3))


@dataclass(frozen=True)
class Check:
    """One thing that was checked; ``words`` has the unit of ``value`` and ``limit``."""

    name: str
    passed: bool
    #: Whether a failure refuses the result, or only qualifies it.
    refuses: bool
    value: float | None
    limit: float | None
    words: str


@dataclass(frozen=True)
class Verdict:
    """Whether a result may be used, and why."""

    may_be_used: bool
    checks: tuple[Check, ...]
    #: Words of the checks that failed.
    reasons: tuple[str, ...]
    #: What to do next.
    next: str
    #: Share of the nominal error that is gone; None where nothing judged.
    improvement: float | None

    def __bool__(self) -> bool:
        return self.may_be_used

    def __repr__(self) -> str:
        word = "OK to use" if self.may_be_used else "DO NOT USE"
        return f"<Verdict {word}: {len(self.reasons)} of {len(self.checks)} checks failed>"


@dataclass(frozen=True)
class Residuals:
    """Residuals of the rows that the fit used."""

    #: Index into the arrays of the data, from 0.
    row: NDArray[np.int64]
    #: What messages, remarks and the report call the row; they count from 1.
    name: list[str]
    #: TCP minus target, in m: (N, 3).
    error: Floats
    #: Length of the whitened residual, in units of the estimated noise.
    deviation: Floats
    #: Robust weight relative to a residual of zero.
    weight: Floats

    @property
    def distance(self) -> Floats:
        """Distance of the TCP from its target, in m."""
        return np.linalg.norm(self.error, axis=1)


class Identification:
    """A calibrated robot with everything that is known about its errors; :func:`identify` makes it."""

    def __init__(self, inputs: _Inputs) -> None:
        self._inputs = inputs
        self._found: _native.NativeIdentification | None = inputs.identify()
        #: The document that the command ``spherecal identify`` writes as ``summary.json``.
        self.summary: dict[str, Any] = json.loads(self._found.summary_json())

    @property
    def _native(self) -> _native.NativeIdentification:
        if self._found is None:
            self._found = self._inputs.identify()
        return self._found

    def __getstate__(self) -> dict[str, Any]:
        """What a copy holds: inputs and summary. It identifies again when it needs more than the summary."""
        return {**self.__dict__, "_found": None}

    def __eq__(self, other: object) -> bool:
        """Whether two results say the same; the time that they took does not count."""
        if not isinstance(other, Identification):
            return NotImplemented
        return {**self.summary, "wall_s": None} == {**other.summary, "wall_s": None}

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return f"<Identification {self.headline}>"

    def _repr_html_(self) -> str:
        """For notebooks: the headline, and each file with its expected error over the work region."""
        colour = "#0f7b4f" if self.verdict else "#c02f26"
        rows = []
        for file in self.summary["files"]:
            error = file["expected_error_mm"]
            cells = "<td></td><td></td>"
            if error is not None:
                low, high = error["interval"]
                cells = f"<td>{error['mean']:.3f}</td><td>{low:.3f} to {high:.3f}</td>"
            rows.append(f"<tr><td>{escape(file['name'])}</td>{cells}</tr>")
        return (
            f'<p style="border-left:4px solid {colour};padding-left:8px"><b>{escape(self.headline)}</b></p>'
            "<table><tr><th>file</th><th>expected error (mm)</th><th>95 % interval</th></tr>"
            f"{''.join(rows)}</table>"
        )

    @property
    def headline(self) -> str:
        """Before, after, with which file, over which region, and whether it may be used."""
        return str(self.summary["verdict"]["headline"])

    def __str__(self) -> str:
        return self._native.summary_text()

    @property
    def parameters(self) -> Parameters:
        """Every parameter of the model."""
        return Parameters(
            [
                Parameter(
                    name=p["name"],
                    value=p["estimate"],
                    sigma=p["sigma"],
                    unit=p["unit"],
                    nominal=p["nominal"],
                    prior_sigma=p["prior_sigma"],
                    free=p["free"],
                    identified=p["identified"],
                    reason=p["reason"],
                )
                for p in self.summary["parameters"]
            ]
        )

    @property
    def covariance_names(self) -> list[str]:
        """Names of the rows and columns of :attr:`covariance`: the free parameters."""
        return self._native.free_names()

    @property
    def covariance(self) -> Floats:
        """Covariance of the free parameters, SI units."""
        return self._native.covariance()

    @property
    def expected_error(self) -> ExpectedError | None:
        """Error of the calibrated TCP to expect over the work region; None where it cannot be told."""
        return ExpectedError._of(self.summary["verdict"]["expected_error_mm"])

    @property
    def nominal_error(self) -> ExpectedError | None:
        """The same of the nominal robot."""
        return ExpectedError._of(self.summary["verdict"]["nominal_error_mm"])

    @property
    def verdict(self) -> Verdict:
        """Whether the result may be used, with its checks and reasons."""
        found = self.summary["verdict"]
        return Verdict(
            may_be_used=found["may_be_used"],
            checks=tuple(
                Check(c["name"], c["passed"], c["refuses"], c["value"], c["limit"], c["words"])
                for c in found["checks"]
            ),
            reasons=tuple(found["reasons"]),
            next=found["next"],
            improvement=found["improvement"],
        )

    def require(self) -> Identification:
        """This result; raises :class:`spherecal.Refused` with the reasons if it must not be used."""
        if not self.verdict.may_be_used:
            raise Refused("the result must not be used: " + "; ".join(self.verdict.reasons), remedy=self.verdict.next)
        return self

    @property
    def notes(self) -> list[str]:
        """What the user should know, in words."""
        return list(self.summary["notes"])

    @property
    def residuals(self) -> Residuals:
        """Residuals of the rows that the fit used."""
        rows = self._native.residuals()
        names = self._native.residual_names()
        return Residuals(rows[:, 0].astype(np.int64), names, rows[:, 1:4] / 1e3, rows[:, 4], rows[:, 5])

    @property
    def robot(self) -> Robot:
        """The calibrated robot as files hold it: geometry alone, with the calibrated tool."""
        return Robot._of(self._native.robot())

    def predict(self, q: ArrayLike) -> Floats:
        """TCP by the full model (geometry, compliance, encoder harmonics) in the root frame, in m: (N, 3).

        The load of the joints is that of the robot's own masses and payload.
        """
        rows, single = joints("q", q, self.robot.joints)
        points = self._native.predict(rows)
        return points[0] if single else points

    def predicted_sigma(self, q: ArrayLike) -> Floats:
        """Standard deviation of the predicted TCP, in m: (N,). Root of the summed variances."""
        rows, _ = joints("q", q, self.robot.joints)
        return np.array(self._native.predicted_sigma(rows))

    def compensate(self, q_nominal: ArrayLike) -> Floats:
        """Joint commands with which the real arm reaches what a nominal controller aims at.

        A controller that keeps its nominal model aims at ``T_nominal(q_nominal)``. The command is
        ``q = argmin |q - q_nominal|`` locally, subject to ``p_full(q) = p_nominal(q_nominal)`` and
        ``R_calibrated(q) = R_nominal(q_nominal)``: the position by the full model, the rotation by its
        table of links. Damped Newton steps solve the table's inverse kinematics from ``q_nominal``; the
        target is then moved by what the full model's effects leave, until 1e-9 m.

        Both sides use the robot's own base frame F0 and the tool: nominal as given, calibrated as
        identified. Raises :class:`spherecal.Unreachable` near singular postures and joint limits.
        (N, joints) gives (N, joints).
        """
        rows, single = joints("q_nominal", q_nominal, self.robot.joints)
        commands = self._native.compensate(rows)
        return commands[0] if single else commands

    def to_toml(self) -> str:
        """``calibrated.toml`` as the command writes it: geometry, and the full model's effects."""
        return self._native.toml()

    def to_urdf(self) -> str:
        """``calibrated.urdf`` as the command writes it."""
        return self._native.urdf()

    def to_kinematics_yaml(self) -> str:
        """``kinematics.yaml`` as the command writes it."""
        return self._native.kinematics_yaml()

    def to_offsets_yaml(self) -> str:
        """``offsets.yaml`` as the command writes it."""
        return self._native.offsets_yaml()

    def save_urdf(self, file: str | os.PathLike[str]) -> None:
        """Writes ``calibrated.urdf`` under another name."""
        Path(file).write_text(self.to_urdf(), encoding="utf-8")

    def to_frame(self) -> Any:
        """The residuals as a pandas DataFrame, in m, with a row for each row that the fit used."""
        from .runs import pandas

        found = self.residuals
        columns = {f"{axis}_m": found.error[:, k] for k, axis in enumerate("xyz")}
        last = {"distance_m": found.distance, "deviation": found.deviation, "weight": found.weight}
        return pandas().DataFrame({"row": found.row, "name": found.name, **columns, **last})

    def plot(self) -> Any:
        """A matplotlib figure: the expected errors before and after with their intervals, and the residuals."""
        try:
            from matplotlib.figure import Figure
        except ImportError:
            raise refuse("matplotlib", "missing", "pip install matplotlib") from None
        figure = Figure(figsize=(9, 3.5), layout="constrained")
        figure.suptitle(self.headline, fontsize="small", wrap=True)
        before, after = figure.subplots(1, 2)
        found = self.summary["verdict"]
        rows = [("nominal", found["nominal_error_mm"])]
        rows += [(file["name"], file["expected_error_mm"]) for file in reversed(self.summary["files"])]
        for name, error in rows:
            if error is not None:
                low, high = error["interval"]
                mean = error["mean"]
                before.barh(name, mean, xerr=[[mean - min(low, mean)], [max(high, mean) - mean]], capsize=3)
        before.set_xlabel("expected error over the work region (mm)")
        before.set_xlim(left=0)
        residuals = self.residuals
        after.scatter(residuals.row, residuals.distance * 1e3, s=8, c=residuals.weight, cmap="viridis")
        after.set_xlabel("row (dark: counts little)")
        after.set_ylabel("residual (mm)")
        after.set_ylim(bottom=0)
        return figure

    def write(self, folder: str | os.PathLike[str]) -> list[str]:
        """Writes the files of the command, with ``report.html``, into ``folder``; their paths."""
        created = datetime.now(timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ")
        return self._native.write(os.fspath(folder), created)


@dataclass(frozen=True)
class _Inputs:
    """What an identification is made from."""

    robot: Robot
    data: dict[str, Any]
    options: dict[str, Any]

    def identify(self) -> _native.NativeIdentification:
        return _native.identify(self.robot._native, self.data, **self.options)


def _rows(
    robot: Robot,
    q: ArrayLike,
    points: ArrayLike | None,
    orientations: ArrayLike | None,
    sphere: ArrayLike | None,
    place: Sequence[object] | NDArray[np.generic] | None,
    split: Sequence[str] | NDArray[np.generic] | None,
    tau: ArrayLike | None,
) -> dict[str, Any]:
    """A table of poses, checked for its shapes."""
    angles = table("q", q, robot.joints, "rad")
    n = len(angles)
    if (points is None) == (sphere is None):
        raise refuse(
            "points and sphere",
            "both missing" if points is None else "both given",
            "give points=(N, 3) in m for measured points, or sphere=(N,) with plate= for contacts",
        )
    if orientations is not None and points is None:
        raise refuse("orientations", "given without points", "give points=(N, 3), the position of the measured body")
    if np.mean(np.abs(angles).max(axis=1) > 6.5) > 0.5:
        raise refuse("q", "beyond a full turn in most rows", "give rad: numpy.radians(q) if these are degrees")
    ids = None
    if sphere is not None:
        given = np.asarray(sphere)
        if given.shape != (n,) or given.dtype.kind not in "iu":
            raise refuse(
                "sphere",
                f"an array of shape {given.shape} and type {given.dtype}",
                f"give the integer id of the sphere for each of the {n} rows",
            )
        ids = [int(i) for i in given]
    return {
        "q": angles,
        "tau": None if tau is None else table("tau", tau, robot.joints, "N m", n),
        "points": None if points is None else targets("points", points, n),
        "orientations": None if orientations is None else rotations("orientations", orientations, n),
        "sphere": ids,
        "place": None if place is None else labels("place", place, n),
        "set": None if split is None else labels("set", split, n),
    }


def _plate(plate: object) -> tuple[str | None, str | None]:
    """A plate's file or name, or its text."""
    if plate is None:
        return None, None
    if isinstance(plate, (str, os.PathLike)):
        text = os.fspath(plate)
        return (None, text) if "\n" in text else (text, None)
    if not isinstance(plate, Mapping):
        raise refuse(
            "plate",
            type(plate).__name__,
            'give "paper", the path of a certificate (TOML), or {id: (x, y, z)} or {id: (x, y, z, sigma)} in m',
        )
    lines = []
    for key, centre in plate.items():
        numbers = np.asarray(centre, dtype=float).ravel().tolist()
        if len(numbers) not in (3, 4) or isinstance(key, bool) or not isinstance(key, (int, np.integer)) or key < 0:
            raise refuse("plate", f"{{{key!r}: {centre}}}", "give {id: (x, y, z)} or {id: (x, y, z, sigma)} in m")
        lines += ["[[sphere]]", f"id = {int(key)}"]
        lines += [f"{axis}_m = {value!r}" for axis, value in zip("xyz", numbers)]
        if len(numbers) == 4:
            lines.append(f"sigma_um = {numbers[3] * 1e6!r}")
    return None, "\n".join(lines) + "\n"


def identify(
    q: ArrayLike,
    *,
    robot: Robot | str | os.PathLike[str],
    points: ArrayLike | None = None,
    orientations: ArrayLike | None = None,
    sphere: ArrayLike | None = None,
    place: Sequence[object] | NDArray[np.generic] | None = None,
    plate: Mapping[int, ArrayLike] | str | os.PathLike[str] | None = None,
    tool: ArrayLike | None = None,
    tau: ArrayLike | None = None,
    set: Sequence[str] | NDArray[np.generic] | None = None,
    validate: Mapping[str, Any] | None = None,
    holdout: str | None = None,
    payload_kg: float | None = None,
    payload_com: ArrayLike | None = None,
    accuracy: float | None = None,
    method: str | None = None,
    model: str | None = None,
    options: str | None = None,
    seed: int | None = None,
) -> Identification:
    """Identifies a robot: the path of the command ``spherecal identify``, with the same numbers.

    It aligns the frames, leaves gross errors out, chooses the model, identifies, cross-validates and
    judges the result.

    Arguments (SI units):

    - ``q``: joint angles as the encoders gave them, (N, joints), rad.
    - ``robot``: a :class:`Robot`, or what :class:`Robot` takes.
    - ``points``: measured TCP, (N, 3), m, in any tracker frame; or several targets on the tool, (N, K, 3),
      the first of them the TCP, with NaN where one was hidden. With (N, 3), ``orientations`` of the
      measured body: rotation matrices, (N, 3, 3), in the tracker frame, NaN where there was none; or
    - ``sphere``: id of the plate's sphere that the tool sat on, (N,), with ``plate``: ``"paper"``, the
      path or text of a certificate (TOML), or ``{id: (x, y, z)}`` or ``{id: (x, y, z, sigma)}`` in m.
      ``place``: label of the plate's placement, (N,), if it was moved.
    - ``tool``: nominal TCP in the flange frame, m.
    - ``tau``: measured joint torques, (N, joints), N m.
    - ``set``: ``"calibrate"`` or ``"validate"`` for each row.
    - ``validate``: rows that judge the result, as a mapping with ``q`` and ``points`` (and
      ``orientations``) or ``sphere`` (and ``place``).
    - ``holdout``: ``"place"`` or ``"sphere"``: holds each value out in turn.
    - ``payload_kg``, ``payload_com``: mass at the flange (kg) and its centre of mass (m).
    - ``accuracy``: mean error of the TCP that is asked for, m; a worse result is refused.
    - ``method``, ``model``, ``seed``: as the command's options. ``options``: TOML text, as the
      command's ``--config``.

    Raises :class:`InputError` for arrays that cannot be used and for data of another robot. A result
    that must not be used is returned; see :attr:`Identification.verdict`.

    >>> import numpy as np, spherecal
    >>> robot = spherecal.Robot("ur5e", tool=(0.02, 0, 0.12))
    >>> real = spherecal.Robot(robot.to_toml().replace("a = 0.425", "a = 0.4255"))
    >>> rng = np.random.default_rng(1)
    >>> q = rng.uniform(-2, 2, (60, 6))
    >>> points = real.fk(q)[:, :3, 3] + rng.normal(0, 2e-5, (60, 3))
    >>> found = spherecal.identify(q, points=points, robot=robot)
    >>> found.verdict.may_be_used
    True
    >>> abs(found.parameters["a2"].value - 0.4255) < 1e-4
    True
    """
    arm = robot if isinstance(robot, Robot) else Robot(robot)
    data = _rows(arm, q, points, orientations, sphere, place, set, tau)
    file, text = _plate(plate)
    if sphere is not None and file is None and text is None:
        raise refuse(
            "plate",
            "missing",
            "contacts with spheres give the robot no scale without the spheres' certified positions: give "
            '{id: (x, y, z)} in m, the path of a certificate, or "paper" for Table 1 of the paper',
        )
    judges = None
    if validate is not None:
        unknown = [key for key in validate if key not in ("q", "points", "orientations", "sphere", "place", "tau")]
        if "q" not in validate or unknown:
            raise refuse("validate", f"a mapping with {list(validate)}", "give q, and points or sphere (and place, tau)")
        get = validate.get
        judges = _rows(
            arm,
            validate["q"],
            get("points"),
            get("orientations"),
            get("sphere"),
            get("place"),
            None,
            get("tau"),
        )
    if accuracy is not None and not 1e-6 <= accuracy <= 0.1:
        raise refuse("accuracy", accuracy, "give a length in m from 1e-6 to 0.1")
    if seed is not None and not 0 <= seed < 2**64:
        raise refuse("seed", seed, "give an integer from 0 to 2**64 - 1")
    options_of = dict(
        validate=judges,
        plate_file=file,
        plate_text=text,
        tool_m=None if tool is None else vector("tool", tool, "m (flange frame)"),
        payload_kg=payload_kg,
        payload_com_m=None if payload_com is None else vector("payload_com", payload_com, "m (flange frame)"),
        holdout=holdout,
        accuracy_mm=None if accuracy is None else accuracy * 1e3,
        options_toml=options,
        method=method,
        model=model,
        seed=seed,
    )
    return Identification(_Inputs(arm, data, options_of))


def calibrate(robot: Robot | str | os.PathLike[str], q: ArrayLike, points: ArrayLike, **options: Any) -> Identification:
    """:func:`identify` from measured points in one line; ``options`` are its other arguments.

    >>> robot = Robot("ur5e", tool=(0.02, 0, 0.12))
    >>> q = np.random.default_rng(1).uniform(-2, 2, (60, 6))
    >>> calibrate(robot, q, robot.fk(q)[:, :3, 3]).expected_error.mean < 1e-4
    True
    """
    return identify(q, points=points, robot=robot, **options)
