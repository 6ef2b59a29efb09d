"""Checks of the arrays that callers give."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import refuse


def floats(field: str, value: ArrayLike) -> NDArray[np.float64]:
    """An array of numbers, C-contiguous."""
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "fiu":
            raise TypeError(f"its type is {array.dtype}")
        return np.ascontiguousarray(array, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise refuse(field, f"no array of real numbers ({error})", "give an array of floats") from None


def table(field: str, value: ArrayLike, columns: int, unit: str, rows: int | None = None) -> NDArray[np.float64]:
    """An array of shape (N, ``columns``); N is ``rows`` where that is given."""
    array = floats(field, value)
    wanted = f"({'N' if rows is None else rows}, {columns})"
    if array.ndim != 2 or array.shape[1] != columns or (rows is not None and len(array) != rows):
        raise refuse(field, f"an array of shape {array.shape}", f"give shape {wanted}, in {unit}")
    if len(array) == 0:
        raise refuse(field, "empty", "give one row per pose")
    return array


def targets(field: str, value: ArrayLike, rows: int) -> NDArray[np.float64]:
    """Points of shape (``rows``, 3) or (``rows``, K, 3), in m; as (``rows``, 3 K)."""
    array = floats(field, value)
    if array.ndim not in (2, 3) or len(array) != rows or array.shape[-1] != 3 or array.size == 0:
        raise refuse(
            field,
            f"an array of shape {array.shape}",
            f"give shape ({rows}, 3), or ({rows}, K, 3) for K targets on the tool, in m",
        )
    return np.ascontiguousarray(array.reshape(rows, -1))


def rotations(field: str, value: ArrayLike, rows: int) -> NDArray[np.float64]:
    """Rotation matrices of shape (``rows``, 3, 3), as (``rows``, 9)."""
    array = floats(field, value)
    if array.shape != (rows, 3, 3):
        raise refuse(field, f"an array of shape {array.shape}", f"give rotation matrices of shape ({rows}, 3, 3)")
    return np.ascontiguousarray(array.reshape(rows, 9))


def joints(field: str, value: ArrayLike, n: int) -> tuple[NDArray[np.float64], bool]:
    """Joint angles of shape (N, n) or (n,), and whether it was one row."""
    array = floats(field, value)
    single = array.ndim == 1
    if single:
        array = array.reshape(1, -1)
    if array.ndim != 2 or array.shape[1] != n:
        raise refuse(
            field,
            f"an array of shape {np.shape(value)}",
            f"the robot has {n} joints: give shape (N, {n}) or ({n},), in rad",
        )
    return array, single


def vector(field: str, value: ArrayLike, unit: str) -> list[float]:
    """Three finite numbers."""
    array = floats(field, value)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise refuse(field, value, f"give three finite numbers in {unit}")
    return [float(x) for x in array]


def labels(field: str, value: Sequence[object] | NDArray[np.generic], rows: int) -> list[str]:
    """One label a row, as text."""
    listed = np.asarray(value).tolist() if isinstance(value, np.ndarray) else list(value)
    if len(listed) != rows:
        raise refuse(field, f"a list of {len(listed)}", f"give one value for each of the {rows} rows of q")
    texts = [str(item) for item in listed]
    for text in texts:
        if any(c in text for c in "\r\n\0"):
            raise refuse(field, repr(text), "give labels without line breaks")
    return texts
