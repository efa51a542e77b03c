"""The linear simulator: a filter's gains once, white innovations drawn, faults carried through exactly.

The model is ``x_k = F x_{k-1} + w``, ``z_k = H x_k + v``. Gains do not depend on data, so a thousand runs
cost one matrix product an epoch. What is not noise moves the means only. With the error ``e = x_hat - x``:

    e'_k = F e_{k-1} - b_k,  g_k = f_k - H e'_k,  e_k = e'_k + K g_k + a_k

where ``f`` is a fault on the rows, ``b`` an unexpected push of the true state, ``a`` one added to the
filter's estimate, and ``g`` the mean of the innovation (design, section 2; there with ``a = b = 0``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pntegrity.kernels.linear import cholesky
from pntegrity.records import Epoch, FloatArray, Layout, Observation, Prior, State, Update

__all__ = [
    "SPP_STATES", "Disturbance", "LinearModel", "draw", "filter_drift_fault", "gains", "linear_epochs",
    "linear_updates", "receiver_drift_fault", "shifts", "spp_model", "whites",
]  # fmt: skip

SPP_STATES = Layout(("pos:x", "pos:y", "pos:z", "vel:x", "vel:y", "vel:z", "clk", "drift"))


@dataclass(frozen=True, eq=False)
class LinearModel:
    """A linear system with Gaussian noise; a matrix is constant (2-D) or one an epoch (3-D, epoch first).

    Parameters
    ----------
    F, Q : ndarray, shapes (n, n)
        Transition and process noise of a step.
    H, R : ndarray, shapes (m, n) and (m, m)
        Jacobian and covariance of the rows.
    P0 : ndarray, shape (n, n)
        Covariance of the prior at the first epoch.
    keys : tuple of str, length m
        Names of the rows.
    layout : Layout
        Names of the states.
    interval_s : float
        Time between epochs, s.
    """

    F: FloatArray
    Q: FloatArray
    H: FloatArray
    R: FloatArray
    P0: FloatArray
    keys: tuple[str, ...]
    layout: Layout
    interval_s: float = 1.0

    def __post_init__(self) -> None:
        n, m = len(self.layout), len(self.keys)
        for name, shape in (("F", (n, n)), ("Q", (n, n)), ("H", (m, n)), ("R", (m, m)), ("P0", (n, n))):
            if getattr(self, name).shape[-2:] != shape:
                raise ValueError(f"`{name}` must end in shape {shape}, not {getattr(self, name).shape}")

    def at(self, name: str, k: int) -> FloatArray:
        """Return matrix `name` of epoch `k`."""
        a: FloatArray = getattr(self, name)
        return a[k] if a.ndim == 3 else a

    def t_ns(self, k: int) -> int:
        """Return the time of epoch `k`, ns; the first is at one interval, since time 0 means: not started."""
        return round((k + 1) * self.interval_s * 1e9)


@dataclass(frozen=True, eq=False)
class Disturbance:
    """What happens beside noise, one row an epoch; None: nothing.

    Parameters
    ----------
    rows : ndarray, shape (epochs, m), optional
        Added to the measurements (``f``).
    truth : ndarray, shape (epochs, n), optional
        Added to the true state at the step into the epoch (``b``): the filter's dynamics do not expect it.
    estimate : ndarray, shape (epochs, n), optional
        Added to the filter's state estimate after the update (``a``).
    """

    rows: FloatArray | None = None
    truth: FloatArray | None = None
    estimate: FloatArray | None = None

    def at(self, k: int, m: int, n: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return ``f``, ``b`` and ``a`` of epoch `k`."""
        parts = ((self.rows, m), (self.truth, n), (self.estimate, n))
        f, b, a = (np.zeros(size) if part is None else part[k] for part, size in parts)
        return f, b, a


