"""A simulated receiver: broadcast ephemerides and a trajectory in, a table of signals out, faults and all.

Ranges, range rates and delays come from the code that the estimators use (`sensors.ranges`,
`physics.atmosphere`), and the errors from a `NoiseModel`: white noise, multipath and a bias of each satellite
as first-order Gauss-Markov processes. The table can be written as RINEX, or turned into epochs at once
(`epochs_of`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from pntegrity.physics.atmosphere import klobuchar_m, troposphere_m
from pntegrity.physics.frames import elevation_azimuth
from pntegrity.physics.gnss_epochs import gnss_epochs
from pntegrity.physics.orbits import satellite_states
from pntegrity.physics.signals import frequency_hz
from pntegrity.physics.tables import Navigation, SignalTable
from pntegrity.records import Epoch, FloatArray
from pntegrity.sensors.noise import NoiseModel
from pntegrity.sensors.ranges import C_MPS, geometry, range_rate
from pntegrity.simulate.faults import Fault, signature
from pntegrity.simulate.trajectory import Trajectory

__all__ = ["Receiver", "Simulated", "epochs_of", "keep_only", "simulate", "with_faults"]

SIGNALS = {"G": "1C", "E": "1C", "C": "2I", "R": "1C"}


@dataclass(frozen=True)
class Receiver:
    """What the simulated receiver is like.

    Parameters
    ----------
    noise : NoiseModel
        Errors of code and range rate, and the walk of the clock; the receiver's smoothing of code is not
        simulated.
    scale : float
        Multiplies all random errors; 0: none.
    carrier_m : float
        Carrier noise at the zenith, m.
    mask_rad : float
        Satellites below this elevation are not tracked.
    clock_m, drift_mps : float
        Clock at the first epoch.
    """

    noise: NoiseModel = field(default_factory=NoiseModel)
    scale: float = 1.0
    carrier_m: float = 0.002
    mask_rad: float = float(np.deg2rad(5.0))
    clock_m: float = 2000.0
    drift_mps: float = 0.5


@dataclass(frozen=True, eq=False)
class Simulated:
    """The signals and the truth behind them: position and velocity (n, 3), clock and its drift (n,)."""

    table: SignalTable
    position_m: FloatArray
    velocity_mps: FloatArray
    clock_m: FloatArray
    drift_mps: FloatArray


@dataclass(frozen=True, eq=False)
class _Rows:
    """One row an epoch and tracked satellite, in that order; what the signals would be without noise."""

    epoch: npt.NDArray[np.int32]
    sat: npt.NDArray[np.intp]
    code_m: FloatArray
    rate_mps: FloatArray
    carrier_m: FloatArray
    el_rad: FloatArray

    def select(self, rows: npt.NDArray[np.bool_]) -> _Rows:
        """Return only some rows."""
        return _Rows(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))


def simulate(
    nav: Navigation,
    trajectory: Trajectory,
    t_ns: npt.NDArray[np.int64],
    receiver: Receiver,
    rng: np.random.Generator,
) -> Simulated:
    """Return what a receiver would observe.

    Parameters
    ----------
    nav : Navigation
        Ephemerides, of a file or nominal ones (`constellation.nominal_navigation`); one signal a satellite.
    trajectory : callable
        See `trajectory`; its time counts from ``t_ns[0]``.
    t_ns : ndarray of int64, shape (n,)
        Time tags of the receiver, ns of GPS time, rising.
    receiver : Receiver
    rng : numpy.random.Generator
    """
    clock, drift = _clock(t_ns, receiver, rng)
    since = (
        t_ns - t_ns[0]
    ) * 1e-9 - clock / C_MPS  # the tag is the receiver's time, the place that of true time
    states = [trajectory(float(t)) for t in since]
    position, velocity = np.array([s[0] for s in states]), np.array([s[1] for s in states])
    truth = (position, velocity, clock, drift)
    sats = _satellites(nav)
    rows = _noiseless(nav, sats, t_ns, truth, receiver)
    return Simulated(_table(nav, sats, t_ns, rows, position[0], receiver, rng), *truth)


def epochs_of(table: SignalTable, nav: Navigation) -> list[Epoch]:
    """Return the epochs that an estimator takes: but for rounding those of the table written as RINEX."""
    return list(gnss_epochs(table, nav, systems=table.systems).epochs)


def _satellites(nav: Navigation) -> npt.NDArray[np.str_]:
    found = {r.satellite for r in (*nav.kepler, *nav.glonass)}
    return np.array(sorted(s for s in found if s[0] in SIGNALS))


def _clock(
    t_ns: npt.NDArray[np.int64], receiver: Receiver, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return phase (m) and drift (m/s): the integral of a walking drift, and a walk of its own."""
    dt = np.diff(t_ns) * 1e-9
    root = receiver.scale * np.sqrt(dt)
    steps = rng.standard_normal((2, len(dt)))
    drift = receiver.drift_mps + np.append(0.0, np.cumsum(receiver.noise.clock_drift_mps * root * steps[0]))
    moved = 0.5 * (drift[1:] + drift[:-1]) * dt + receiver.noise.clock_m * root * steps[1]
    return receiver.clock_m + np.append(0.0, np.cumsum(moved)), drift


