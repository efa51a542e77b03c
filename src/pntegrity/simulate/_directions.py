"""Faults in a direction: what a wrong place makes of positions and of what satellites say.

A receiver that is led astray sees codes, carriers and range rates that fit another place, as under spoofing:
all satellites together, each by its line of sight.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pntegrity.estimators._gnss import GnssOptions
from pntegrity.kernels.signatures import is_carrier, is_rate
from pntegrity.physics.frames import enu_rotation
from pntegrity.records import Epoch, FloatArray, Observation, group_of
from pntegrity.sensors.ranges import geometry
from pntegrity.sensors.snapshot import snapshot
from pntegrity.simulate._fault import PLACE, TOWARDS, Fault
from pntegrity.states import sensor_of

__all__ = ["directed", "share"]

#: For a place that lines of sight are drawn from all satellites count.
SKY = GnssOptions(mask_rad=0.0, doppler=False)


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
        own = np.array([fault.touches(k) and not (is_rate(k) or is_carrier(k)) for k in o.keys], dtype=bool)
        if "sv_pos_m" in o.aux and own.any():
            some = o.select(own)
            keys = tuple(f"{sensor_of(k) or group_of(k)}:C" for k in some.keys)
            fix = snapshot(Epoch(o.t_ns, (replace(some, sensor="code", keys=keys),)), SKY, _guess(fault))
            if not fix.reason:
                return fix.position_m
    return None


def _guess(fault: Fault) -> FloatArray:
    return np.zeros(3) if fault.place_m is None else np.array(fault.place_m)


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
