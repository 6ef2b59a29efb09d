"""Exceptions of spherecal. All of them derive from :class:`SpherecalError`."""

from __future__ import annotations

from typing import Any

#: Said where a build has no command.
MISSING = (
    "this build of spherecal identifies, and has no command, no plans and no runs: install a wheel of the release, or one of "
    "`scripts/python.sh wheel`"
)


class SpherecalError(Exception):
    """Base of all exceptions of this package.

    ``field``, ``value`` and ``remedy`` say what is wrong and what to do, where that is known.
    """

    def __init__(
        self,
        message: str,
        field: str | None = None,
        value: str | None = None,
        remedy: str | None = None,
    ) -> None:
        super().__init__(message)
        self.field = field
        self.value = value
        self.remedy = remedy


class InputError(SpherecalError, ValueError):
    """An argument, an array or a file cannot be used.

    >>> import spherecal
    >>> try:
    ...     spherecal.Robot("ur5ee")
    ... except spherecal.InputError as error:
    ...     print(error.field, error.value)
    robot ur5ee
    """


class Refused(SpherecalError):
    """The result must not be used: see :meth:`spherecal.Identification.require`."""


class Unreachable(SpherecalError):
    """The arm cannot take this pose within its joint limits."""


class JobFailed(SpherecalError, RuntimeError):
    """The work failed although the input is usable: no convergence, a file that cannot be written."""


class InternalError(SpherecalError, RuntimeError):
    """A defect of spherecal."""


def with_command(native: Any, name: str) -> Any:
    """The function of this name of the extension module; builds from the sources leave some out."""
    if not hasattr(native, name):
        raise JobFailed(MISSING, remedy="install a wheel of the release")
    return getattr(native, name)


def refuse(field: str, value: object, remedy: str) -> InputError:
    """An :class:`InputError` in the words of this package."""
    return InputError(f"{field} is {value}: {remedy}", field, str(value), remedy)
