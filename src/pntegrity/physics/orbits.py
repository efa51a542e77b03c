"""Satellite positions, velocities and clocks from broadcast ephemerides, for all rows of a file at once.

Which ephemeris: the nearest reference time; for Galileo, which sends messages of the past ten minutes, the
last one before (both as RTKLIB takes it); the latest upload among equals. Kepler records are evaluated by
sidereon; GLONASS state vectors in `physics.glonass`. sidereon's own store is not asked to choose: it passes
from one ephemeris to the next inside a difference quotient, hides unhealthy satellites as missing ones, and
keeps no F/NAV records.

Clocks: ``sv_clk_m = c * (polynomial + relativity - group delay of the signal)``, so that
``pseudorange = range + c dt_receiver - sv_clk_m + delays``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from pntegrity.physics._rows import rows_by_kind
from pntegrity.physics.ephemeris import accuracy_m, is_healthy, toc_ns
from pntegrity.physics.glonass import glonass_states
from pntegrity.physics.group_delays import group_delay_s, wants_fnav
from pntegrity.physics.signals import SPEED_OF_LIGHT_MPS
from pntegrity.physics.tables import Navigation
from pntegrity.records import FloatArray

__all__ = ["MAX_AGE_S", "SatelliteStates", "satellite_states"]

MAX_AGE_S = {"G": 7_200.0, "J": 7_200.0, "E": 10_800.0, "C": 21_600.0, "R": 1_800.0}
"""Largest distance from the reference time at which an ephemeris is used, s (RTKLIB's limits)."""
GLONASS_SIGMA_M = 5.0
"""GLONASS messages before RINEX 3.05 tell no accuracy: RTKLIB's value."""
STEP_S = 0.02
"""Half-width of the central difference: 0.1 mm of curvature in the mean, under 0.02 mm/s of rounding."""


@dataclass(frozen=True, eq=False)
class SatelliteStates:
    """Satellites at their time of emission, one row each; rows that are not `ok` hold nan.

    Parameters
    ----------
    position_m, velocity_mps : ndarray, shape (n, 3)
        Earth-fixed frame of the time of emission (rotate by the travel time for that of reception).
    clock_m, clock_rate_mps : ndarray, shape (n,)
        Clock offset times the speed of light, with relativity and less the group delay of the signal; its
        rate.
    variance_m2 : ndarray, shape (n,)
        Of the range error that the message predicts (URA, SISA) for orbit and clock together.
    ok : ndarray of bool, shape (n,)
        Whether the row can be used.
    reason : ndarray of str objects, shape (n,)
        Why not, else an empty string: "no pseudorange", "no ephemeris", "too old", "unhealthy",
        "no accuracy stated", "no group delay for this signal".
    """

    position_m: FloatArray
    velocity_mps: FloatArray
    clock_m: FloatArray
    clock_rate_mps: FloatArray
    variance_m2: FloatArray
    ok: npt.NDArray[np.bool_]
    reason: npt.NDArray[np.object_]


@dataclass(frozen=True, eq=False)
class _Job:
    """Rows that one usable ephemeris serves."""

    record: Any
    delay_s: float
    toe: int
    rows: npt.NDArray[np.intp]
    t_rx_ns: npt.NDArray[np.int64]
    travel_s: FloatArray


def satellite_states(
    nav: Navigation,
    sats: npt.NDArray[np.str_],
    t_rx_ns: npt.NDArray[np.int64],
    pseudorange_m: FloatArray,
    signals: Sequence[str] | npt.NDArray[np.str_],
) -> SatelliteStates:
    """Return the satellites' states at the emission of what was received.

    Parameters
    ----------
    nav : Navigation
        Ephemerides.
    sats : ndarray of str, shape (n,)
        ``"G05"``.
    t_rx_ns : ndarray of int64, shape (n,)
        Receiver time tags, ns of GPS time; the emission time is tag - pseudorange / c - satellite clock
        offset, in which the receiver's clock offset cancels.
    pseudorange_m : ndarray, shape (n,)
        Pseudoranges on any one frequency.
    signals : sequence of str, length n
        Whose group delay to take off: ``"1C"``, or ``"1C+2W"`` for the ionosphere-free pair.

    Returns
    -------
    SatelliteStates
    """
    n = len(sats)
    out = SatelliteStates(
        position_m=np.full((n, 3), np.nan),
        velocity_mps=np.full((n, 3), np.nan),
        clock_m=np.full(n, np.nan),
        clock_rate_mps=np.full(n, np.nan),
        variance_m2=np.full(n, np.nan),
        ok=np.zeros(n, dtype=bool),
        reason=np.full(n, "no ephemeris", dtype=object),
    )
    if not n:
        return out
    names = np.char.add(np.char.add(sats.astype("<U3"), ":"), np.asarray(signals, dtype="<U5"))
    has_range = np.isfinite(pseudorange_m)
    out.reason[~has_range] = "no pseudorange"
    later: list[_Job] = []
    for kind, rows in rows_by_kind(names):
        sat, _, signal = kind.partition(":")
        rows = rows[has_range[rows]]
        for job in _jobs(
            nav, sat, signal, rows, t_rx_ns[rows], pseudorange_m[rows] / SPEED_OF_LIGHT_MPS, out
        ):
            if sat[0] == "R":
                later.append(job)
            else:
                _fill(out, job, _kepler_states(job.record, job.toe, job.t_rx_ns, job.travel_s))
    _fill_glonass(out, later)
    return out


def _jobs(
    nav: Navigation,
    sat: str,
    signal: str,
    rows: npt.NDArray[np.intp],
    t_rx_ns: npt.NDArray[np.int64],
    travel_s: FloatArray,
    out: SatelliteStates,
) -> Iterator[_Job]:
    """Yield for each ephemeris of a satellite the rows it serves; write the reasons of the others."""
    records, toe = nav.of(sat, fnav=wants_fnav(sat, signal))
    if not len(toe):
        return
    choose = _latest if sat[0] == "E" else _nearest
    which = choose(toe, t_rx_ns - np.rint(travel_s * 1e9).astype(np.int64))
    for i in np.unique(which).tolist():
        at = which == i
        delay = group_delay_s(records[i], signal)
        problem = _problem(records[i], delay)
        old = np.abs(t_rx_ns[at] - toe[i]) > MAX_AGE_S[sat[0]] * 1e9
        out.reason[rows[at]] = np.where(old, "too old", problem)
        at[at] = ~old & (problem == "")
        if at.any():
            yield _Job(records[i], delay, int(toe[i]), rows[at], t_rx_ns[at], travel_s[at])


def _nearest(toe: npt.NDArray[np.int64], t_ns: npt.NDArray[np.int64]) -> npt.NDArray[np.intp]:
    """Return for each time the index of the nearest reference time; of equal ones the last."""
    right = np.searchsorted(toe, t_ns, side="left").clip(0, len(toe) - 1)
    left = (np.searchsorted(toe, t_ns, side="left") - 1).clip(0, len(toe) - 1)
    near = np.where(np.abs(toe[right] - t_ns) < np.abs(toe[left] - t_ns), right, left)
    return np.asarray(np.searchsorted(toe, toe[near], side="right") - 1)


def _latest(toe: npt.NDArray[np.int64], t_ns: npt.NDArray[np.int64]) -> npt.NDArray[np.intp]:
    """Return for each time the index of the last reference time before it, or else the first after."""
    before = (np.searchsorted(toe, t_ns, side="left") - 1).clip(0, len(toe) - 1)
    return np.asarray(np.searchsorted(toe, toe[before], side="right") - 1)


def _fill(
    out: SatelliteStates, job: _Job, states: tuple[FloatArray, FloatArray, FloatArray, FloatArray]
) -> None:
    position, velocity, clock, rate = states
    out.position_m[job.rows], out.velocity_mps[job.rows] = position, velocity
    out.clock_m[job.rows] = SPEED_OF_LIGHT_MPS * (clock - job.delay_s)
    out.clock_rate_mps[job.rows] = SPEED_OF_LIGHT_MPS * rate
    sigma = GLONASS_SIGMA_M if job.record.satellite[0] == "R" else accuracy_m(job.record)
    out.variance_m2[job.rows] = sigma**2
    out.ok[job.rows] = True


def _fill_glonass(out: SatelliteStates, jobs: list[_Job]) -> None:
    """Integrate all GLONASS messages together: one by one, short arrays would cost most of the time."""
    if not jobs:
        return
    sizes = [len(j.rows) for j in jobs]
    toe = np.repeat([j.toe for j in jobs], sizes)
    since = (np.concatenate([j.t_rx_ns for j in jobs]) - toe) * 1e-9 - np.concatenate(
        [j.travel_s for j in jobs]
    )
    states = glonass_states([j.record for j in jobs], np.repeat(np.arange(len(jobs)), sizes), since)
    ends = np.cumsum(sizes)[:-1]
    for job, *parts in zip(jobs, *(np.split(s, ends) for s in states), strict=True):
        _fill(out, job, (parts[0], parts[1], parts[2], parts[3]))


def _problem(record: Any, delay: float) -> str:
    """Return why a record must not be used, or an empty string.

    Any health bit counts, whatever the signal: Galileo's E5b can be flagged alone, but a satellite under test
    is no satellite for integrity. (QZSS: the bit of the L6 signal is left out, as in RTKLIB.)
    """
    if record.satellite[0] == "R":
        return "" if record.is_healthy else "unhealthy"
    if not is_healthy(record):
        return "unhealthy"
    if np.isnan(accuracy_m(record)):
        return "no accuracy stated"
    return "no group delay for this signal" if np.isnan(delay) else ""


def _kepler_states(
    record: Any, toe: int, t_rx_ns: npt.NDArray[np.int64], travel_s: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return position, velocity, clock offset (without group delay) and its rate at emission."""
    c = record.clock
    since_toc = (t_rx_ns - toc_ns(record)) * 1e-9 - travel_s
    for _ in range(2):  # the polynomial is in time of emission, of which it is a part
        offset = c.af0 + since_toc * (c.af1 + since_toc * c.af2)
        since_toc = (t_rx_ns - toc_ns(record)) * 1e-9 - travel_s - offset
    tow = (t_rx_ns - toe) * 1e-9 - travel_s - offset + record.elements.toe_sow
    before, after = tow - STEP_S, tow + STEP_S
    a, b = _evaluate(record, before), _evaluate(record, after)
    mean, slope = 0.5 * (a + b), (b - a) / (after - before)[:, None]
    return mean[:, :3], slope[:, :3], mean[:, 3], slope[:, 3]


def _evaluate(record: Any, tow_s: FloatArray) -> FloatArray:
    """Return x, y, z (m) and the clock with relativity (s) at each time, shape (n, 4)."""
    states = [record.evaluate(t) for t in tow_s.tolist()]
    values = [(s.x_m, s.y_m, s.z_m, s.clock_polynomial_s + s.relativistic_clock_s) for s in states]
    return np.array(values, dtype=np.float64).reshape(-1, 4)
