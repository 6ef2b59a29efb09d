"""Robot self-calibration from contacts with precision spheres, or from measured points.

- :class:`Robot`: forward kinematics, Jacobian, inverse kinematics; numpy in and out.
- :func:`identify`: parameters, covariance, expected error, verdict, calibrated robot, compensation.
- :func:`plan`: where to touch, in which poses.
- :func:`simulate`: the whole job with a simulated arm.
- :func:`read_run`: the database and telemetry of a run as pandas DataFrames.

Units: rad, m, N m, kg, s, unless a name has another unit.
"""

from ._native import BUILT_IN, __version__
from .errors import InputError, InternalError, JobFailed, Refused, SpherecalError, Unreachable
from .identification import (
    Check,
    ExpectedError,
    Identification,
    Parameter,
    Parameters,
    Residuals,
    Verdict,
    calibrate,
    identify,
)
from .robot import Robot
from .runs import Plan, plan, read_run, simulate

__all__ = [
    "BUILT_IN",
    "Check",
    "ExpectedError",
    "Identification",
    "InputError",
    "InternalError",
    "JobFailed",
    "Parameter",
    "Parameters",
    "Plan",
    "Refused",
    "Residuals",
    "Robot",
    "SpherecalError",
    "Unreachable",
    "Verdict",
    "__version__",
    "calibrate",
    "identify",
    "plan",
    "read_run",
    "simulate",
]
