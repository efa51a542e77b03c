"""Signals: carrier frequencies, and which signal of a satellite to take first.

A signal is named by RINEX 3's band and attribute (``"1C"``); with the system's letter (``"G"``, ``"R"``,
``"E"``, ``"C"``, ``"J"``) it is unique. Source: RINEX 3.04 tables 4 to 9 (BeiDou: B1I is ``2I``; ``1I`` of
RINEX 3.02 is renamed by the reader).
"""

from __future__ import annotations

import math
from functools import lru_cache

__all__ = [
    "CLOCK_SIGNALS", "DEFAULT_PAIRS", "DEFAULT_SIGNALS", "PRECISE_CARRIERS", "PRECISE_PAIRS",
    "SPEED_OF_LIGHT_MPS", "WORDS", "frequency_hz",
]  # fmt: skip

SPEED_OF_LIGHT_MPS = 299_792_458.0

WORDS = {
    "G": "GPS", "R": "GLONASS", "E": "Galileo", "C": "BeiDou", "J": "QZSS", "I": "NavIC", "S": "SBAS",
}  # fmt: skip
"""Names of the systems, for messages."""

DEFAULT_SIGNALS: dict[str, tuple[str, ...]] = {
    "G": ("1C", "1W", "1P", "1X", "1L", "1S"),
    "R": ("1C", "1P"),
    "E": ("1C", "1X", "1B", "1Z", "1A"),
    "C": ("2I", "2X", "2Q", "6I", "6X", "6Q", "7I"),
    "J": ("1C", "1Z", "1X", "1L", "1S"),
}
"""Single-frequency preference. BeiDou B1C (``1P``, ``1X``) is left out: D1/D2 hold no delay for it."""

DEFAULT_PAIRS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "G": (("1C", "1W", "1P"), ("2W", "2P", "2L", "2X", "2S", "2C")),
    "R": (("1C", "1P"), ("2C", "2P")),
    "E": (("1C", "1X", "1B"), ("5Q", "5X", "5I", "7Q", "7X", "7I")),
    "C": (("2I", "2X", "2Q"), ("6I", "6X", "6Q", "7I", "7X", "7Q")),
    "J": (("1C", "1Z"), ("2L", "2X", "2S")),
}
"""First and second frequency of an ionosphere-free pair, each in order of preference."""

PRECISE_PAIRS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = DEFAULT_PAIRS | {
    "G": (("1W", "1P", "1C"), ("2W", "2P", "2L", "2X", "2S", "2C")),
    "R": (("1P", "1C"), ("2P", "2C")),
}
"""The same where precise clocks are used: first the codes that they refer to."""

PRECISE_CARRIERS: dict[str, tuple[str, ...]] = {
    "G": ("1C", "1L", "1X", "1W", "1P", "2W", "2P", "2L", "2X", "2S", "2C"),
    "R": ("1C", "1P", "2C", "2P"),
}
"""Carriers of the same bands. 2W is aided by 1C: six times less noise in their difference than with 2L."""

CLOCK_SIGNALS: dict[str, tuple[str, str]] = {
    "G": ("1W", "2W"), "R": ("1P", "2P"), "E": ("1C", "5Q"), "C": ("2I", "6I"), "J": ("1C", "2L"),
}  # fmt: skip
"""The pair whose ionosphere-free combination precise clocks refer to, by the convention of the IGS."""


@lru_cache(maxsize=4096)
def frequency_hz(system: str, signal: str, glonass_channel: int | None = None) -> float:
    """Return the carrier frequency of a signal, Hz; nan where it has none or the GLONASS channel is unknown.

    Parameters
    ----------
    system : str
        One letter, or a satellite (``"G05"``): its first letter counts.
    signal : str
        Band and attribute, ``"1C"``.
    glonass_channel : int, optional
        Frequency channel, -7 to 13, for GLONASS on bands 1 and 2.
    """
    import sidereon

    known = sidereon.GnssSystem.__dict__
    name = {"G": "GPS", "R": "GLONASS", "E": "GALILEO", "C": "BEIDOU", "J": "QZSS", "I": "NAVIC", "S": "SBAS"}
    if system[0] not in name:
        return math.nan
    try:
        value = sidereon.rinex_band_frequency_hz(known[name[system[0]]], signal[0], glonass_channel)
    except ValueError:
        return math.nan
    return math.nan if value is None else float(value)
