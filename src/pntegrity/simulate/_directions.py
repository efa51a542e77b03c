"""Faults in a direction: what a wrong place makes of positions and of what satellites say.

A receiver that is led astray sees codes, carriers and range rates that fit another place, as under spoofing:
all satellites together, each by its line of sight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pntegrity.kernels.signatures import is_carrier, is_rate
from pntegrity.physics.frames import enu_rotation
from pntegrity.records import Epoch, FloatArray, Observation
from pntegrity.sensors.ranges import geometry
from pntegrity.simulate._fault import PLACE, TOWARDS, Fault
from pntegrity.states import sensor_of

__all__ = ["directed", "share"]

#: A place on the ground is known after so many steps from the Earth's centre, m so well.
STEPS, CLOSE_M = 10, 10.0


def directed(fault: Fault, epoch: Epoch) -> Fault:
    """Return the fault with its direction in ECEF, which stays, and the last place that satellites are seen
    from, as far as the epochs have told.
    """
    if fault.signals not in TOWARDS:
        return fault
    place = _seen(fault, epoch)
    if place is None and fault.axis is None:
        place = _told(fault, epoch)
    if place is None:
        return fault
    x, y, z = place.tolist()
    if fault.axis is not None:
        return replace(fault, place_m=(x, y, z))
    u, v, w = (np.array(TOWARDS[fault.signals]) @ enu_rotation(place)).tolist()
    return replace(fault, axis=(u, v, w), place_m=(x, y, z))


def _told(fault: Fault, epoch: Epoch) -> FloatArray | None:
    """Return the first position among what the fault falls on."""
    for o in epoch.observations:
        own = (
            (k.partition(":")[2], y) for k, y in zip(o.keys, o.y.tolist(), strict=True) if fault.touches(k)
        )
        found = {PLACE[name]: y for name, y in own if name in PLACE}
        if len(found) == 3:
            return np.array([found[axis] for axis in range(3)])
    return None


def _seen(fault: Fault, epoch: Epoch) -> FloatArray | None:
    """Return about where the codes of the satellites that the fault falls on are from."""
    for o in epoch.observations:
        own = np.array(
            [fault.touches(k) and not is_rate(k) and not is_carrier(k) for k in o.keys], dtype=bool
        )
        if "sv_pos_m" in o.aux and own.sum() > 3:
            place = _fix(o.select(own), fault.place_m)
            if place is not None:
                return place
    return None


def _fix(o: Observation, guess_m: Sequence[float] | None) -> FloatArray | None:
    """Return a place from codes, a clock a constellation, to some hundred metres: no atmosphere is in it."""
    systems = [(sensor_of(k) or k)[0] for k in o.keys]
    clock = np.array([[s == each for each in sorted(set(systems))] for s in systems], dtype=np.float64)
    x = np.zeros(3) if guess_m is None else np.array(guess_m)
    for _ in range(STEPS):
        g = geometry(x, o.aux["sv_pos_m"])
        A = np.hstack([-g.los, clock])
        step, _, rank, _ = np.linalg.lstsq(A, o.y - g.range_m + o.aux["sv_clk_m"], rcond=None)
        if rank < A.shape[1]:
            return None
        x = np.asarray(x + step[:3], dtype=np.float64)
        if float(np.linalg.norm(step[:3])) < CLOSE_M:
            return x
    return None


def share(fault: Fault, o: Observation) -> FloatArray:
    """Return how much of a fault falls on each row of an observation, shape (m,): 1 without a direction, 0
    where it has one and nobody has told a place yet.
    """
    if fault.signals not in TOWARDS:
        return np.ones(len(o.keys))
    if fault.axis is None or fault.place_m is None:
        return np.zeros(len(o.keys))
    axis = np.array(fault.axis)
    if "sv_pos_m" in o.aux:
        return np.asarray(-geometry(np.array(fault.place_m), o.aux["sv_pos_m"]).los @ axis)
    names = [k.partition(":")[2] for k in o.keys]
    return np.array([axis[PLACE[n]] if n in PLACE else 0.0 for n in names])
