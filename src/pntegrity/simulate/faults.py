"""Faults as one line of text: who, what, how large, when; and their application to epochs.

``"G05 ramp 0.1 m/s 200:300"`` is a ramp on the code of G05 from 200 s to 300 s after the first epoch.
`GRAMMAR` has it all. Level rows (code, carrier) get the fault's course ``f(t)``; where a target takes range
rates along (``G05:*``), these get its derivative, so that a satellite clock that runs away looks like one.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from pntegrity.kernels.signatures import family_of, is_rate
from pntegrity.physics.time import from_iso, to_iso
from pntegrity.records import Epoch, FloatArray, group_of
from pntegrity.states import is_satellite

__all__ = [
    "GRAMMAR",
    "Fault",
    "apply_faults",
    "describe",
    "groups_at_fault",
    "parse_fault",
    "signature",
    "touches_any",
]

Kind = Literal["bias", "ramp", "sine", "clock-drift"]

GRAMMAR = """a fault is written [TARGET] KIND SIZE UNIT [PERIOD s] [START:END], as in
  G05 bias 15 m 60:100              the code of satellite G05, from 60 s to 100 s after the first epoch
  G05:C1C ramp 0.1 m/s 200:300      one signal; G05:C all code, G05:L the carrier, G05:D the range rates
  G05:* ramp 0.1 m/s 200:           code, carrier and range rate together (satellite clock), open end
  G* sine 3 m 20 s                  every GPS satellite (G alone means the same), from beginning to end
  clock-drift 0.01 m/s^2 100:200    receiver clock: drift on the range rates, its integral on code and carrier
times: seconds START:END, or GPS 2019-01-14T06:20:00/2019-01-14T06:25:00; the end itself is without the fault
units: m cm mm km ns us, each with /s or /s^2 (ns and us are taken times the speed of light)"""

_METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "km": 1e3, "ns": 0.299792458, "us": 299.792458}
_UNIT = re.compile(r"(km|cm|mm|ns|us|m)(/s(?:\^?2|²)?)?$")
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_TARGET = re.compile(r"(\*|[A-Za-z]+\d*\*?)(?::(\S+))?$")
_ORDERS = {"bias": (0,), "ramp": (1,), "sine": (0,), "clock-drift": (1, 2)}


@dataclass(frozen=True)
class Fault:
    """A fault with a beginning and an end; see `GRAMMAR`.

    Parameters
    ----------
    groups : str
        ``"G05"``, a family ``"G"``, or ``"*"``.
    signals : str
        Beginning of the signal names it touches; ``""``: code (of what is no satellite: all levels), ``"*"``:
        all rows.
    kind : str
        ``"bias"``, ``"ramp"``, ``"sine"`` or ``"clock-drift"``.
    size : float
        m times the power of 1/s that `order` says; where only range rates are meant, one power more.
    order : int
        0 for a bias or sine, 1 for a ramp or a constant drift, 2 for a drift that grows.
    period_s : float
        Of a sine.
    begin_ns, stop_ns : int
        After the first epoch, or GPS time where `absolute`; the end is excluded, None: it does not end.
    absolute : bool
        What the times are.
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

    def touches(self, key: str) -> bool:
        """Tell whether the fault falls on a row."""
        group, _, signal = key.partition(":")
        if self.groups not in ("*", group, family_of(key)):
            return False
        if self.signals:
            return self.signals == "*" or signal.startswith(self.signals)
        return signal.startswith("C") if is_satellite(group) else not is_rate(key)

    def hits(self, groups: Iterable[str]) -> frozenset[str]:
        """Return which of `groups` are at fault."""
        return frozenset(g for g in groups if self.groups in ("*", g, family_of(g)))

    def level(self, tau_s: float, length_s: float) -> float:
        """Return the course ``f``, m, at `tau_s` after the onset of a fault that lasts `length_s`."""
        tau = min(tau_s, length_s)
        if self.kind == "sine":
            return self.size * float(np.sin(2.0 * np.pi * tau / self.period_s))
        return self.size * tau**self.order / max(self.order, 1)

    def rate(self, tau_s: float) -> float:
        """Return the derivative of the course, m/s."""
        if self.kind == "sine":
            turn = 2.0 * np.pi / self.period_s
            return self.size * turn * float(np.cos(turn * tau_s))
        return 0.0 if self.order == 0 else self.size * tau_s ** (self.order - 1)


