"""Births and deaths: how named states pass from one layout to the next."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from pntegrity.records import Layout

IndexArray = npt.NDArray[np.intp]


@lru_cache(maxsize=512)
def survivors(old: Layout, new: Layout) -> tuple[IndexArray, IndexArray, IndexArray]:
    """Return where the common states stand in `new` and in `old`, and which of `new` are born."""
    common = [(i, old.index[n]) for i, n in enumerate(new.names) if n in old.index]
    born = [i for i, n in enumerate(new.names) if n not in old.index]
    pairs = np.array(common, dtype=np.intp).reshape(-1, 2)
    return pairs[:, 0], pairs[:, 1], np.array(born, dtype=np.intp)


@lru_cache(maxsize=512)
def columns(layout: Layout, names: tuple[str, ...]) -> IndexArray:
    """Return where `names` stand in a layout, -1 for those that do not."""
    return np.array([layout.index.get(n, -1) for n in names], dtype=np.intp)
