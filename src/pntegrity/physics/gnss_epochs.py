"""Signals and ephemerides -> the epochs an estimator takes: one signal (or one pair) a satellite."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from pntegrity.errors import InputError
from pntegrity.physics._assembly import GnssEpochs, assemble
from pntegrity.physics._choice import Chosen, check_systems, choose, systems_left_out, window
from pntegrity.physics.orbits import SatelliteStates, satellite_states
from pntegrity.physics.signals import WORDS
from pntegrity.physics.tables import Navigation, SignalTable
from pntegrity.physics.time import to_iso

__all__ = ["GnssEpochs", "gnss_epochs"]


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
    check_systems(systems)
    t_ns, rows = window(table, systems, start_ns, end_ns)
    notes = systems_left_out(table, systems)
    without = [s for s in systems if s not in nav.systems and s in table.systems]
    notes += [f"{WORDS[s]}: no ephemerides in the navigation files, left out" for s in without]
    rows = rows[~np.isin(table.sat[rows].astype("<U1"), without)]
    chosen = choose(table, rows, signals or {}, ionosphere_free)
    states = _states(table, nav, chosen)
    reasons = np.where(chosen.reason == "", states.reason, chosen.reason)
    _check_any(table, nav, states, reasons, without)
    channels = {**table.glonass_channels, **nav.glonass_channels}
    epochs, counted = assemble(table, channels, t_ns, chosen, states, reasons)
    klobuchar = nav.klobuchar.get("G") or nav.klobuchar.get("J")
    if klobuchar is None and not ionosphere_free:
        notes.append("no GPS ionosphere coefficients in the navigation files: the delay is not modelled")
    return GnssEpochs(epochs, tuple(notes + counted), klobuchar)


def _states(table: SignalTable, nav: Navigation, chosen: Chosen) -> SatelliteStates:
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
