"""Faults as one line of text: who, what, how large, when; and their application to epochs.

``"G05 ramp 0.1 m/s 200:300"`` is a ramp on the code of G05 from 200 s to 300 s after the first epoch.
`GRAMMAR` has it all. Level rows (code, carrier) get the fault's course ``f(t)``; where a target takes range
rates along (``G05:*``), these get its derivative, so that a satellite clock that runs away looks like one. A
fault in a direction (``G:north``) changes each row as a receiver elsewhere would have it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from pntegrity.kernels.signatures import is_rate
from pntegrity.physics.time import to_iso
from pntegrity.records import Epoch, FloatArray, Observation
from pntegrity.simulate._directions import directed, share
from pntegrity.simulate._fault import PLACE, TOWARDS, Fault
from pntegrity.simulate._fault_text import GRAMMAR, describe, parse_fault
from pntegrity.states import is_satellite, sensor_of

__all__ = [
    "GRAMMAR", "Fault", "apply_faults", "describe", "out_of_time", "parse_fault", "signature",
    "touches_any", "units_of",
]  # fmt: skip


def signature(
    fault: Fault, keys: Sequence[str], t_ns: int, first_ns: int, timed: Sequence[bool | None] | None = None,
    along: FloatArray | None = None,
) -> FloatArray:  # fmt: skip
    """Return what a fault adds to each row at a time, shape (len(keys),).

    Parameters
    ----------
    fault : Fault
    keys : sequence of str
    t_ns, first_ns : int
        The time, and that of the log's first epoch.
    timed : sequence of bool or None, optional
        Which rows are travel times, as far as known.
    along : ndarray, optional
        How much of a fault in a direction falls on each row.

    Raises
    ------
    ValueError
        A fault in a direction without `along`.

    Examples
    --------
    >>> signature(parse_fault("G05 ramp 0.5 m/s 2:"), ("G05:C1C", "G07:C1C"), 6_000_000_000, 0).tolist()
    [2.0, 0.0]
    """
    if fault.signals in TOWARDS and along is None:
        raise ValueError(f"a fault to the {fault.signals} needs positions: `apply_faults` finds them")
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
        if fault.touches(key, timed[i] if timed is not None else None):
            out[i] = rate if is_rate(key) and not only_rates else level
    return out if along is None else out * along


def _times(o: Observation) -> list[bool | None]:
    """Return which rows are travel times; None: it is not told."""
    if "ways" in o.aux:
        return [bool(w) for w in o.aux["ways"].tolist()]
    return [_is_time(k) for k in o.keys]


def _is_time(key: str) -> bool | None:
    sensor = sensor_of(key)
    if key.partition(":")[2] in PLACE or sensor in ("X", "Y", "Z", "z", "range") or is_satellite(sensor):
        return False
    return True if sensor == "time" else None


def touches_any(fault: Fault, epochs: Sequence[Epoch]) -> bool:
    """Tell whether a fault falls on any row of the epochs while it is active."""
    first_ns = epochs[0].t_ns if epochs else 0
    return any(
        fault.active(e.t_ns, first_ns)
        and any(fault.touches(*row) for o in e.observations for row in zip(o.keys, _times(o), strict=True))
        for e in epochs
    )


def units_of(fault: Fault, epochs: Sequence[Epoch]) -> tuple[str, ...]:
    """Return the units that a fault could be in, m, s or rad, to fall on rows of the epochs; its own is not
    asked for.
    """
    others = (replace(fault, unit=unit) for unit in ("m", "s", "rad") if unit != fault.unit)
    return tuple(other.unit for other in others if touches_any(other, epochs))


def out_of_time(fault: Fault, epochs: Sequence[Epoch]) -> str:
    """Return in words when the rows of a fault are that falls on none of them; empty where there are none.

    Times are on the fault's own clock: seconds after the first epoch, or GPS time.
    """
    always = replace(fault, begin_ns=0, stop_ns=None, absolute=False)
    there = [e.t_ns for e in epochs if touches_any(always, (e,))]
    if not there:
        return ""
    t_ns = [e.t_ns for e in epochs]
    if any(fault.active(t, t_ns[0]) for t in t_ns):
        return f"no such row at that time: rows of it are {_span(fault, there, t_ns[0])}"
    often = f", every {float(np.median(np.diff(t_ns))) * 1e-9:.4g} s" if len(t_ns) > 1 else ""
    return f"no epoch in that time: epochs are {_span(fault, t_ns, t_ns[0])}{often}"


def _span(fault: Fault, t_ns: Sequence[int], first_ns: int) -> str:
    if fault.absolute:
        return f"from {to_iso(t_ns[0])} to {to_iso(t_ns[-1])}"
    begin, end = (f"{(t - first_ns) * 1e-9:.10g}" for t in (t_ns[0], t_ns[-1]))
    return f"from {begin} s to {end} s after the first"


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
        faults = [
            directed(f, epoch) if f.axis is None or f.active(epoch.t_ns, first_ns) else f for f in faults
        ]
        out.append(_faulty(epoch, faults, first_ns))
    return out


def _faulty(epoch: Epoch, faults: Sequence[Fault], first_ns: int) -> Epoch:
    changed = False
    observations = []
    for o in epoch.observations:
        timed = _times(o)
        shift = sum(
            (signature(f, o.keys, epoch.t_ns, first_ns, timed, share(f, o)) for f in faults),
            np.zeros(len(o.keys)),
        )
        here = shift != 0.0
        changed |= bool(here.any())
        observations.append(replace(o, y=np.where(here, o.y + shift, o.y)) if here.any() else o)
    return replace(epoch, observations=tuple(observations)) if changed else epoch
