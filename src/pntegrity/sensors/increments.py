"""Increments of an inertial measurement unit, cut at the epochs of what it is fused with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from pntegrity.physics.time import to_iso
from pntegrity.records import Epoch, FloatArray, Inertial

__all__ = ["MAX_GAP_S", "with_increments"]

#: Missing samples are bridged up to this long.
MAX_GAP_S = 0.5
#: Increments that end and begin so close to each other touch, ns.
TOUCHING_NS = 1000
#: Before and after all times.
EVER_NS = 2**62

Times = npt.NDArray[np.int64]


def with_increments(
    epochs: Sequence[Epoch], whole: Inertial, max_gap_s: float = MAX_GAP_S, before_s: float = 1.0
) -> tuple[Epoch, ...]:
    """Return the epochs, each with the increments since the epoch before.

    An increment that an epoch falls into is cut there in proportion, so that the durations of an epoch's
    increments add up to the time since the epoch before. Short gaps are bridged with the mean rate of the
    increments on either side.

    Parameters
    ----------
    epochs : sequence of Epoch
        Rising in time.
    whole : Inertial
        All increments of the log.
    max_gap_s : float
        Longer gaps are left: `Inertial.reason` of the epochs whose time they take says so.
    before_s : float
        The first epoch gets the increments of this time before it, as far as there are any.

    Raises
    ------
    ValueError
        Where no increment lies in the time of the epochs; it gives both spans.
    """
    if not epochs:
        return ()
    t_ns = np.array([e.t_ns for e in epochs], dtype=np.int64)
    _check_overlap(t_ns, whole)
    bridged = _bridged(whole, max_gap_s)
    begins = np.append(t_ns[0] - round(before_s * 1e9), t_ns[:-1])
    pieces = _cut(bridged, np.append(begins[0], t_ns))
    at = np.searchsorted(pieces.t_ns, t_ns, side="right")
    first = np.searchsorted(pieces.t_ns, begins, side="right")
    reasons = _reasons(bridged, begins, t_ns)
    return tuple(
        replace(epoch, imu=_part(pieces, int(i), int(j), reason))
        for epoch, i, j, reason in zip(epochs, first, at, reasons, strict=True)
    )


def _check_overlap(t_ns: Times, whole: Inertial) -> None:
    there = (whole.t_ns > t_ns[0]) & (_begins(whole) < t_ns[-1])
    if len(t_ns) == 1:
        there = whole.t_ns >= t_ns[0]
    if there.any():
        return
    inertial = (
        f"from {to_iso(int(whole.t_ns[0]))} to {to_iso(int(whole.t_ns[-1]))}" if len(whole.t_ns) else "none"
    )
    raise ValueError(
        f"the IMU and the epochs have no time in common: epochs are from {to_iso(int(t_ns[0]))} to "
        f"{to_iso(int(t_ns[-1]))}, increments {inertial} (GPS time)"
    )


def _begins(whole: Inertial) -> Times:
    """Return where increments begin: at the end of the one before, where they touch."""
    begins = whole.t_ns - np.rint(whole.dt_s * 1e9).astype(np.int64)
    if len(begins):
        touching = np.abs(begins[1:] - whole.t_ns[:-1]) <= TOUCHING_NS
        begins[1:] = np.where(touching, whole.t_ns[:-1], np.maximum(begins[1:], whole.t_ns[:-1]))
    return begins


def _bridged(whole: Inertial, max_gap_s: float) -> Inertial:
    """Return the increments with short gaps filled: the mean of the rates before and after."""
    begins = _begins(whole)
    gap_ns = begins[1:] - whole.t_ns[:-1]
    at = np.flatnonzero((gap_ns > 0) & (gap_ns <= round(max_gap_s * 1e9))) + 1
    if not len(at):
        return whole
    dt = gap_ns[at - 1] * 1e-9

    def filled(increments: FloatArray) -> FloatArray:
        rate = increments / whole.dt_s[:, None]
        return np.insert(increments, at, 0.5 * (rate[at - 1] + rate[at]) * dt[:, None], axis=0)

    return Inertial(
        np.insert(whole.t_ns, at, begins[at]), np.insert(whole.dt_s, at, dt),
        filled(whole.angle_rad), filled(whole.velocity_mps), whole.reason,
    )  # fmt: skip


def _cut(whole: Inertial, marks_ns: Times) -> Inertial:
    """Return the increments from the first mark to the last, cut at the marks."""
    begins = _begins(whole)
    grid = np.unique(np.concatenate([whole.t_ns, begins, marks_ns]))
    grid = grid[(grid >= marks_ns[0]) & (grid <= marks_ns[-1])]
    left, right = grid[:-1], grid[1:]
    of = np.searchsorted(whole.t_ns, right, side="left").clip(0, len(whole.t_ns) - 1)
    inside = (begins[of] <= left) & (right <= whole.t_ns[of])
    left, right, of = left[inside], right[inside], of[inside]
    share = ((right - left) / (whole.t_ns - begins)[of])[:, None]
    return Inertial(right, (right - left) * 1e-9, share * whole.angle_rad[of], share * whole.velocity_mps[of])


def _part(pieces: Inertial, i: int, j: int, reason: str) -> Inertial:
    return Inertial(
        pieces.t_ns[i:j], pieces.dt_s[i:j], pieces.angle_rad[i:j], pieces.velocity_mps[i:j], reason
    )


def _reasons(whole: Inertial, begins_ns: Times, ends_ns: Times) -> list[str]:
    """Return for each interval why increments are missing in it, empty where none are.

    Before the first epoch nothing is missing: increments there are welcome, not needed.
    """
    out = [""] * len(ends_ns)
    for a, b, why in _missing(whole):
        i = int(np.searchsorted(ends_ns, a, side="right"))
        j = int(np.searchsorted(begins_ns, b, side="left"))
        for k in range(max(i, 1), j):
            out[k] = out[k] or why
    return out


def _missing(whole: Inertial) -> list[tuple[int, int, str]]:
    """Return from when to when increments are missing, and in words why."""
    begins = _begins(whole)
    first, last = int(begins[0]), int(whole.t_ns[-1])
    before = (-EVER_NS, first, f"the IMU begins at {to_iso(first)}")
    after = (last, EVER_NS, f"the IMU ends at {to_iso(last)}")
    at = np.flatnonzero(begins[1:] > whole.t_ns[:-1])
    gaps = zip(whole.t_ns[at].tolist(), begins[at + 1].tolist(), strict=True)
    told = [(a, b, f"the IMU has a gap of {(b - a) * 1e-9:.2f} s from {to_iso(a)}") for a, b in gaps]
    return [before, *told, after]