def _noiseless(
    nav: Navigation,
    sats: npt.NDArray[np.str_],
    t_ns: npt.NDArray[np.int64],
    truth: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    receiver: Receiver,
) -> _Rows:
    """Find the times of emission by iteration: a pass shrinks the error by the speed over that of light."""
    n, m = len(t_ns), len(sats)
    epoch, sat = np.repeat(np.arange(n, dtype=np.int32), m), np.tile(np.arange(m), n)
    code = np.full(n * m, 0.075 * C_MPS)
    rows = _Rows(epoch, sat, code, code, code, code)
    for mask_rad in (receiver.mask_rad - 0.02, receiver.mask_rad, -np.pi):
        rows = _pass(nav, sats, t_ns, truth, rows)
        rows = rows.select(rows.el_rad >= mask_rad)
    return rows


def _pass(
    nav: Navigation,
    sats: npt.NDArray[np.str_],
    t_ns: npt.NDArray[np.int64],
    truth: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    rows: _Rows,
) -> _Rows:
    names = sats[rows.sat]
    signals = [SIGNALS[s[0]] for s in names.tolist()]
    states = satellite_states(nav, names, t_ns[rows.epoch], rows.code_m, signals)
    freq = _frequencies(nav, sats)[rows.sat]
    rows = rows.select(states.ok)
    freq = freq[states.ok]
    parts = [
        getattr(states, f)[states.ok] for f in ("position_m", "velocity_mps", "clock_m", "clock_rate_mps")
    ]
    bounds = np.searchsorted(rows.epoch, np.arange(len(t_ns) + 1))
    out = [
        _epoch(nav, int(t_ns[k]), [part[k] for part in truth], [p[i:j] for p in parts], freq[i:j])
        for k, (i, j) in enumerate(pairwise(bounds.tolist()))
    ]
    return _Rows(rows.epoch, rows.sat, *(np.concatenate(columns) for columns in zip(*out, strict=True)))


