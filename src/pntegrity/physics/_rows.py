"""Rows by what they are of."""

import numpy as np
import numpy.typing as npt


def rows_by_kind(kinds: npt.NDArray[np.str_]) -> list[tuple[str, npt.NDArray[np.intp]]]:
    """Return each kind, in alphabetical order, with the rows that are of it, in ascending order."""
    if not len(kinds):
        return []
    names, inverse = np.unique(kinds, return_inverse=True)
    order = np.argsort(inverse, kind="stable")
    parts = np.split(order, np.cumsum(np.bincount(inverse, minlength=len(names)))[:-1])
    return list(zip(names.tolist(), parts, strict=True))