def gains(model: LinearModel, epochs: int) -> tuple[Update, ...]:
    """Return the filter's updates without data (innovations 0): all that its tests need but the noise.

    The first update is a start: it inherits nothing, and its prior covariance is `P0`.
    """
    n = len(model.layout)
    zero, no_rows = np.zeros(n), np.zeros(len(model.keys))
    first = State(model.t_ns(0), zero, model.P0, model.layout)
    prior = Prior(first, np.zeros((n, 0)), model.P0)
    out = [Update.of(prior, model.keys, no_rows, model.at("H", 0), model.at("R", 0))]
    for k in range(1, epochs):
        F, Q = model.at("F", k), model.at("Q", k)
        P = F @ out[-1].posterior.P @ F.T + Q
        prior = Prior(State(model.t_ns(k), zero, 0.5 * (P + P.T), model.layout), F, Q)
        out.append(Update.of(prior, model.keys, no_rows, model.at("H", k), model.at("R", k)))
    return tuple(out)


def shifts(updates: Sequence[Update], disturbance: Disturbance) -> tuple[FloatArray, FloatArray]:
    """Return the means that a disturbance gives to innovations (epochs, m) and state errors (epochs, n)."""
    m, n = len(updates[0].keys), len(updates[0].posterior)
    g, e = np.zeros((len(updates), m)), np.zeros((len(updates), n))
    for k, u in enumerate(updates):
        f, b, a = disturbance.at(k, m, n)
        prior = (u.F @ e[k - 1] if k else np.zeros(n)) - b
        g[k] = f - u.H @ prior
        e[k] = prior + u.K @ g[k] + a
    return g, e


def whites(
    updates: Sequence[Update], rng: np.random.Generator, runs: int, g: FloatArray | None = None
) -> FloatArray:
    """Return drawn whitened innovations ``L^-1 nu`` of mean ``L^-1 g``, shape (epochs, m, runs)."""
    out = rng.standard_normal((len(updates), len(updates[0].keys), runs))
    if g is not None:
        out += np.stack([np.linalg.solve(u.L, s) for u, s in zip(updates, g, strict=True)])[:, :, None]
    return out


def draw(
    updates: Sequence[Update], white: FloatArray, estimate: FloatArray | None = None
) -> tuple[Update, ...]:
    """Return the updates of one run: innovations ``L white`` and the estimates that follow from them.

    Parameters
    ----------
    updates : sequence of Update
        Of `gains`.
    white : ndarray, shape (epochs, m)
    estimate : ndarray, shape (epochs, n), optional
        What is added to the filter's estimate (as in `Disturbance`).
    """
    out = []
    mean = np.zeros(updates[0].F.shape[1])
    for k, u in enumerate(updates):
        nu = u.L @ white[k]
        before = u.F @ mean
        mean = before + u.K @ nu + (0.0 if estimate is None else estimate[k])
        run = replace(
            u, nu=nu, prior=replace(u.prior, mean=before), posterior=replace(u.posterior, mean=mean)
        )
        run.__dict__.update(
            {name: u.__dict__[name] for name in ("S", "L", "K", "absorbed") if name in u.__dict__}
        )
        out.append(run)
    return tuple(out)


def linear_updates(
    model: LinearModel, epochs: int, rng: np.random.Generator, disturbance: Disturbance | None = None
) -> tuple[Update, ...]:
    """Return the updates of one run of the model's Kalman filter, its innovations drawn white.

    Parameters
    ----------
    model : LinearModel
    epochs : int
    rng : numpy.random.Generator
    disturbance : Disturbance, optional
        Faults; they move the means exactly as they would in a real run.
    """
    updates = gains(model, epochs)
    happening = disturbance or Disturbance()
    g, _ = shifts(updates, happening)
    return draw(updates, whites(updates, rng, 1, g)[:, :, 0], happening.estimate)


def linear_epochs(
    model: LinearModel, epochs: int, rng: np.random.Generator, disturbance: Disturbance | None = None
) -> tuple[list[Epoch], FloatArray]:
    """Return measurements of a drawn truth (sensor ``"linear"``) for any filter, and that truth."""
    n, m = len(model.layout), len(model.keys)
    happening = disturbance or Disturbance()
    x = _root(model.P0) @ rng.standard_normal(n)
    out, truth = [], np.zeros((epochs, n))
    for k in range(epochs):
        f, b, _ = happening.at(k, m, n)
        if k:
            x = model.at("F", k) @ x + _root(model.at("Q", k)) @ rng.standard_normal(n)
        x = x + b
        y = model.at("H", k) @ x + cholesky(model.at("R", k)) @ rng.standard_normal(m) + f
        t_ns = model.t_ns(k)
        out.append(Epoch(t_ns, (Observation("linear", t_ns, model.keys, y),)))
        truth[k] = x
    return out, truth


