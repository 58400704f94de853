"""Arrays as they come in: checked, and brought to one layout. What is wrong with one is named."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._errors import ArgumentError


def points(what: str, given: ArrayLike, count: int | None) -> NDArray[np.float64]:
    """An array of numbers of shape (count, 3), or (any, 3), as float64, one row behind the other."""
    array = np.asarray(given)
    if array.dtype.kind not in "fiu":
        raise TypeError(f"{what}: an array of {array.dtype}, not of real numbers")
    if array.ndim != 2 or array.shape[1] != 3 or (count is not None and array.shape[0] != count):
        rows = "N" if count is None else count
        raise ArgumentError(f"{what}: an array of shape {array.shape}, not ({rows}, 3)", "give a row for each point")
    return np.ascontiguousarray(array, dtype=np.float64)


def triangles(given: ArrayLike, vertices: int) -> NDArray[np.uint32]:
    """An array of the corners of triangles, of shape (T, 3)."""
    array = np.asarray(given)
    if array.dtype.kind not in "iu":
        raise TypeError(f"triangles: an array of {array.dtype}, not of whole numbers")
    if array.ndim != 2 or array.shape[1] != 3:
        raise ArgumentError(f"triangles: an array of shape {array.shape}, not (T, 3)", "give a row for each triangle")
    if array.size and not (0 <= int(array.min()) and int(array.max()) < vertices):
        raise ArgumentError(
            f"triangles: a corner is not from 0 to {vertices - 1}", "give indices of the points, from 0 on"
        )
    return np.ascontiguousarray(array, dtype=np.uint32)


def mask(given: ArrayLike, samples: int) -> list[bool]:
    """An array of truth values, one for each sample."""
    array = np.asarray(given)
    if array.dtype != np.bool_ or array.shape != (samples,):
        raise ArgumentError(
            f"where: an array of {array.dtype} of shape {array.shape}, not of bool of shape ({samples},)",
            "compare something with one value for each sample, as in s.points[:, 2] > 10",
        )
    listed: list[bool] = array.tolist()
    return listed
