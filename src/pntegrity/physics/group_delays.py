"""Group delays of broadcast clocks: which signal a clock is for, and what another signal needs.

Every delay ``d`` is such that the clock of a signal is the record's clock less ``d``. With ``gamma = (f1 /
f_i)**2``:

- GPS, QZSS (IS-GPS-200 20.3.3.3.3.2): clock of L1 P(Y) and L2 P(Y) combined; L1: TGD, L2: gamma TGD. L5 needs
  CNAV.
- Galileo (OS SIS ICD 5.1.5): F/NAV clock of E1-E5a, I/NAV clock of E1-E5b; E1: BGD, E5x: gamma BGD of its own
  pair.
- BeiDou (B1I ICD 5.2.4.10): clock of B3I; B1I: TGD1, B2I: TGD2.
- GLONASS (ICD L1/L2 4.4): clock of L1; L2 later by the stated difference. Before RINEX 3.05 no difference is
  stated.
"""

from __future__ import annotations

import math
from typing import Any

from pntegrity.physics.signals import frequency_hz

__all__ = ["group_delay_s", "wants_fnav"]

WORST_S = 2.5e-7
"""Larger values are damaged (BRDC files hold some): the fields end at 0.06 to 0.12 us, times gamma."""


def wants_fnav(sat: str, signal: str) -> bool:
    """Whether Galileo's F/NAV clock is the one for `signal`: E5a, alone or with E1. All else takes I/NAV."""
    return sat[0] == "E" and signal.rpartition("+")[2][:1] == "5"


def group_delay_s(record: Any, signal: str) -> float:
    """Return what to take off the record's clock for `signal`, s; nan where the message does not tell.

    Parameters
    ----------
    record : sidereon.BroadcastRecord or sidereon.GlonassRecord
        The message.
    signal : str
        ``"1C"``, or ``"1C+2W"`` for the ionosphere-free pair.
    """
    first, _, second = signal.partition("+")
    a = _single(record, first)
    if not second:
        return a if abs(a) < WORST_S else math.nan
    channel = record.freq_channel if record.satellite[0] == "R" else None
    gamma = _gamma(record.satellite, first, second, channel)
    combined = (gamma * a - _single(record, second)) / (gamma - 1.0)
    return combined if abs(combined) < WORST_S else math.nan


def _gamma(sat: str, first: str, second: str, channel: int | None = None) -> float:
    return (frequency_hz(sat[0], first, channel) / frequency_hz(sat[0], second, channel)) ** 2


def _single(record: Any, signal: str) -> float:
    system, band = record.satellite[0], signal[0]
    if system == "R":
        return 0.0 if band == "1" else (record.l1_l2_group_delay_s or 0.0) if band == "2" else math.nan
    delays = record.group_delays
    if system in "GJ":
        return _legacy(delays.gps_tgd_s, record.satellite, band)
    if system == "E":
        return _galileo(delays, record, band)
    if system == "C":
        value = {"2": delays.beidou_tgd1_s, "7": delays.beidou_tgd2_s, "6": 0.0}.get(band)
        return math.nan if value is None else value
    return math.nan


def _legacy(tgd_s: float | None, sat: str, band: str) -> float:
    if tgd_s is None or band not in "12":
        return math.nan
    return tgd_s * _gamma(sat, "1C", band + "C")


def _galileo(delays: Any, record: Any, band: str) -> float:
    a: float | None
    b: float | None
    a, b = delays.galileo_bgd_e5a_e1_s, delays.galileo_bgd_e5b_e1_s
    own = a if record.message.label.endswith("fnav") else b
    if own is None:
        return math.nan
    if band == "1":
        return own
    pair = {"5": a, "7": b}.get(band)
    return math.nan if pair is None else own + (_gamma("E", "1C", band + "X") - 1.0) * pair
