"""Beliefs: named states, their mean and covariance, and the linear step that predicts them.

Symbols as in `pntegrity.records`, which gives these names on.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

__all__ = [
    "ANEW", "FloatArray", "Layout", "Prior", "State", "freeze", "frozen", "group_of", "is_left_out",
    "is_satellite", "names_sensor", "rows_touched_by", "sensor_of", "source_of",
]  # fmt: skip


def group_of(key: str) -> str:
    """Return what fails together with a row: the part of its key before the first colon (``"G05:C1C"`` ->
    ``"G05"``).
    """
    return key.partition(":")[0]


def sensor_of(key: str) -> str:
    """Return the sensor within its source: what stands behind the kind (``"lbl:R.AP1"`` -> ``"AP1"``); empty
    for a source that is one sensor.
    """
    return key.partition(":")[2].partition(".")[2]


def source_of(name: str) -> str:
    """Return the source of who can be left out: of a sensor (``"lbl.AP1"`` -> ``"lbl"``), or the group."""
    return name.partition(".")[0]


def names_sensor(name: str) -> bool:
    """Tell whether the name of who is left out is that of a sensor of a source (``"lbl.AP1"``)."""
    return "." in name


_SATELLITE = re.compile(r"[A-Z]\d\d")


def is_satellite(group: str) -> bool:
    """Tell whether a group is a satellite: a letter and two digits (``"G05"``)."""
    return _SATELLITE.fullmatch(group) is not None


ANEW = "~"
"""Ends the name of a group in what is left out: its own ambiguities shall begin anew at this epoch."""


def is_left_out(key: str, groups: frozenset[str]) -> bool:
    """Tell whether a row goes with those that are left out: groups, and single sensors of sources.

    The row of a product names its satellite after the colon (``"iono:G05"``): it goes with ``"iono"`` and
    with ``"G05"``. That of a sensor of a source (``"lbl:R.AP1"``) goes with ``"lbl"`` and with ``"lbl.AP1"``.
    """
    group, _, about = key.partition(":")
    return group in groups or about in groups or f"{group}.{about.partition('.')[2]}" in groups


@lru_cache(maxsize=4096)
def rows_touched_by(patterns: tuple[str, ...], keys: tuple[str, ...]) -> npt.NDArray[np.bool_]:
    """Return which rows any of some patterns matches, shape (len(keys),), read-only.

    Parameters
    ----------
    patterns : tuple of str
        With the wildcards of a shell: ``"G05:*"``, ``"*:G05"``, ``"iono:*"``.
    keys : tuple of str
    """
    out = np.array([any(fnmatchcase(k, p) for p in patterns) for k in keys], dtype=bool)
    out.flags.writeable = False
    return out


def frozen(a: npt.ArrayLike) -> FloatArray:
    """Return a read-only float64 array of `a` (a view where `a` already is one)."""
    out = np.asarray(a, dtype=np.float64).view()
    out.flags.writeable = False
    return out


def freeze(obj: object, *names: str) -> None:
    """Make array fields of a frozen dataclass read-only float64."""
    for name in names:
        object.__setattr__(obj, name, frozen(getattr(obj, name)))


@lru_cache(maxsize=1024)
def _block(names: tuple[str, ...], prefix: str) -> npt.NDArray[np.intp]:
    hits = np.array(
        [i for i, n in enumerate(names) if n == prefix or n.startswith(prefix + ":")], dtype=np.intp
    )
    hits.flags.writeable = False
    return hits


@dataclass(frozen=True)
class Layout:
    """The names of the states, one a scalar: ``"pos:x"``, ``"clk"``, ``"isb:E"``, ``"bias:G05:C1C"``."""

    names: tuple[str, ...] = ()

    @cached_property
    def index(self) -> dict[str, int]:
        """Where each name stands."""
        return {name: i for i, name in enumerate(self.names)}

    def block(self, prefix: str) -> npt.NDArray[np.intp]:
        """Return the indices of the states called `prefix` or ``prefix:...``, in order."""
        return _block(self.names, prefix)

    def __len__(self) -> int:
        return len(self.names)


@dataclass(frozen=True, eq=False)
class State:
    """A Gaussian belief: mean, covariance and the names of its scalars. An empty one means: not started.

    `aside` is what an estimator keeps beside the belief and nobody else reads, an immutable value: the
    attitude about which its small angles turn, what it has seen of residuals.
    """

    t_ns: int
    mean: FloatArray
    P: FloatArray
    layout: Layout
    aside: Any = None

    def __post_init__(self) -> None:
        freeze(self, "mean", "P")
        n = len(self.layout)
        if self.mean.shape != (n,) or self.P.shape != (n, n):
            raise ValueError(
                f"`mean` {self.mean.shape} and `P` {self.P.shape} do not fit a layout of {n} states"
            )

    @staticmethod
    def empty(t_ns: int = 0) -> State:
        """Return the state of a filter that has not started."""
        return State(t_ns, np.zeros(0), np.zeros((0, 0)), Layout())

    def __len__(self) -> int:
        return len(self.layout)

    def block(self, prefix: str) -> tuple[FloatArray, FloatArray]:
        """Return mean and covariance of the states under `prefix`."""
        i = self.layout.block(prefix)
        return self.mean[i], self.P[np.ix_(i, i)]


@dataclass(frozen=True, eq=False)
class Prior:
    """A prediction: the prior state and the linear step that made it, ``x' = F x + w``, ``w ~ N(0, Q)``.

    `consumed` counts the states initialised from this epoch's own data: each takes a degree of freedom from a
    test of this epoch. `events` tells in words what happened (a start, a clock jump, a gap). `context` is
    what the estimator hands to its own `correct` so that nothing is computed twice.
    """

    state: State
    F: FloatArray
    Q: FloatArray
    consumed: int = 0
    events: tuple[str, ...] = ()
    context: Any = None

    def __post_init__(self) -> None:
        freeze(self, "F", "Q")
