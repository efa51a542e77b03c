"""One broadcast message (sidereon's record): its times, its accuracy, and whether it can be true at all."""

from __future__ import annotations

import math
from typing import Any

from pntegrity.physics.time import BDT_OFFSET_NS, BDT_WEEK, DAY_NS, WEEK_NS

__all__ = [
    "MESSAGES", "accuracy_m", "is_healthy", "is_possible", "sisa_is_index", "toc_ns", "toe_ns", "upload_s",
]  # fmt: skip

MESSAGES = frozenset({"gps_lnav", "qzss_lnav", "galileo_inav", "galileo_fnav", "beidou_d1", "beidou_d2"})
"""Messages whose clocks and group delays are understood here; CNAV and the like are left out."""
ROOT_AXIS = (4_900.0, 6_700.0)
"""Root of the semi-major axis, m^0.5: 24,000 to 44,900 km, GLONASS to geostationary."""
INCLINED_RAD = (0.7, 1.2)
"""Inclinations of GPS, Galileo and BeiDou D1 satellites. Some writers give semicircles for radians: 0.3."""
LARGEST = {
    "m0": 7.0, "omega0": 7.0, "omega": 7.0, "i0": 4.0,
    "delta_n": 1e-6, "omega_dot": 1e-6, "idot": 1e-6,
    "cuc": 1e-2, "cus": 1e-2, "cic": 1e-2, "cis": 1e-2, "crc": 1e5, "crs": 1e5,
}  # fmt: skip
"""Bounds of elements, rad, rad/s and m, beyond what the messages' fields can hold; nan fails them too."""
CLOCK_S = 0.1
LAST_WEEK = 10_000


def is_possible(record: Any) -> bool:
    """Return whether orbit and clock of a message are finite and of a navigation satellite's size."""
    if record.satellite[0] == "R":
        return _glonass_is_possible(record)
    e, c = record.elements, record.clock
    if not all(abs(getattr(e, name)) < most for name, most in LARGEST.items()):
        return False
    times = (record.toe_week, record.toc_week)
    if not all(0 <= week < LAST_WEEK for week in times) or not math.isfinite(record.sv_health):
        return False
    if not (0.0 <= e.toe_sow <= 604_800.0 and 0.0 <= c.toc_sow <= 604_800.0):
        return False
    inclined = record.message.label not in ("beidou_d2", "qzss_lnav")
    return bool(
        ROOT_AXIS[0] < e.sqrt_a < ROOT_AXIS[1]
        and 0.0 <= e.e < 0.4
        and (not inclined or INCLINED_RAD[0] < abs(e.i0) < INCLINED_RAD[1])
        and abs(c.af0) < CLOCK_S
        and abs(c.af1) < 1e-6
        and abs(c.af2) < 1e-12
        and abs(toc_ns(record) - toe_ns(record)) < DAY_NS
    )


def _glonass_is_possible(record: Any) -> bool:
    radius = math.hypot(*record.position_m)
    speed = math.hypot(*record.velocity_m_s)
    push = math.hypot(*record.acceleration_m_s2)
    clock = abs(record.clock_bias_s) < CLOCK_S and abs(record.gamma_n) < 1e-6
    return bool(2.4e7 < radius < 2.7e7 and 1e3 < speed < 6e3 and push < 1e-4 and clock)


def is_healthy(record: Any) -> bool:
    """Return whether a Kepler message sets no health bit (QZSS: that of the L6 signal is left out)."""
    health = int(record.sv_health)
    return (health & ~1 if record.satellite[0] == "J" else health) == 0


def accuracy_m(record: Any) -> float:
    """Return the range accuracy that a Kepler message states, m; nan where it states none.

    GPS URA index 15 (6144 m, "use at own risk") and Galileo's negative "no accuracy prediction" are none.
    """
    value = record.sv_accuracy_m
    if value is None or not 0.0 <= value < 6_144.0:
        return math.nan
    return sisa_m(int(value)) if sisa_is_index(record) else float(value)


def sisa_is_index(record: Any) -> bool:
    """Return whether a Galileo accuracy can only be the message's index: 107 for 3.12 m, as some writers do.

    SISA is 6 m at most (OS SIS ICD, table 89), so that whole numbers from 7 to 125 are no metres.
    """
    value = record.sv_accuracy_m
    return (
        record.satellite[0] == "E"
        and value is not None
        and 7.0 <= value <= 125.0
        and float(value).is_integer()
    )


def sisa_m(index: int) -> float:
    """Return Galileo's signal-in-space accuracy of an index, 0 to 125 (OS SIS ICD, table 89)."""
    start, base, step = next(
        s for s in ((100, 2.0, 0.16), (75, 1.0, 0.04), (50, 0.5, 0.02), (0, 0.0, 0.01)) if index >= s[0]
    )
    return base + (index - start) * step


def upload_s(record: Any) -> float:
    """Return when the message was sent, s from its reference time: the later upload is the larger."""
    sent = record.transmission_time_sow
    if sent is None or not 0.0 <= sent <= 604_800.0:  # 0.9999E9 and the like mean: not known
        return -604_800.0
    late = sent - record.toe_tow_s
    return float(late - 604_800.0 * round(late / 604_800.0))


def toe_ns(record: Any) -> int:
    """Return the reference time of a Kepler record, ns of GPS time."""
    return _week_tow_ns(record, record.toe_week, record.toe_tow_s)


def toc_ns(record: Any) -> int:
    """Return the clock reference time of a Kepler record, ns of GPS time."""
    return _week_tow_ns(record, record.toc_week, record.toc_tow_s)


def _week_tow_ns(record: Any, week: int, tow_s: float) -> int:
    beidou = record.satellite[0] == "C"
    start = BDT_WEEK * WEEK_NS + BDT_OFFSET_NS if beidou else 0
    return week * WEEK_NS + round(tow_s * 1e9) + start
