"""The values that flow from a sensor to a verdict.

Everything here is immutable: frozen dataclasses whose arrays are made read-only when they are built. SI units and
radians throughout; time is int nanoseconds of GPS time (``t_ns``), counted from the GPS epoch 1980-01-06.

Symbols (the same everywhere): ``x'`` prior state, ``x`` posterior, ``P'``/``P`` their covariances, ``F`` transition from
the previous posterior to this prior (rectangular: states are born and die), ``Q`` process noise, ``H`` Jacobian of the
rows, ``R`` their covariance, ``nu = z - h(x')`` the innovation, ``S = H P' H^T + R`` its covariance, ``K`` the gain.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from pntegrity.kernels.linear import cholesky, gain, whiten
from pntegrity.kernels.sparse import sandwich

FloatArray = npt.NDArray[np.float64]
Status = Literal["ok", "alert", "unavailable"]

__all__ = [
    "Epoch", "FloatArray", "Layout", "Observation", "Prior", "State", "Status", "Suspect", "Update", "Verdict", "group_of",
]  # fmt: skip


def group_of(key: str) -> str:
    """Return what fails together with a row: the part of its key before the first colon (``"G05:C1C"`` -> ``"G05"``)."""
    return key.partition(":")[0]


def frozen(a: npt.ArrayLike) -> FloatArray:
    """Return a read-only float64 array of `a` (a view where `a` already is one)."""
    out = np.asarray(a, dtype=np.float64).view()
    out.flags.writeable = False
    return out


def _freeze(obj: object, *names: str) -> None:
    for name in names:
        object.__setattr__(obj, name, frozen(getattr(obj, name)))


@dataclass(frozen=True, eq=False)
class Observation:
    """What one sensor said at one instant.

    Parameters
    ----------
    sensor : str
        Which model in ``sensors/`` explains the rows: ``"code"``, ``"doppler"``, ``"carrier"``, ...
    t_ns : int
        Time of reception, ns of GPS time.
    keys : tuple of str
        One name a row, ``"<group>:<signal>"``: ``"G05:C1C"``, ``"lbl:AP1"``.
    y : ndarray, shape (n,)
        Measured values, SI units of the sensor (metres, metres per second, ...).
    sigma : ndarray, shape (n,), optional
        Standard deviations that the source itself declares; None where the noise model decides.
    aux : mapping of str to ndarray
        What the sensor's model needs beside the state, first axis the row (satellite position, clock, C/N0, ...).
    """

    sensor: str
    t_ns: int
    keys: tuple[str, ...]
    y: FloatArray
    sigma: FloatArray | None = None
    aux: Mapping[str, npt.NDArray[Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        _freeze(self, "y")
        if self.sigma is not None:
            _freeze(self, "sigma")
        object.__setattr__(self, "aux", MappingProxyType(dict(self.aux)))
        if len(self.keys) != len(self.y) or any(len(v) != len(self.y) for v in self.aux.values()):
            raise ValueError(f"`keys`, `y` and every `aux` of sensor {self.sensor!r} must have the same length")

    def __reduce__(self) -> tuple[Any, ...]:
        return (type(self), (self.sensor, self.t_ns, self.keys, self.y, self.sigma, dict(self.aux)))

    def select(self, rows: npt.NDArray[Any]) -> Observation:
        """Return the observation with only `rows` (a mask or an index array), in that order."""
        index = np.arange(len(self.keys))[rows]
        sigma = None if self.sigma is None else self.sigma[index]
        return replace(
            self,
            keys=tuple(self.keys[i] for i in index),
            y=self.y[index],
            sigma=sigma,
            aux={name: values[index] for name, values in self.aux.items()},
        )


@dataclass(frozen=True, eq=False)
class Epoch:
    """All observations of one instant, and what was dropped on the way to it (`notes`: reasons, in words)."""

    t_ns: int
    observations: tuple[Observation, ...] = ()
    notes: tuple[str, ...] = ()

    def sensor(self, name: str) -> Observation | None:
        """Return the observation of sensor `name`, or None."""
        return next((o for o in self.observations if o.sensor == name), None)


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
        hits = [i for i, n in enumerate(self.names) if n == prefix or n.startswith(prefix + ":")]
        return np.array(hits, dtype=np.intp)

    def __len__(self) -> int:
        return len(self.names)


@dataclass(frozen=True, eq=False)
class State:
    """A Gaussian belief: mean, covariance and the names of its scalars. An empty one means: not started."""

    t_ns: int
    mean: FloatArray
    P: FloatArray
    layout: Layout

    def __post_init__(self) -> None:
        _freeze(self, "mean", "P")
        n = len(self.layout)
        if self.mean.shape != (n,) or self.P.shape != (n, n):
            raise ValueError(f"`mean` {self.mean.shape} and `P` {self.P.shape} do not fit a layout of {n} states")

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

    `consumed` counts the states initialised from this epoch's own data: each takes a degree of freedom from a test of
    this epoch. `events` tells in words what happened (a start, a clock jump, a gap).
    """

    state: State
    F: FloatArray
    Q: FloatArray
    consumed: int = 0
    events: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        _freeze(self, "F", "Q")


