"""Lengths and rates in words: in m, cm or mm, so that no digit is lost."""

from __future__ import annotations

import math

__all__ = [
    "degrees",
    "duration",
    "length",
    "level_text",
    "measured",
    "percent",
    "rounded",
    "together",
    "unit",
]


def unit(largest_m: float) -> tuple[float, str]:
    """Return by how much to multiply, and the unit in which numbers up to `largest_m` are told."""
    size = abs(largest_m)
    return (1.0, "m") if not size < 0.0995 else (100.0, "cm") if size >= 0.00995 else (1000.0, "mm")


def length(value_m: float, per: str = "") -> str:
    """Return ``39.9 m``, ``1.2 cm`` or ``0.67 mm``; `per` follows the unit (``"/s"``)."""
    factor, name = unit(value_m)
    return f"{rounded(value_m * factor, name)} {name}{per}"


def measured(value: float, unit_name: str, per: str = "") -> str:
    """Return a size in the unit of a row, ``"m"``, ``"s"`` (told in ms) or ``"rad"`` (in degrees); `per`
    follows it.
    """
    if unit_name == "m":
        return length(value, per)
    if not unit_name:
        return f"{value:.3g}{' a second' if per else ''} in the unit of its row"
    factor, name = {"s": (1e3, " ms"), "rad": (180.0 / math.pi, "°")}[unit_name]
    return f"{value * factor:.3g}{name}{per}"


def level_text(value_m: float | None) -> str:
    """Return a protection level in words; one that is not finite, or null, is ``unbounded``."""
    return length(value_m) if value_m is not None and math.isfinite(value_m) else "unbounded"


def together(*values_m: float) -> str:
    """Return several lengths, ``1.06 and 1.43 m`` where one unit fits all, else ``9.0 cm and 0.26 m``."""
    told = [length(v).split() for v in values_m]
    if len({name for _, name in told}) == 1:
        return f"{' and '.join(number for number, _ in told)} {told[0][1]}"
    return " and ".join(map(" ".join, told))


def rounded(value: float, unit_name: str) -> str:
    """Return a number with as many digits as its unit deserves."""
    size = abs(value)
    if unit_name == "m":
        return f"{value:.2f}" if size < 9.995 else f"{value:.1f}"
    return f"{value:.1f}" if size >= 0.995 or not size else f"{value:#.2g}"


def degrees(value_deg: float | None) -> str:
    """Return an angle in words, ``0.42°``, with two digits or whole degrees; ``–`` where it is not known."""
    if value_deg is None:
        return "–"
    return f"{value_deg:.0f}°" if abs(value_deg) >= 9.95 else f"{value_deg:#.2g}°"


def percent(share: float) -> str:
    """Return a share in per cent, rounded down: 100 means all."""
    return f"{math.floor(1000.0 * share + 1e-9) / 10.0:g}"


def duration(seconds: float) -> str:
    """Return ``30 s``, ``2.5 min`` or ``1 h``."""
    if seconds < 120.0:
        return f"{seconds:g} s"
    return f"{seconds / 60.0:g} min" if seconds < 3600.0 else f"{seconds / 3600.0:g} h"