def parse_fault(text: str) -> Fault:
    """Return the fault that a line describes; `GRAMMAR` is the grammar.

    Raises
    ------
    ValueError
        The line does not fit; the message says where, and shows the grammar.

    Examples
    --------
    >>> parse_fault("G05 ramp 0.1 m/s 200:300").size
    0.1
    """
    words = re.sub(rf"(?<=\s)({_NUMBER})(?=[a-z])", r"\1 ", " ".join(text.split())).split()
    target = words.pop(0) if words and words[0] not in _ORDERS else "*:*"
    if not words or words[0] not in _ORDERS:
        raise _bad(text, f"the kind must be one of {', '.join(_ORDERS)}")
    kind: Kind = words.pop(0)  # type: ignore[assignment]
    if target == "*:*" and kind != "clock-drift":
        raise _bad(text, "only clock-drift goes without a target")
    groups, signals = _target(text, target)
    fault = Fault(groups, "*" if kind == "clock-drift" else signals, kind, *_size(text, kind, signals, words))
    if kind == "sine":
        fault = replace(fault, period_s=_period(text, words))
    if len(words) > 1:
        raise _bad(text, f"{' '.join(words[1:])!r} is too much")
    return _timed(text, fault, words[0]) if words else fault


def _bad(text: str, why: str) -> ValueError:
    return ValueError(f"fault {text!r}: {why}\n{GRAMMAR}")


def _target(text: str, word: str) -> tuple[str, str]:
    found = _TARGET.match(word)
    if found is None:
        raise _bad(text, f"{word!r} is no target")
    signals = found[2] or ""
    return found[1] if found[1] == "*" else found[1].rstrip(
        "*"
    ), signals if signals == "*" else signals.rstrip("*")


def _size(text: str, kind: Kind, signals: str, words: list[str]) -> tuple[float, int]:
    """Take number and unit from the front of `words`; return the size in SI and the order."""
    if len(words) < 2 or not re.fullmatch(_NUMBER, words[0]):
        raise _bad(text, "a size and its unit must follow the kind")
    number, unit = float(words.pop(0)), words.pop(0)
    if not np.isfinite(number):
        raise _bad(text, "the size must be finite")
    found = _UNIT.match(unit)
    if found is None:
        raise _bad(text, f"{unit!r} is no unit")
    power = 0 if not found[2] else 1 if found[2] == "/s" else 2
    on_rates = 1 if signals.startswith("D") and kind != "clock-drift" else 0
    orders = tuple(o + on_rates for o in _ORDERS[kind])
    if power not in orders:
        allowed = " or ".join("m" + ("", "/s", "/s^2")[o] for o in orders if o <= 2)
        raise _bad(text, f"the unit of this {kind} must be {allowed}, not {unit}")
    return number * _METRES[found[1]], power - on_rates


def _period(text: str, words: list[str]) -> float:
    if len(words) < 2 or not re.fullmatch(_NUMBER, words[0]) or words[1] != "s":
        raise _bad(text, "a sine needs its period, as in: sine 3 m 20 s")
    period = float(words.pop(0))
    words.pop(0)
    if period <= 0.0:
        raise _bad(text, f"the period must be above 0, not {period:g}")
    return period


def _timed(text: str, fault: Fault, word: str) -> Fault:
    absolute = "/" in word
    parts = word.split("/" if absolute else ":")
    if len(parts) != 2:
        raise _bad(text, f"{word!r} is no interval")
    read = from_iso if absolute else _seconds_ns
    try:
        begin = read(parts[0]) if parts[0] or absolute else 0
        stop = read(parts[1]) if parts[1] else None
    except ValueError:
        raise _bad(text, f"{word!r} is no interval") from None
    if stop is not None and stop <= begin:
        raise _bad(text, f"the end must come after the start in {word!r}")
    return replace(fault, begin_ns=begin, stop_ns=stop, absolute=absolute)


def _seconds_ns(part: str) -> int:
    value = float(part)
    if not 0.0 <= value < 1e9:
        raise ValueError(part)
    return round(value * 1e9)


