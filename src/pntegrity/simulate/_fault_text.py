"""Faults as one line of text, read and told."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np

from pntegrity.physics.time import from_iso, to_iso
from pntegrity.simulate._fault import TOWARDS, UNITS, Fault, Kind
from pntegrity.states import is_satellite

__all__ = ["GRAMMAR", "describe", "parse_fault"]

GRAMMAR = """a fault is written [TARGET] KIND SIZE UNIT [PERIOD s] [START:END], as in
  G05 bias 15 m 60:100              the code of satellite G05, from 60 s to 100 s after the first epoch
  G05:C1C ramp 0.1 m/s 200:300      one signal; G05:C all code, G05:L the carrier, G05:D the range rates
  G05:* ramp 0.1 m/s 200:           code, carrier and range rate together (satellite clock), open end
  G* sine 3 m 20 s                  every GPS satellite (G alone means the same), from beginning to end
  clock-drift 0.01 m/s^2 100:200    receiver clock: drift on the range rates, its integral on code and carrier
  lbl bias 5 ms 1200:2400           a source of a vehicle: its travel times; m is for lengths, deg for angles
  lbl.T1 bias 5 ms 1200:2400        one sensor of it: a beacon; also gnss.G05, usbl.bearing
  gnss:north ramp 0.05 m/s 1200:    positions of a source, towards north, south, east, west, up or down
  *:north ramp 0.3 m/s 100:200      all satellites as from a place that drifts (spoofing); G:north, gnss:north
  gnss:RX bias 2 m 1200:            one axis of them, ECEF
times: seconds START:END, or GPS 2019-01-14T06:20:00/2019-01-14T06:25:00; the end itself is without the fault
units: m cm mm km; ns us of satellites (times the speed of light); ms s; deg mrad rad; each with /s or /s^2"""

_UNIT = re.compile(rf"({'|'.join(sorted(UNITS, key=len, reverse=True))})(/s(?:\^?2|²)?)?$")
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_TARGET = re.compile(r"(\*|[A-Za-z]\w*\*?)(?:\.([^\s:]+))?(?::(\S+))?$")
_SATELLITES = re.compile(r"\*|[A-Z]\d*")
_ORDERS = {"bias": (0,), "ramp": (1,), "sine": (0,), "clock-drift": (1, 2)}


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
    groups, sensor, signals = _target(text, target)
    size, order, unit = _size(text, kind, signals, words)
    _check_unit(text, kind, unit, (groups, sensor, signals))
    signals = "*" if kind == "clock-drift" else signals
    fault = Fault(groups, signals, kind, size, order, sensor=sensor, unit=UNITS[unit][0])
    if kind == "sine":
        fault = replace(fault, period_s=_period(text, words))
    if len(words) > 1:
        raise _bad(text, f"{' '.join(words[1:])!r} is too much")
    return _timed(text, fault, words[0]) if words else fault


def _bad(text: str, why: str) -> ValueError:
    return ValueError(f"fault {text!r}: {why}\n{GRAMMAR}")


def _target(text: str, word: str) -> tuple[str, str, str]:
    """Return group, sensor and signals."""
    found = _TARGET.match(word)
    if found is None:
        raise _bad(text, f"{word!r} is no target")
    group, signals = found[1] if found[1] == "*" else found[1].rstrip("*"), found[3] or ""
    return group, found[2] or "", signals if signals == "*" else signals.rstrip("*")


def _check_unit(text: str, kind: Kind, unit: str, target: tuple[str, str, str]) -> None:
    """Refuse units that the rows of a target cannot be in."""
    group, sensor, signals = target
    in_light = unit in ("ns", "us") and not _SATELLITES.fullmatch(group) and not is_satellite(sensor)
    if in_light:
        raise _bad(text, f"{unit} are those of satellites: write travel times of {group} in ms or s")
    if UNITS[unit][0] != "m" and (kind == "clock-drift" or signals in TOWARDS or is_satellite(group)):
        raise _bad(text, f"{unit} is no unit of what {group} measures")


def _size(text: str, kind: Kind, signals: str, words: list[str]) -> tuple[float, int, str]:
    """Take number and unit from the front of `words`; return the size in SI, the order and the unit."""
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
        allowed = " or ".join(UNITS[found[1]][0] + ("", "/s", "/s^2")[o] for o in orders if o <= 2)
        raise _bad(text, f"the unit of this {kind} must be {allowed}, not {unit}")
    return number * UNITS[found[1]][1], power - on_rates, found[1]


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


def describe(fault: Fault) -> str:
    """Return the fault in words.

    Examples
    --------
    >>> describe(parse_fault("G05 ramp 0.1 m/s 200:300"))
    'ramp of 0.1 m/s on the code of G05, from 200 s to 300 s'
    """
    power = fault.order + (1 if fault.signals.startswith("D") else 0)
    factor, base = {"rad": (180.0 / np.pi, "deg"), "s": (1e3, "ms")}.get(fault.unit, (1.0, fault.unit))
    unit = base + ("", "/s", "/s^2", "/s^3")[power]
    size = f"{fault.size * factor:g} {unit}" + (f" and {fault.period_s:g} s" if fault.kind == "sine" else "")
    return f"{fault.kind.replace('-', ' ')} of {size} on {_where(fault)}, {_when(fault)}"


def _where(fault: Fault) -> str:
    if fault.kind == "clock-drift" and fault.groups == "*":
        return "the receiver clock"
    if not _SATELLITES.fullmatch(fault.groups):
        return _where_of_source(fault)
    who = "all groups" if fault.groups == "*" else fault.groups
    if fault.groups.isalpha() and len(fault.groups) == 1:
        who = f"all {fault.groups} satellites"
    if fault.signals in TOWARDS:
        return f"{who} {_towards(fault)}"
    what = {"": "the code", "C": "the code", "L": "the carrier", "D": "the range rates", "*": "all rows"}
    return f"{what.get(fault.signals, fault.signals)} of {who}"


def _where_of_source(fault: Fault) -> str:
    who = f"{fault.groups}.{fault.sensor}" if fault.sensor else fault.groups
    if fault.signals in TOWARDS:
        return f"{who} {_towards(fault)}"
    what = {"": "", "*": "all rows of ", "D": "the rates of "}
    return what.get(fault.signals, f"{fault.signals} of ") + who


def _towards(fault: Fault) -> str:
    return f"{fault.signals}wards"


def _when(fault: Fault) -> str:
    def word(t_ns: int) -> str:
        return to_iso(t_ns) if fault.absolute else f"{t_ns * 1e-9:g} s"

    return f"from {word(fault.begin_ns)} " + ("on" if fault.stop_ns is None else f"to {word(fault.stop_ns)}")
