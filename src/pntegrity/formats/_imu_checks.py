"""Whether the table of an inertial measurement unit can be what it says: gravity tells units and axes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

from pntegrity.errors import InputError
from pntegrity.kernels.mean_force import mean_force
from pntegrity.physics.time import SECOND_NS, to_iso
from pntegrity.records import FloatArray, Inertial

__all__ = ["check_gravity", "quietest", "without_hung"]

#: What the norm of the specific force at rest may be, m/s^2: gravity of the Earth and 0.5 m/s^2 (50 mg) of
#: bias, twice and a half what a consumer unit has.
LEAST_MPS2, MOST_MPS2 = 9.3, 10.3
#: Rates that bring mean specific forces so much nearer to gravity are right, and so are these.
STANDARD_MPS2, SWINGS = 9.80665, 0.5
#: The quietest stretch of this length stands for rest, s.
QUIET_S = 2.0
#: A unit that turns faster than this in its quietest stretch, or in one sample of a thousand, does not move
#: with a vehicle or a person: rad/s.
QUIET_RPS, FASTEST_RPS = 0.2, 15.0
#: Gravity may be felt this far from upwards.
MOST_TILT_DEG = 45.0
#: A unit hangs where so many samples, for so long, s, repeat the one before; a table with a larger share of
#: repeats is one of a unit at rest without noise.
HUNG, HUNG_S, MOST_SAME = 20, 1.0, 0.5


def check_gravity(whole: Inertial, path: Path, level: bool, turn: FloatArray) -> None:
    """Check that increments show gravity and no absurd rates.

    Parameters
    ----------
    whole : Inertial
    path : Path
        For the message.
    level : bool
        Whether gravity must be felt upwards.
    turn : ndarray, shape (3, 3)
        From the file's axes to those of the body.

    Raises
    ------
    InputError
        Saying which unit or axes it looks like.
    """
    force, rate = quietest(whole)
    odd = _odd_norm(float(np.linalg.norm(force)), float(np.median(whole.dt_s)), path)
    odd = odd or _odd_rates(whole, float(np.linalg.norm(rate)), path)
    if odd is not None and not _never_rests(whole):
        raise odd
    tilt = float(np.degrees(np.arccos(np.clip(-force[2] / np.linalg.norm(force), -1.0, 1.0))))
    if level and tilt > MOST_TILT_DEG:
        raise InputError(
            f"gravity is felt {tilt:.0f} deg from where a level body feels it: {_felt(turn.T @ force)}",
            path=path,
            hint="Give the mounting: --imu-axes names the file's axes that point forward, right, down "
            "(-x,y,-z, or flu where x is forward, y left, z up), --imu-mount-deg roll, pitch, yaw",
        )


def _never_rests(whole: Inertial) -> bool:
    """Tell whether the unit swings all the time, as on a rope: its rates turn what it feels into gravity, and
    better than without them.
    """
    increments = (whole.dt_s, whole.angle_rad, whole.velocity_mps)
    told, body = mean_force(*increments), mean_force(*increments, 0.0)
    if not len(told):
        return False
    off, without = abs(told - STANDARD_MPS2), abs(body - STANDARD_MPS2)
    inside = ((told >= LEAST_MPS2) & (told <= MOST_MPS2)).all()
    return bool(inside and np.median(off) < SWINGS * np.median(without))


def quietest(whole: Inertial) -> tuple[FloatArray, FloatArray]:
    """Return the mean specific force, m/s^2, and rate, rad/s, of the quietest stretch, shapes (3,)."""
    n = max(1, min(len(whole.t_ns), round(QUIET_S / float(np.median(whole.dt_s)))))
    used = len(whole.t_ns) // n * n
    dt = whole.dt_s[:used].reshape(-1, n)
    force = whole.velocity_mps[:used].reshape(-1, n, 3) / dt[..., None]
    rate = whole.angle_rad[:used].reshape(-1, n, 3) / dt[..., None]
    k = int(np.argmin(force.var(axis=1).sum(axis=1)))
    return force[k].mean(axis=0), rate[k].mean(axis=0)


def _odd_norm(norm: float, dt_s: float, path: Path) -> InputError | None:
    if LEAST_MPS2 <= norm <= MOST_MPS2:
        return None
    looks = {
        1.0: "it looks like g: name the columns acc_x_g",
        1000.0: "it looks like mg: name the columns acc_x_mg",
        32.17: "it looks like ft/s2: convert it to m/s2",
        96.17: "a factor g too much: it looks like m/s2 that is named g",
        9.807 * dt_s: "it looks like increments that are named forces: name the columns dv_x_mps",
        9.807 / dt_s: "it looks like forces that are named increments: name the columns acc_x_mps2",
    }
    hint = "; or ".join(words for value, words in looks.items() if abs(norm / value - 1.0) < 0.06)
    free = "gravity seems to be taken off: give the specific force that the sensor feels"
    hint = hint or (free if norm < 0.5 else "the unit or the scale of the accelerometers is wrong")
    return InputError(
        f"the specific force in the quietest stretch is {norm:.2f} m/s2, gravity is 9.8",
        path=path,
        hint=hint[0].upper() + hint[1:],
    )


def _odd_rates(whole: Inertial, quiet_rps: float, path: Path) -> InputError | None:
    norms = np.linalg.norm(whole.angle_rad, axis=1) / whole.dt_s
    fastest = float(np.quantile(norms, 0.999))
    if quiet_rps <= QUIET_RPS and fastest <= FASTEST_RPS:
        return None
    return InputError(
        f"angular rates are absurd: {quiet_rps:.2f} rad/s in the quietest stretch, {fastest:.1f} rad/s in "
        "one sample of a thousand",
        path=path,
        hint="They look like deg/s: name the columns gyro_x_dps, or dtheta_x_deg for increments in degrees",
    )


def _felt(force: FloatArray) -> str:
    """Return in words along which axis of the file gravity is felt."""
    k = int(np.argmax(np.abs(force)))
    sign = "+" if force[k] > 0.0 else "-"
    points = "up" if sign == "+" else "down"
    return f"the file has it along {sign}{'xyz'[k]} ({force[k]:.1f} m/s2), whose axis points {points}"


def without_hung(
    t_ns: npt.NDArray[np.int64], values: Mapping[str, FloatArray], path: Path, notes: list[str]
) -> tuple[npt.NDArray[np.int64], dict[str, FloatArray]]:
    """Return the samples without those of a unit that hangs: all six values unchanged for long, in a table
    that is otherwise alive.

    Parameters
    ----------
    t_ns : ndarray of int64
        Stamps, rising.
    values : mapping of str to ndarray
        By kind, shape (n, 3).
    path : Path
        The table, for the note.
    notes : list of str
        Gets what was dropped.
    """
    same = np.append(False, (np.diff(np.hstack(list(values.values())), axis=0) == 0.0).all(axis=1))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(np.int8)))
    hung = np.zeros(len(t_ns), dtype=bool)
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        hung[begin:end] = end - begin >= HUNG and t_ns[end - 1] - t_ns[begin - 1] >= HUNG_S * SECOND_NS
    if not hung.any() or same.mean() > MOST_SAME:
        return t_ns, dict(values)
    first = to_iso(int(t_ns[hung][0]))
    notes.append(
        f"{path.name}: {int(hung.sum())} lines dropped: all six values stay the same for a second or longer, "
        f"first at {first}"
    )
    return t_ns[~hung], {k: v[~hung] for k, v in values.items()}
