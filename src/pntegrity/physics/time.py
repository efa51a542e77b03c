"""Time: int nanoseconds of GPS time since 1980-01-06 (``t_ns``), and the other scales at the edges."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from functools import lru_cache

import numpy as np
import numpy.typing as npt

__all__ = [
    "BDT_OFFSET_NS", "BDT_WEEK", "DAY_NS", "SECOND_NS", "WEEK_NS", "civil_to_ns", "from_iso", "from_j2000_s",
    "from_week_tow", "leap_seconds", "to_iso", "to_j2000_s", "to_unix_us", "to_week_tow", "utc_to_ns",
]  # fmt: skip

SECOND_NS = 1_000_000_000
DAY_NS = 86_400 * SECOND_NS
WEEK_NS = 7 * DAY_NS
BDT_OFFSET_NS = 14 * SECOND_NS
"""GPS time minus BeiDou time."""
BDT_WEEK = 1356
"""GPS week in which BeiDou time starts."""
_EPOCH = datetime(1980, 1, 6)
_J2000_NS = 7300 * DAY_NS + DAY_NS // 2  # 2000-01-01 12:00:00 of the same scale
_UNIX_S = 315_964_800  # 1980-01-06 in Unix seconds


def from_week_tow(week: npt.ArrayLike, tow_s: npt.ArrayLike) -> npt.NDArray[np.int64]:
    """Return ns of GPS time of full week number(s) and second(s) of the week, rounded to 1 ns."""
    tow_ns = np.rint(np.asarray(tow_s, dtype=np.float64) * SECOND_NS).astype(np.int64)
    return np.asarray(week, dtype=np.int64) * WEEK_NS + tow_ns


def to_week_tow(t_ns: int) -> tuple[int, float]:
    """Return GPS week and second of the week."""
    week, rest = divmod(int(t_ns), WEEK_NS)
    return week, rest / SECOND_NS


def civil_to_ns(year: int, month: int, day: int, hour: int = 0, minute: int = 0, second: float = 0.0) -> int:
    """Return ns since 1980-01-06 of a calendar time, in the scale of that calendar (no leap seconds counted).

    Raises
    ------
    ValueError
        No such date. A `second` of 60 or more (a leap second in UTC) runs into the next minute.
    """
    days = (datetime(year, month, day) - _EPOCH).days
    if not (0 <= hour <= 24 and 0 <= minute < 60 and 0.0 <= second < 61.0):
        raise ValueError(f"no such time of day: {hour:02d}:{minute:02d}:{second}")
    whole = (days * 86_400 + hour * 3600 + minute * 60) * SECOND_NS
    return whole + round(second * SECOND_NS)


@lru_cache(maxsize=64)
def leap_seconds(year: int, month: int, day: int) -> int:
    """Return GPS time minus UTC on a day of UTC, s."""
    import sidereon

    tai_minus_gps = 19
    return round(sidereon.leap_seconds(year, month, day)) - tai_minus_gps


def utc_to_ns(year: int, month: int, day: int, hour: int = 0, minute: int = 0, second: float = 0.0) -> int:
    """Return ns of GPS time of a UTC calendar time."""
    return civil_to_ns(year, month, day, hour, minute, second) + leap_seconds(year, month, day) * SECOND_NS


def to_iso(t_ns: int) -> str:
    """Return the GPS calendar time as ``2019-01-14T06:15:00``, with decimals as needed."""
    seconds, rest = divmod(int(t_ns), SECOND_NS)
    text = (_EPOCH + timedelta(seconds=seconds)).isoformat(timespec="seconds")
    return f"{text}.{rest:09d}".rstrip("0") if rest else text


def from_iso(text: str) -> int:
    """Return ns of GPS time of an ISO string in GPS time: ``2019-01-14 06:15:00.25``, or a bare date.

    Raises
    ------
    ValueError
        Not an ISO date, or one with a time zone (GPS time has none).
    """
    head, _, decimals = text.strip().partition(".")
    stamp = datetime.fromisoformat(head.replace("/", "-"))
    if stamp.tzinfo is not None or not (decimals or "0").isdigit():
        raise ValueError(f"{text!r} is no GPS time: write 2019-01-14T06:15:00.5, without a time zone")
    whole = (stamp - _EPOCH) // timedelta(seconds=1)
    return whole * SECOND_NS + int((decimals + "000000000")[:9])


def to_j2000_s(t_ns: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Return seconds of GPS time since 2000-01-01 12:00:00 GPS time (the scale sidereon's stores take)."""
    return (np.asarray(t_ns, dtype=np.int64) - _J2000_NS) / SECOND_NS


def from_j2000_s(seconds: npt.ArrayLike) -> npt.NDArray[np.int64]:
    """Return ns of GPS time of J2000 seconds in GPS time, to the resolution of a float (0.1 us)."""
    return np.rint(np.asarray(seconds, dtype=np.float64) * 1e6).astype(np.int64) * 1000 + _J2000_NS


def to_unix_us(t_ns: int) -> int:
    """Return Unix microseconds (UTC) of GPS time."""
    seconds = t_ns // SECOND_NS
    utc = datetime.fromtimestamp(_UNIX_S + seconds, tz=UTC)
    utc -= timedelta(seconds=leap_seconds(utc.year, utc.month, utc.day))
    return (_UNIX_S * SECOND_NS + t_ns - leap_seconds(utc.year, utc.month, utc.day) * SECOND_NS) // 1000