def _root(cov: FloatArray) -> FloatArray:
    """Return a root of a covariance that may be singular."""
    values, vectors = np.linalg.eigh(cov)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def spp_model(
    n_satellites: int = 10,
    *,
    code_m: float = 1.0,
    rate_mps: float = 0.1,
    accel_mps2: float = 0.1,
    clock_m: float = 0.01,
    clock_drift_mps: float = 0.01,
    angles_rad: tuple[FloatArray, FloatArray] | None = None,
    rng: np.random.Generator | None = None,
) -> LinearModel:
    """Return the filter of the literature's SPP simulations: 8 states, code and range rate at 1 Hz.

    Parameters
    ----------
    n_satellites : int
        Satellites, the same throughout.
    code_m, rate_mps : float
        Standard deviations of code (m) and range rate (m/s).
    accel_mps2 : float
        White acceleration, m/s^2/sqrt(Hz).
    clock_m, clock_drift_mps : float
        Receiver clock: random walk of phase, m/sqrt(s), and of drift, m/s/sqrt(s).
    angles_rad : pair of ndarray, shape (n_satellites,), optional
        Elevations and azimuths; drawn uniformly over the sky above 10 degrees where not given.
    rng : numpy.random.Generator, optional
        For the draw; that of seed 0 where not given, so that the default geometry is always the same.
    """
    el, az = angles_rad if angles_rad is not None else _sky(n_satellites, rng or np.random.default_rng(0))
    los = np.stack([np.cos(el) * np.sin(az), np.cos(el) * np.cos(az), np.sin(el)], axis=1)
    n = len(el)
    H = np.zeros((2 * n, 8))
    H[:n, :3], H[:n, 6], H[n:, 3:6], H[n:, 7] = -los, 1.0, -los, 1.0
    R = np.diag(np.repeat([code_m**2, rate_mps**2], n))
    F, Q = _motion(accel_mps2, clock_m, clock_drift_mps)
    P0 = np.diag(np.repeat([100.0, 10.0, 100.0, 10.0], (3, 3, 1, 1)) ** 2)
    keys = tuple(f"G{i + 1:02d}:{signal}" for signal in ("C1C", "D1C") for i in range(n))
    return LinearModel(F, Q, H, R, P0, keys, SPP_STATES)


def _sky(n: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    az = rng.uniform(0.0, 2.0 * np.pi, n)
    return np.arcsin(rng.uniform(np.sin(np.deg2rad(10.0)), 1.0, n)), az


def _motion(
    accel_mps2: float, clock_m: float, clock_drift_mps: float, dt: float = 1.0
) -> tuple[FloatArray, FloatArray]:
    F, Q = np.eye(8), np.zeros((8, 8))
    for level, slope, q in [(i, i + 3, accel_mps2**2) for i in range(3)] + [(6, 7, clock_drift_mps**2)]:
        F[level, slope] = dt
        Q[level, level], Q[slope, slope] = q * dt**3 / 3.0, q * dt
        Q[level, slope] = Q[slope, level] = q * dt**2 / 2.0
    Q[6, 6] += clock_m**2 * dt
    return F, Q


def receiver_drift_fault(model: LinearModel, drift_mps: FloatArray) -> Disturbance:
    """Return the fault of a receiver clock whose true drift has an extra course `drift_mps` (epochs,), m/s.

    The clock's phase follows by the model's own `F` and stays where it is when the drift has come back.
    """
    truth = np.zeros((len(drift_mps), len(model.layout)))
    truth[:, model.layout.index["drift"]] = np.diff(drift_mps, prepend=0.0)
    return Disturbance(truth=truth)


def filter_drift_fault(model: LinearModel, drift_mps: FloatArray) -> Disturbance:
    """Return the fault of a filter to whose drift estimate `drift_mps` (epochs,) is added at every update."""
    estimate = np.zeros((len(drift_mps), len(model.layout)))
    estimate[:, model.layout.index["drift"]] = drift_mps
    return Disturbance(estimate=estimate)