def _epoch(
    nav: Navigation, t_ns: int, truth: Sequence[FloatArray], sv: Sequence[FloatArray], freq_hz: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return code, range rate, carrier and elevation of one epoch's satellites."""
    position, velocity, clock, drift = truth
    sv_pos, sv_vel, sv_clk, sv_rate = sv
    g = geometry(position, sv_pos)
    el, az = elevation_azimuth(position, g.los)
    air = troposphere_m(position, el, t_ns)
    ionosphere = klobuchar_m(nav.klobuchar.get("G"), position, el, az, t_ns, freq_hz)
    straight = g.range_m + clock - sv_clk + air
    rate = range_rate(velocity, position, sv_pos, sv_vel, g.los) + drift - sv_rate
    return straight + ionosphere, rate, straight - ionosphere, el


def _frequencies(nav: Navigation, sats: npt.NDArray[np.str_]) -> FloatArray:
    channels = nav.glonass_channels
    return np.array([frequency_hz(s, SIGNALS[s[0]], channels.get(s)) for s in sats.tolist()])


def _table(
    nav: Navigation,
    sats: npt.NDArray[np.str_],
    t_ns: npt.NDArray[np.int64],
    rows: _Rows,
    approx_m: FloatArray,
    receiver: Receiver,
    rng: np.random.Generator,
) -> SignalTable:
    """Add the errors, and make a table of signals."""
    noise, names = receiver.noise, sats[rows.sat]
    cn0 = np.round(4.0 * (38.0 + 12.0 * np.sin(rows.el_rad))) / 4.0
    factor = noise.code_factor(tuple(names.tolist()))
    zenith, slow = noise.scale(rows.el_rad, cn0), noise.obliquity(rows.el_rad)
    at = rows.epoch, rows.sat
    dt = np.diff(t_ns, prepend=t_ns[0]) * 1e-9
    size = len(dt), len(sats)
    multipath = (
        noise.code_multipath_m * gauss_markov(dt, rng.standard_normal(size), noise.code_multipath_tau_s)[at]
    )
    bias = noise.code_bias_m * gauss_markov(dt, rng.standard_normal(size), noise.code_bias_tau_s)[at]
    white = rng.standard_normal((3, len(names)))
    errors = factor * (zenith * (noise.code_white_m * white[0] + multipath) + slow * bias)
    wave = C_MPS / _frequencies(nav, sats)
    whole = rng.integers(-1_000_000, 1_000_000, len(sats))  # carrier ambiguities, cycles
    carrier = rows.carrier_m + receiver.scale * receiver.carrier_m * zenith * white[2]
    rate = rows.rate_mps + receiver.scale * noise.doppler_mps * zenith * white[1]
    return SignalTable(
        t_ns=t_ns,
        epoch=rows.epoch,
        sat=names,
        signal=np.array([SIGNALS[s[0]] for s in names.tolist()], dtype="<U2"),
        pseudorange_m=rows.code_m + receiver.scale * errors,
        carrier_cycles=carrier / wave[rows.sat] + whole[rows.sat],
        doppler_hz=-rate / wave[rows.sat],
        cn0_dbhz=cn0,
        lli=np.zeros(len(names), dtype=np.int8),
        marker="SIMULATED",
        receiver="pntegrity",
        approx_position_m=approx_m,
        interval_s=float(np.median(dt[1:])) if len(dt) > 1 else None,
        glonass_channels={s: c for s, c in nav.glonass_channels.items() if s in set(names.tolist())},
    )


def gauss_markov(dt: FloatArray, drawn: FloatArray, tau_s: float) -> FloatArray:
    """Return stationary first-order processes of unit variance, made of white ones of the same shape
    (len(dt), m).
    """
    out = drawn.copy()
    for k in range(1, len(dt)):
        keep = np.exp(-dt[k] / tau_s)
        out[k] = keep * out[k - 1] + np.sqrt(1.0 - keep**2) * drawn[k]
    return out


def keep_only(table: SignalTable, wanted: Callable[[float, str], bool]) -> SignalTable:
    """Return the rows for which ``wanted(seconds since the first epoch, satellite)`` is True."""
    since = ((table.t_ns - table.t_ns[0]) * 1e-9)[table.epoch].tolist()
    rows = np.array([wanted(t, s) for t, s in zip(since, table.sat.tolist(), strict=True)], dtype=bool)
    columns = ("epoch", "sat", "signal", "pseudorange_m", "carrier_cycles", "doppler_hz", "cn0_dbhz", "lli")
    return replace(table, **{name: getattr(table, name)[rows] for name in columns})


def with_faults(table: SignalTable, faults: Sequence[Fault]) -> SignalTable:
    """Return the table with faults in it: what `faults.apply_faults` does to epochs, done to signals."""
    sat, signal = table.sat.tolist(), table.signal.tolist()
    wave = np.array([_wavelength(table, s, x) for s, x in zip(sat, signal, strict=True)])
    shift = np.zeros((3, len(sat)))
    bounds = np.searchsorted(table.epoch, np.arange(len(table.t_ns) + 1)).tolist()
    first = int(table.t_ns[0])
    for t, (i, j) in zip(table.t_ns.tolist(), pairwise(bounds), strict=True):
        for row, letter in enumerate("CLD"):
            keys = [f"{s}:{letter}{x}" for s, x in zip(sat[i:j], signal[i:j], strict=True)]
            shift[row, i:j] = sum((signature(f, keys, t, first) for f in faults), np.zeros(j - i))
    touched = shift != 0.0
    return replace(
        table,
        pseudorange_m=np.where(touched[0], table.pseudorange_m + shift[0], table.pseudorange_m),
        carrier_cycles=np.where(touched[1], table.carrier_cycles + shift[1] / wave, table.carrier_cycles),
        doppler_hz=np.where(touched[2], table.doppler_hz - shift[2] / wave, table.doppler_hz),
    )


def _wavelength(table: SignalTable, sat: str, signal: str) -> float:
    return C_MPS / frequency_hz(sat, signal, table.glonass_channels.get(sat))
