"""A fault: who, what, how large, when."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pntegrity.kernels.signatures import family_of, is_rate
from pntegrity.states import is_satellite, sensor_of

__all__ = ["PLACE", "TOWARDS", "UNITS", "Fault", "Kind"]

Kind = Literal["bias", "ramp", "sine", "clock-drift"]

_LIGHT_M_NS = 0.299792458
#: Unit -> what rows are in, and its size there.
UNITS: dict[str, tuple[str, float]] = {
    "m": ("m", 1.0), "cm": ("m", 1e-2), "mm": ("m", 1e-3), "km": ("m", 1e3), "ns": ("m", _LIGHT_M_NS),
    "us": ("m", 1e3 * _LIGHT_M_NS), "ms": ("s", 1e-3), "s": ("s", 1.0), "deg": ("rad", np.pi / 180.0),
    "mrad": ("rad", 1e-3), "rad": ("rad", 1.0),
}  # fmt: skip
#: Directions of a drift of positions: east, north, up.
TOWARDS = {
    "east": (1.0, 0.0, 0.0), "north": (0.0, 1.0, 0.0), "up": (0.0, 0.0, 1.0),
    "west": (-1.0, 0.0, 0.0), "south": (0.0, -1.0, 0.0), "down": (0.0, 0.0, -1.0),
}  # fmt: skip
#: Rows of positions, and their axes.
PLACE = {"RX": 0, "RY": 1, "RZ": 2, "X": 0, "Y": 1, "Z": 2}


@dataclass(frozen=True)
class Fault:
    """A fault with a beginning and an end; see `simulate.faults.GRAMMAR`.

    Parameters
    ----------
    groups : str
        ``"G05"``, a family ``"G"``, or ``"*"``.
    signals : str
        Beginning of the signal names it touches; ``""``: code (of what is no satellite: all levels), ``"*"``:
        all rows; ``"north"`` and so on: positions, in that direction.
    kind : str
        ``"bias"``, ``"ramp"``, ``"sine"`` or ``"clock-drift"``.
    size : float
        `unit` times the power of 1/s that `order` says; where only range rates are meant, one power more.
    order : int
        0 for a bias or sine, 1 for a ramp or a constant drift, 2 for a drift that grows.
    period_s : float
        Of a sine.
    begin_ns, stop_ns : int
        After the first epoch, or GPS time where `absolute`; the end is excluded, None: it does not end.
    absolute : bool
        What the times are.
    sensor : str
        The only one of a source that is at fault; empty: all.
    unit : str
        ``"m"``, ``"s"`` or ``"rad"``: what rows it falls on are in.
    axis : tuple of float, optional
        Where the direction points, ECEF; known from the first position on.
    place_m : tuple of float, optional
        About where satellites are seen from, ECEF.
    """

    groups: str
    signals: str
    kind: Kind
    size: float
    order: int = 0
    period_s: float = 0.0
    begin_ns: int = 0
    stop_ns: int | None = None
    absolute: bool = False
    sensor: str = ""
    unit: str = "m"
    axis: tuple[float, float, float] | None = None
    place_m: tuple[float, float, float] | None = None

    def onset_ns(self, first_ns: int) -> int:
        """Return the time of the onset in a log that begins at `first_ns`."""
        return self.begin_ns if self.absolute else first_ns + self.begin_ns

    def end_ns(self, first_ns: int) -> int | None:
        """Return the time from which the fault is over, None where it does not end."""
        if self.stop_ns is None:
            return None
        return self.stop_ns if self.absolute else first_ns + self.stop_ns

    def active(self, t_ns: int, first_ns: int) -> bool:
        """Tell whether a time lies between onset and end (after which a clock's phase stays shifted)."""
        end = self.end_ns(first_ns)
        return self.onset_ns(first_ns) <= t_ns and (end is None or t_ns < end)

    def touches(self, key: str, timed: bool | None = None) -> bool:
        """Tell whether the fault falls on a row; `timed`: whether that is a travel time, as far as known."""
        group, _, signal = key.partition(":")
        if self.groups not in ("*", group, family_of(key)):
            return False
        if (self.sensor and sensor_of(key) != self.sensor) or not self._fits(signal, timed):
            return False
        if self.signals in TOWARDS:
            return signal in PLACE or is_satellite(group) or is_satellite(sensor_of(key))
        if self.signals:
            return self.signals == "*" or signal.startswith(self.signals)
        return signal.startswith("C") if is_satellite(group) else not is_rate(key)

    def _fits(self, signal: str, timed: bool | None) -> bool:
        """Tell whether a row is in the fault's unit."""
        if signal.startswith("A.") or self.unit == "rad":
            return signal.startswith("A.") and self.unit == "rad"
        return timed is None or timed == (self.unit == "s")

    def hits(self, groups: Iterable[str]) -> frozenset[str]:
        """Return which of `groups`, or of sensors (``"lbl.AP1"``), are at fault."""
        return frozenset(g for g in groups if self._hits(*g.partition(".")[::2]))

    def _hits(self, group: str, sensor: str) -> bool:
        own = self.groups in ("*", group, family_of(group))
        return own and (not self.sensor or not sensor or sensor == self.sensor)

    def level(self, tau_s: float, length_s: float) -> float:
        """Return the course ``f`` at `tau_s` after the onset of a fault that lasts `length_s`."""
        tau = min(tau_s, length_s)
        if self.kind == "sine":
            return self.size * float(np.sin(2.0 * np.pi * tau / self.period_s))
        return self.size * tau**self.order / max(self.order, 1)

    def rate(self, tau_s: float) -> float:
        """Return the derivative of the course."""
        if self.kind == "sine":
            turn = 2.0 * np.pi / self.period_s
            return self.size * turn * float(np.cos(turn * tau_s))
        return 0.0 if self.order == 0 else self.size * tau_s ** (self.order - 1)
