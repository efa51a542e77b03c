"""Signals and ephemerides -> the epochs an estimator takes: one signal (or one pair) a satellite."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pntegrity.errors import InputError
from pntegrity.physics.orbits import SatelliteStates, satellite_states
from pntegrity.physics.signals import DEFAULT_PAIRS, DEFAULT_SIGNALS, SPEED_OF_LIGHT_MPS, WORDS, frequency_hz
from pntegrity.physics.tables import Klobuchar, Navigation, SignalTable
from pntegrity.physics.time import to_iso
from pntegrity.records import Epoch, FloatArray, Observation

__all__ = ["GnssEpochs", "gnss_epochs"]

Index = npt.NDArray[np.intp]
RANGE_M = (1.0e7, 6.0e7)
"""Pseudoranges outside cannot be: satellites are 1.9e7 to 4.2e7 m away, 10 ms of clock offset are 3e6 m."""
NEVER = 255
"""Rank of a signal that is not in the preference list."""


@dataclass(frozen=True, eq=False)
class GnssEpochs:
    """The epochs of a log.

    Parameters
    ----------
    epochs : tuple of Epoch
        One a time tag, also where no satellite is left (its notes tell why).
    notes : tuple of str
        What was left out over the whole log, counted.
    klobuchar : Klobuchar or None
        Ionosphere coefficients of the navigation files.
    """

    epochs: tuple[Epoch, ...]
    notes: tuple[str, ...]
    klobuchar: Klobuchar | None


@dataclass(frozen=True, eq=False)
class _Chosen:
    """One row a satellite and epoch: table rows of its one or two signals (-1: none), why left out."""

    epoch: npt.NDArray[np.int64]
    sat: npt.NDArray[np.str_]
    first: Index
    second: Index
    reason: npt.NDArray[np.object_]


def gnss_epochs(
    table: SignalTable,
    nav: Navigation,
    *,
    systems: str = "GREC",
    signals: Mapping[str, tuple[str, ...]] | None = None,
    ionosphere_free: bool = False,
    start_ns: int | None = None,
    end_ns: int | None = None,
) -> GnssEpochs:
    """Return the epochs of a signal table with satellite positions and clocks.

    Parameters
    ----------
    table : SignalTable
        Observations.
    nav : Navigation
        Broadcast ephemerides.
    systems : str
        Letters of the systems to use.
    signals : mapping of str to tuple of str, optional
        Signals in order of preference by system letter; `DEFAULT_SIGNALS` for systems that are not in it.
        With `ionosphere_free` the list is for the first frequency and a list under ``"G2"``, ``"E2"``, ...
        for the second (`DEFAULT_PAIRS`).
    ionosphere_free : bool
        Combine code and carrier of two frequencies; Doppler stays that of the first.
    start_ns, end_ns : int, optional
        First and last time to use, ns of GPS time, both included.

    Returns
    -------
    GnssEpochs
        Observations ``"code"`` (m), ``"doppler"`` (m/s, positive when the range grows) and ``"carrier"`` (m),
        keys ``"G05:C1C"``, ``"G05:D1C"``, ``"G05:L1C"`` or ``"G05:C1C+C2W"``. Their `aux`: ``sv_pos_m`` and
        ``sv_vel_mps`` (n, 3) at emission, ``sv_clk_m``, ``sv_clk_rate_mps``, ``sv_var_m2``, ``freq_hz``,
        ``cn0_dbhz`` (may be nan), ``lli``, ``iono_factor`` (delay of the ionosphere in units of that at
        ``freq_hz``: 1, or 0 for a pair).

    Raises
    ------
    InputError
        No time tag in the interval, none of the systems in the file, or no satellite with an ephemeris.
    ValueError
        `systems` names no known system.
    """
    _check_systems(systems)
    t_ns, rows = _window(table, systems, start_ns, end_ns)
    notes = _systems_left_out(table, systems)
    without = [s for s in systems if s not in nav.systems and s in table.systems]
    notes += [f"{WORDS[s]}: no ephemerides in the navigation files, left out" for s in without]
    rows = rows[~np.isin(table.sat[rows].astype("<U1"), without)]
    chosen = _choose(table, rows, dict(signals or {}), ionosphere_free)
    states = _states(table, nav, chosen)
    reasons = np.where(chosen.reason == "", states.reason, chosen.reason)
    _check_any(table, nav, states, reasons, without)
    epochs, counted = _assemble(table, nav, t_ns, chosen, states, reasons)
    klobuchar = nav.klobuchar.get("G") or nav.klobuchar.get("J")
    if klobuchar is None and not ionosphere_free:
        notes.append("no GPS ionosphere coefficients in the navigation files: the delay is not modelled")
    return GnssEpochs(epochs, tuple(notes + counted), klobuchar)


# --- which rows ---------------------------------------------------------------------------------------------


def _check_systems(systems: str) -> None:
    if not systems or any(s not in DEFAULT_SIGNALS for s in systems):
        raise ValueError(f"`systems` must be letters of {''.join(DEFAULT_SIGNALS)}, not {systems!r}")


def _window(
    table: SignalTable, systems: str, start_ns: int | None, end_ns: int | None
) -> tuple[npt.NDArray[np.int64], Index]:
    """Return the time tags of the interval and the table rows of `systems` in it."""
    first = 0 if start_ns is None else int(np.searchsorted(table.t_ns, start_ns, side="left"))
    last = len(table.t_ns) if end_ns is None else int(np.searchsorted(table.t_ns, end_ns, side="right"))
    if first >= last:
        span = f"{to_iso(int(table.t_ns[0]))} to {to_iso(int(table.t_ns[-1]))}"
        raise InputError(
            "no epoch in the interval asked for", path=table.source, hint=f"The file covers {span} (GPS time)"
        )
    lo, hi = np.searchsorted(table.epoch, (first, last))
    rows = lo + np.flatnonzero(np.isin(table.sat[lo:hi].astype("<U1"), list(systems)))
    if not len(rows):
        raise InputError(
            f"no satellite of the systems {systems} in this file",
            path=table.source,
            hint=f"It holds {table.systems}",
        )
    return table.t_ns[first:last], rows


def _systems_left_out(table: SignalTable, systems: str) -> list[str]:
    others = [WORDS.get(s, s) for s in table.systems if s not in systems]
    return [f"in the file but not asked for: {', '.join(others)}"] if others else []


def _choose(table: SignalTable, rows: Index, signals: dict[str, tuple[str, ...]], pair: bool) -> _Chosen:
    """Choose for each epoch and satellite the first usable signal of the list, and a second for a pair."""
    sat, epoch = table.sat[rows], table.epoch[rows].astype(np.int64)
    p = table.pseudorange_m[rows]
    new = np.ones(len(rows), dtype=bool)
    new[1:] = (epoch[1:] != epoch[:-1]) | (sat[1:] != sat[:-1])
    starts = np.flatnonzero(new)
    usable = (p >= RANGE_M[0]) & (p <= RANGE_M[1])
    lists = {s: signals.get(s, DEFAULT_PAIRS[s][0] if pair else DEFAULT_SIGNALS[s]) for s in DEFAULT_SIGNALS}
    rank = _ranks(table, rows, lists)
    first = _best(rank, usable, starts)
    reason = _reasons(sat[starts], first, _best(rank, np.ones_like(usable), starts), lists)
    second = np.full(len(starts), -1)
    if pair:
        lists = {s: signals.get(s + "2", DEFAULT_PAIRS[s][1]) for s in DEFAULT_SIGNALS}
        second = _best(_ranks(table, rows, lists), usable, starts)
        lacks = (reason == "") & (second < 0)
        reason[lacks] = "no second frequency"
    to_table = np.append(rows, -1)
    return _Chosen(epoch[starts], sat[starts], to_table[first], to_table[second], reason)


def _ranks(table: SignalTable, rows: Index, lists: Mapping[str, tuple[str, ...]]) -> npt.NDArray[np.int64]:
    names = np.char.add(table.sat[rows].astype("<U1"), table.signal[rows])
    kinds, inverse = np.unique(names, return_inverse=True)
    ranks = [lists[k[0]].index(k[1:]) if k[1:] in lists[k[0]] else NEVER for k in kinds.tolist()]
    return np.array(ranks, dtype=np.int64)[inverse]


def _best(rank: npt.NDArray[np.int64], usable: npt.NDArray[np.bool_], starts: Index) -> Index:
    """Return for each group of rows the row of the lowest rank, -1 where none is usable."""
    if not len(starts):
        return np.zeros(0, dtype=np.intp)
    packed = (np.where(usable, rank, NEVER) << 40) | np.arange(len(rank))
    lowest = np.minimum.reduceat(packed, starts)
    return np.where((lowest >> 40) < NEVER, lowest & ((1 << 40) - 1), -1)


def _reasons(
    sat: npt.NDArray[np.str_], usable: Index, present: Index, lists: Mapping[str, tuple[str, ...]]
) -> npt.NDArray[np.object_]:
    reason = np.full(len(sat), "", dtype=object)
    reason[usable < 0] = "pseudorange is zero, not a number or outside 10,000 to 60,000 km"
    for system, names in lists.items():
        absent = (present < 0) & (np.char.startswith(sat, system) if len(sat) else np.zeros(0, dtype=bool))
        reason[absent] = f"no signal among {', '.join(names)}"
    return reason


def _states(table: SignalTable, nav: Navigation, chosen: _Chosen) -> SatelliteStates:
    first, second = chosen.first, chosen.second
    signal = table.signal[first].astype("<U5")
    paired = np.flatnonzero(second >= 0)
    signal[paired] = np.char.add(np.char.add(signal[paired], "+"), table.signal[second[paired]])
    range_m = np.where(chosen.reason == "", table.pseudorange_m[first], np.nan)
    return satellite_states(nav, chosen.sat, table.t_ns[chosen.epoch], range_m, signal)


def _check_any(
    table: SignalTable,
    nav: Navigation,
    states: SatelliteStates,
    reasons: npt.NDArray[np.object_],
    without: list[str],
) -> None:
    if states.ok.any():
        return
    seen = f"{to_iso(int(table.t_ns[0]))} to {to_iso(int(table.t_ns[-1]))}"
    if without or {"too old", "no ephemeris"} & set(reasons.tolist()):
        raise InputError(
            f"no ephemeris fits the observations of {seen}; navigation: {', '.join(nav.sources) or 'none'}",
            path=table.source,
            hint="Give the navigation file of the same day and systems",
        )
    common = Counter(reasons.tolist()).most_common(3)
    why = ", ".join(f"{r} ({n})" for r, n in common)
    raise InputError(
        f"no satellite can be used: {why}", path=table.source, hint="Check `signals` against the file's types"
    )


# --- from rows to epochs ------------------------------------------------------------------------------------


def _assemble(
    table: SignalTable,
    nav: Navigation,
    t_ns: npt.NDArray[np.int64],
    chosen: _Chosen,
    states: SatelliteStates,
    reasons: npt.NDArray[np.object_],
) -> tuple[tuple[Epoch, ...], list[str]]:
    offset = int(np.searchsorted(table.t_ns, t_ns[0]))
    n = len(t_ns)
    sensors = _measurements(table, nav, chosen, states)
    per_sensor = [
        _slices(name, t_ns, chosen.epoch[at] - offset, keys, y, aux)
        for name, (at, keys, y, aux) in sensors.items()
    ]
    lost = np.flatnonzero(reasons != "")
    texts = [f"{s}: {r}" for s, r in zip(chosen.sat[lost].tolist(), reasons[lost].tolist(), strict=True)]
    bounds = np.searchsorted(chosen.epoch[lost] - offset, np.arange(n + 1)).tolist()
    epochs = tuple(
        Epoch(
            t,
            tuple(o for s in per_sensor if (o := s[i]) is not None),
            tuple(texts[bounds[i] : bounds[i + 1]]),
        )
        for i, t in enumerate(t_ns.tolist())
    )
    counted = [f"{text} ({k} of {n} epochs)" for text, k in sorted(Counter(texts).items())]
    return epochs, counted


def _measurements(
    table: SignalTable, nav: Navigation, chosen: _Chosen, states: SatelliteStates
) -> dict[str, tuple[Index, list[str], FloatArray, dict[str, npt.NDArray[np.generic]]]]:
    """Return for each sensor: rows of `chosen`, keys, values and aux."""
    ok = np.flatnonzero(states.ok)
    first, second, sat = chosen.first[ok], chosen.second[ok], chosen.sat[ok]
    freq, freq2 = _frequencies(table, nav, sat, first), _frequencies(table, nav, sat, second)
    gamma = (freq / freq2) ** 2
    wave, wave2 = SPEED_OF_LIGHT_MPS / freq, SPEED_OF_LIGHT_MPS / freq2

    def combined(a: FloatArray, b: FloatArray) -> FloatArray:
        return np.where(second >= 0, (gamma * a - b) / (gamma - 1.0), a)

    code = combined(table.pseudorange_m[first], table.pseudorange_m[second])
    carrier = combined(wave * table.carrier_cycles[first], wave2 * table.carrier_cycles[second])
    aux: dict[str, npt.NDArray[np.generic]] = {
        "sv_pos_m": states.position_m[ok],
        "sv_vel_mps": states.velocity_mps[ok],
        "sv_clk_m": states.clock_m[ok],
        "sv_clk_rate_mps": states.clock_rate_mps[ok],
        "sv_var_m2": states.variance_m2[ok],
        "freq_hz": freq,
        "cn0_dbhz": table.cn0_dbhz[first],
        "lli": table.lli[first] | np.where(second >= 0, table.lli[second], 0).astype(np.int8),
        "iono_factor": np.where(second >= 0, 0.0, 1.0),
    }
    values = {"code": code, "doppler": -wave * table.doppler_hz[first], "carrier": carrier}
    out = {}
    for (name, y), letter in zip(values.items(), "CDL", strict=True):
        at = np.flatnonzero(np.isfinite(y))
        pair = second[at] if letter != "D" else np.full(len(at), -1)
        keys = _keys(table, sat[at], letter, first[at], pair)
        out[name] = ok[at], keys, y[at], {k: v[at] for k, v in aux.items()}
    return out


def _frequencies(table: SignalTable, nav: Navigation, sat: npt.NDArray[np.str_], rows: Index) -> FloatArray:
    """Return carrier frequencies, nan where there is no row or the GLONASS channel is unknown."""
    names = np.char.add(sat, table.signal[rows]) if len(rows) else sat
    kinds, inverse = np.unique(names, return_inverse=True)
    channels = {**table.glonass_channels, **nav.glonass_channels}
    values = [frequency_hz(k[0], k[3:], channels.get(k[:3])) for k in kinds.tolist()]
    return np.where(rows >= 0, np.array(values)[inverse], np.nan)


def _keys(
    table: SignalTable, sat: npt.NDArray[np.str_], letter: str, first: Index, second: Index
) -> list[str]:
    signal = table.signal[first].astype("<U2")
    tail = np.where(second >= 0, np.char.add(f"+{letter}", table.signal[second]), "")
    names = np.char.add(np.char.add(sat, f":{letter}"), np.char.add(signal, tail))
    kinds, inverse = np.unique(names, return_inverse=True)
    shared: list[str] = kinds.astype(object)[inverse].tolist()  # one str object a key, not one a row
    return shared


def _slices(
    sensor: str,
    t_ns: npt.NDArray[np.int64],
    epoch: npt.NDArray[np.int64],
    keys: list[str],
    y: FloatArray,
    aux: dict[str, npt.NDArray[np.generic]],
) -> list[Observation | None]:
    """Return one observation for each time tag, None where the sensor has no row."""
    for a in (y, *aux.values()):
        a.flags.writeable = False
    bounds = np.searchsorted(epoch, np.arange(len(t_ns) + 1)).tolist()
    out: list[Observation | None] = []
    for t, i, j in zip(t_ns.tolist(), bounds, bounds[1:], strict=False):
        part = {k: v[i:j] for k, v in aux.items()}
        out.append(Observation(sensor, t, tuple(keys[i:j]), y[i:j], None, part) if j > i else None)
    return out
