"""What readers of acoustic logs share: the log, repeated values, times in common."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from pntegrity.errors import InputError
from pntegrity.formats.truth import Truth
from pntegrity.kernels.rotations import from_angles
from pntegrity.physics.acoustics import SoundSpeed
from pntegrity.physics.frames import enu_rotations
from pntegrity.physics.time import SECOND_NS, to_iso
from pntegrity.records import Epoch, FloatArray, Observation

__all__ = [
    "FIX_KEYS", "AcousticLog", "arms_of", "check_in_common", "epochs_of", "fix_of", "seconds_text_to_ns",
    "with_repeats",
]  # fmt: skip

FIX_KEYS = ("fix:RX", "fix:RY", "fix:RZ")
#: As many times unchanged is told.
TOLD_REPEATS = 3


@dataclass(frozen=True, eq=False)
class AcousticLog:
    """What one acoustic campaign holds.

    Parameters
    ----------
    source : str
    observations : tuple of Observation
        Travel times by time of reception, sensor `source`.
    fixes : tuple of Observation
        Positions of the antenna, sensor ``"fix"``: ECEF, rows `FIX_KEYS`, ``aux["cov"]`` (3, 3).
    attitude : Truth
        The antenna's positions and attitudes (roll, pitch, heading; rad) at transmissions and receptions.
    beacons : mapping of str to mapping
        As `sensors.lbl.Lbl` takes them.
    lever_arm_m : tuple of float
        From the antenna to the transducer, forward, right, down.
    sea_height_m : float
        Of the sea surface above the ellipsoid.
    profile : SoundSpeed
    notes : tuple of str
        What was dropped, and what is odd.
    """

    source: str
    observations: tuple[Observation, ...]
    fixes: tuple[Observation, ...]
    attitude: Truth
    beacons: Mapping[str, Mapping[str, float]]
    lever_arm_m: tuple[float, float, float]
    sea_height_m: float
    profile: SoundSpeed
    notes: tuple[str, ...] = ()

    def epochs(self) -> tuple[Epoch, ...]:
        """Return acoustics and fixes together, by time."""
        return epochs_of((*self.observations, *self.fixes))


def epochs_of(observations: Iterable[Observation]) -> tuple[Epoch, ...]:
    """Return observations by time, those of one instant in one epoch."""
    by_time: dict[int, list[Observation]] = {}
    for o in observations:
        by_time.setdefault(o.t_ns, []).append(o)
    return tuple(Epoch(t, tuple(by_time[t])) for t in sorted(by_time))


def fix_of(t_ns: int, position_m: FloatArray, cov: FloatArray) -> Observation:
    """Return a position with its covariance (3, 3), ECEF, as an observation."""
    return Observation("fix", t_ns, FIX_KEYS, position_m, np.sqrt(np.diagonal(cov)), {"cov": cov})


def with_repeats(
    observations: Sequence[Observation], notes: list[str], least: int = TOLD_REPEATS
) -> tuple[Observation, ...]:
    """Return observations with ``aux["repeated"]``: how many times in a row each key's value came unchanged.

    Parameters
    ----------
    observations : sequence of Observation
        By time.
    notes : list of str
        Gets the keys whose value came `least` times unchanged or more.
    least : int
    """
    last: dict[str, tuple[float, int]] = {}
    worst: dict[str, int] = {}
    out = []
    for o in observations:
        counts = np.zeros(len(o.keys), dtype=np.int64)
        for i, (key, y) in enumerate(zip(o.keys, o.y.tolist(), strict=True)):
            before, count = last.get(key, (np.nan, 0))
            counts[i] = count + 1 if y == before else 0
            last[key] = (y, int(counts[i]))
            worst[key] = max(worst.get(key, 0), int(counts[i]))
        out.append(replace(o, aux={**o.aux, "repeated": counts}))
    notes += [f"{key} repeats its last value, up to {n} times" for key, n in worst.items() if n >= least]
    return tuple(out)


def arms_of(positions_m: FloatArray, attitude_rad: FloatArray, arm_m: FloatArray) -> FloatArray:
    """Return a lever arm (forward, right, down) in ECEF at positions (n, 3) with roll, pitch, heading (n,
    3).
    """
    enu = from_angles(attitude_rad) @ arm_m
    return np.asarray(np.einsum("nij,ni->nj", enu_rotations(positions_m), enu))


def check_in_common(
    first: tuple[str, npt.NDArray[np.int64]], second: tuple[str, npt.NDArray[np.int64]],
    path: Path | None = None, notes: list[str] | None = None,
) -> None:  # fmt: skip
    """Check that two sources have times in common.

    Parameters
    ----------
    first, second : (str, ndarray of int64)
        Names, and times, ns of GPS time.
    path : Path, optional
        The file, for the message.
    notes : list of str, optional
        Gets how many of `first` lie outside of the other's span.

    Raises
    ------
    InputError
        None of the first lies in the span of the second: their clocks disagree. Both spans are named.
    """
    (name, t), (other, base) = first, second
    spans = [f"{n} from {to_iso(int(v.min()))} to {to_iso(int(v.max()))}" for n, v in (first, second)]
    outside = int(((t < base.min()) | (t > base.max())).sum())
    if outside == len(t):
        raise InputError(
            f"clocks disagree: no time in common: {spans[0]}, {spans[1]}", path=path,
            hint="Give both in GPS time; UTC is whole seconds behind it, J2000 begins 2000-01-01 12:00",
        )  # fmt: skip
    if outside and notes is not None:
        notes.append(f"{outside} of {len(t)} times of {name} are outside of the span of {other}")


def seconds_text_to_ns(text: str) -> int:
    """Return ns of a decimal number of seconds, without the rounding of a float (ValueError: no number)."""
    whole, _, decimals = text.strip().partition(".")
    if decimals and not decimals.isdigit():
        raise ValueError(f"{text!r} is no number of seconds")
    part = int((decimals + "000000000")[:9])
    return int(whole) * SECOND_NS + (-part if whole.startswith("-") else part)