def signature(fault: Fault, keys: Sequence[str], t_ns: int, first_ns: int) -> FloatArray:
    """Return what a fault adds to each row at a time, shape (len(keys),).

    Parameters
    ----------
    fault : Fault
    keys : sequence of str
    t_ns, first_ns : int
        The time, and that of the log's first epoch.
    """
    out = np.zeros(len(keys))
    onset, end = fault.onset_ns(first_ns), fault.end_ns(first_ns)
    over = end is not None and t_ns >= end
    if t_ns < onset or (over and fault.kind != "clock-drift"):
        return out
    tau = (t_ns - onset) * 1e-9
    length = float("inf") if end is None else (end - onset) * 1e-9
    level, rate = fault.level(tau, length), 0.0 if over else fault.rate(tau)
    only_rates = fault.signals.startswith("D")
    for i, key in enumerate(keys):
        if fault.touches(key):
            out[i] = rate if is_rate(key) and not only_rates else level
    return out


def touches_any(fault: Fault, epochs: Sequence[Epoch]) -> bool:
    """Tell whether a fault falls on any row of the epochs while it is active."""
    first_ns = epochs[0].t_ns if epochs else 0
    return any(
        fault.active(e.t_ns, first_ns) and any(fault.touches(k) for o in e.observations for k in o.keys)
        for e in epochs
    )


def apply_faults(
    epochs: Iterable[Epoch], faults: Sequence[Fault], first_ns: int | None = None
) -> list[Epoch]:
    """Return the epochs with the faults in them; what no fault touches is passed on as it is.

    Parameters
    ----------
    epochs : iterable of Epoch
    faults : sequence of Fault
    first_ns : int, optional
        Where seconds are counted from; the first epoch where not given.
    """
    out: list[Epoch] = []
    for epoch in epochs:
        first_ns = epoch.t_ns if first_ns is None else first_ns
        out.append(_faulty(epoch, faults, first_ns))
    return out


def _faulty(epoch: Epoch, faults: Sequence[Fault], first_ns: int) -> Epoch:
    changed = False
    observations = []
    for o in epoch.observations:
        shift = sum((signature(f, o.keys, epoch.t_ns, first_ns) for f in faults), np.zeros(len(o.keys)))
        here = shift != 0.0
        changed |= bool(here.any())
        observations.append(replace(o, y=np.where(here, o.y + shift, o.y)) if here.any() else o)
    return replace(epoch, observations=tuple(observations)) if changed else epoch


def describe(fault: Fault) -> str:
    """Return the fault in words.

    Examples
    --------
    >>> describe(parse_fault("G05 ramp 0.1 m/s 200:300"))
    'ramp of 0.1 m/s on the code of G05, from 200 s to 300 s'
    """
    power = fault.order + (1 if fault.signals.startswith("D") else 0)
    unit = "m" + ("", "/s", "/s^2", "/s^3")[power]
    size = f"{fault.size:g} {unit}" + (f" and {fault.period_s:g} s" if fault.kind == "sine" else "")
    return f"{fault.kind.replace('-', ' ')} of {size} on {_where(fault)}, {_when(fault)}"


def _where(fault: Fault) -> str:
    if fault.kind == "clock-drift" and fault.groups == "*":
        return "the receiver clock"
    who = "all groups" if fault.groups == "*" else fault.groups
    if fault.groups.isalpha() and len(fault.groups) == 1:
        who = f"all {fault.groups} satellites"
    what = {"": "the code", "C": "the code", "L": "the carrier", "D": "the range rates", "*": "all rows"}
    return f"{what.get(fault.signals, fault.signals)} of {who}"


def _when(fault: Fault) -> str:
    def word(t_ns: int) -> str:
        return to_iso(t_ns) if fault.absolute else f"{t_ns * 1e-9:g} s"

    return f"from {word(fault.begin_ns)} " + ("on" if fault.stop_ns is None else f"to {word(fault.stop_ns)}")


def groups_at_fault(faults: Sequence[Fault], keys: Iterable[str], t_ns: int, first_ns: int) -> frozenset[str]:
    """Return the groups of `keys` that a fault is present on at a time."""
    groups = {group_of(k) for k in keys}
    return frozenset(g for f in faults if f.active(t_ns, first_ns) for g in f.hits(groups))