@dataclass(frozen=True, eq=False)
class Update:
    """One epoch of any linear(ised) filter: all that a monitor may see.

    Parameters
    ----------
    t_ns : int
        Time, ns of GPS time.
    keys : tuple of str, length m
        Names of the rows that were used.
    nu : ndarray, shape (m,)
        Innovation ``z - h(x')``.
    H, R : ndarray, shapes (m, n) and (m, m)
        Jacobian and covariance of the rows.
    F, Q : ndarray, shapes (n, n_previous) and (n, n)
        The step from the previous posterior to `prior`.
    prior, posterior : State
        Before and after the rows were used.
    excluded : tuple of str
        Groups whose rows were left out.
    consumed : int
        States initialised from this epoch's data.
    events : tuple of str
        What happened, in words.
    reason : str
        Why there are no rows, where there are none.
    spare_keys, spare_nu, spare_var
        Rows that were left out: names, residuals against `posterior` and their variances.
    aux : mapping of str to ndarray
        For reports only (elevation, azimuth, C/N0 a row).
    """

    t_ns: int
    keys: tuple[str, ...]
    nu: FloatArray
    H: FloatArray
    R: FloatArray
    F: FloatArray
    Q: FloatArray
    prior: State
    posterior: State
    excluded: tuple[str, ...] = ()
    consumed: int = 0
    events: tuple[str, ...] = ()
    reason: str = ""
    spare_keys: tuple[str, ...] = ()
    spare_nu: FloatArray = field(default_factory=lambda: np.zeros(0))
    spare_var: FloatArray = field(default_factory=lambda: np.zeros(0))
    aux: Mapping[str, npt.NDArray[Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        _freeze(self, "nu", "H", "R", "F", "Q", "spare_nu", "spare_var")

    @cached_property
    def S(self) -> FloatArray:
        """Innovation covariance, shape (m, m)."""
        return frozen(sandwich(self.H, self.prior.P) + self.R)

    @cached_property
    def L(self) -> FloatArray:
        """Lower Cholesky factor of `S`."""
        return frozen(cholesky(self.S))

    @cached_property
    def K(self) -> FloatArray:
        """Gain ``P' H^T S^-1``, shape (n, m)."""
        return frozen(gain(self.prior.P, self.H, self.L))

    @cached_property
    def absorbed(self) -> FloatArray:
        """What the rows took from the covariance, ``P' - P = K S K^T``: the covariance of ``K nu``."""
        return frozen(self.prior.P - self.posterior.P)

    @cached_property
    def white(self) -> FloatArray:
        """Whitened innovation ``L^-1 nu``: independent unit normals under the null hypothesis, shape (m,)."""
        return frozen(whiten(self.L, self.nu))

    def groups(self) -> dict[str, npt.NDArray[np.intp]]:
        """Return the rows of each group, in order of first appearance."""
        rows: dict[str, list[int]] = {}
        for i, key in enumerate(self.keys):
            rows.setdefault(group_of(key), []).append(i)
        return {g: np.array(i, dtype=np.intp) for g, i in rows.items()}


@dataclass(frozen=True)
class Suspect:
    """Who may be at fault, and how: `kind` ``"bias"`` (size in units of the row) or ``"ramp"`` (units per second)."""

    groups: tuple[str, ...]
    kind: str
    size: float
    onset_ns: int
    statistic: float


@dataclass(frozen=True)
class Verdict:
    """What one monitor says of one epoch.

    `status` is three-valued: ``unavailable`` (no test possible, with the `reason`) is never ``ok``. `statistic` and
    `threshold` are finite where a test was made and 0 otherwise; `p_fa` is the probability of a false alarm that the
    threshold stands for; `suspects` are ordered, the most likely first; `ambiguous` tells that the data do not
    single out the first.
    """

    monitor: str
    variant: str
    t_ns: int
    status: Status
    statistic: float = 0.0
    threshold: float = 0.0
    p_fa: float = 0.0
    dof: int = 0
    suspects: tuple[Suspect, ...] = ()
    ambiguous: bool = False
    reason: str = ""

    @property
    def suspect_groups(self) -> tuple[str, ...]:
        """Groups of the first suspect."""
        return self.suspects[0].groups if self.suspects else ()


def join_reasons(reasons: Iterable[str]) -> str:
    """Return distinct non-empty reasons in order, joined by semicolons."""
    return "; ".join(dict.fromkeys(r for r in reasons if r))
