"""Campaign on the mechanisation: against python-ins on the same increments, against theory, and its speed."""

from __future__ import annotations

import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from pntegrity.kernels.axes import local_axes
from pntegrity.kernels.gravity import EARTH_RATE, gravity
from pntegrity.kernels.rotations import from_angles
from pntegrity.kernels.strapdown import mechanise
from pntegrity.physics.frames import geodetic_to_ecef
from pntegrity.records import FloatArray
from pntegrity.scenarios._python_ins import MISSING, available
from pntegrity.scenarios._real_logs import Row, row, skipped
from pntegrity.sensors.imu import STIM300

__all__ = ["mechanisation"]

NAME = "mechanisation"
RATE_HZ = 125.0
PLACE = np.array(geodetic_to_ecef(np.deg2rad(35.1), np.deg2rad(136.9), 40.0))
EARTH_M = 6_371_000.0
#: Seconds of the comparison, and what it must stay below, m (None: stated).
SPANS: tuple[tuple[int, float | None], ...] = ((60, 0.01), (300, None))
#: Error growth must follow theory to this share.
SHARE = 0.02
#: How often a timed piece of work is done; the quickest counts.
REPEATS = 5


def mechanisation(data: Path) -> list[Row]:
    """Return the figures of the mechanisation; needs no data."""
    rows = [*_growth()]
    if not available():
        return rows + skipped(NAME, MISSING)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the other library, about pandas
        rows += [r for seconds, most in SPANS for r in _beside(seconds, most)]
    return rows


def _beside(seconds: int, most_m: float | None) -> list[Row]:
    """Return how far the two are apart after a lively drive, and what each costs."""
    from pyins import sim, strapdown, transform

    dt = 1.0 / RATE_HZ
    trajectory, imu = sim.generate_sine_velocity_motion(
        dt, seconds + 1.5 * dt, [35.1, 136.9, 20.0], [8.0, 5.0, 0.0], [6.0, 8.0, 0.2], 20.0,
        sensor_type="increment",
    )  # fmt: skip
    theirs, their_s = _timed(lambda: _integrated(strapdown, trajectory, imu))
    ours, our_s = _timed(lambda: _ours(trajectory.iloc[0], imu))
    expected = transform.lla_to_ecef(theirs[["lat", "lon", "alt"]].to_numpy())[: len(ours)]
    apart = float(np.nanmax(np.linalg.norm(ours - expected, axis=1)))
    rows = [row(
        NAME, f"largest distance from python-ins over {seconds} s, m",
        "stated" if most_m is None else f"< {most_m:g}",
        round(apart, 5), None if most_m is None else apart < most_m,
        note=f"the same increments at {RATE_HZ:g} Hz; {np.linalg.norm(ours[-1] - ours[0]):.0f} m of way",
    )]  # fmt: skip
    if most_m is None:
        return rows
    return [*rows, row(
        NAME, "CPU for a second at 125 Hz, with transition and noise of 21 errors, ms", "stated",
        round(1e3 * our_s / seconds, 3),
        note=f"python-ins without them: {1e3 * their_s / seconds:.3f} ms; ten calls a second",
    )]  # fmt: skip


# ---- error growth -------------------------------------------------------------------------------------


def _growth() -> list[Row]:
    """Return how far a level unit at rest that points north goes astray with the biases of the STIM300."""
    gyro, accel = STIM300.start_sigma()[[0, 3]]
    rows = []
    w = float(np.sqrt(np.linalg.norm(gravity(*PLACE)) / EARTH_M))
    for name, errors in (
        ("accelerometer forward", [0, 0, 0, accel, 0, 0]), ("gyroscope about right", [0, gyro, 0, 0, 0, 0]),
    ):  # fmt: skip
        for seconds in (60, 300):
            swing = accel / w**2 * (1.0 - np.cos(w * seconds))
            drift = EARTH_M * gyro * (seconds - np.sin(w * seconds) / w)
            expected = float(swing if errors[3] else drift)
            astray = abs(float((local_axes(PLACE) @ (_still(np.array(errors), seconds) - PLACE))[1]))
            rows.append(row(
                NAME, f"bias of the {name}: error north after {seconds} s, m", f"{expected:.3f}, to 2 %",
                round(astray, 3), bool(abs(astray - expected) <= SHARE * expected),
                note="theory: an oscillation of 84 min about a round Earth that does not turn",
            ))  # fmt: skip
    return rows


def _still(errors: FloatArray, seconds: int) -> FloatArray:
    """Return where a unit at rest, level and pointing north, is taken to be; `errors`: rates and forces."""
    C = local_axes(PLACE).T @ from_angles(np.zeros(3))
    dt = np.full(round(seconds * RATE_HZ), 1.0 / RATE_HZ)
    rate = C.T @ np.array([0.0, 0.0, EARTH_RATE]) + errors[:3]
    force = -C.T @ np.array(gravity(*PLACE)) + errors[3:]
    step = mechanise(
        PLACE, np.zeros(3), C, dt, np.outer(dt, rate), np.outer(dt, force), np.zeros(12), np.zeros(4)
    )
    return step.position_m


# ---- beside another library ---------------------------------------------------------------------------


def _timed(work: Any) -> tuple[Any, float]:
    """Return what some work gives, and the CPU time of the quickest of some tries."""
    took, found = [], work()
    for _ in range(REPEATS):
        begin = time.thread_time()
        found = work()
        took.append(time.thread_time() - begin)
    return found, min(took)


def _integrated(strapdown: Any, trajectory: Any, imu: Any) -> Any:
    other = strapdown.Integrator(trajectory.iloc[0])
    other.integrate(strapdown.compute_increments_from_imu(imu, "increment"))
    return other.trajectory


def _ours(start: Any, imu: Any) -> FloatArray:
    """Return our track at each increment, in calls of a tenth of a second."""
    r = np.array(geodetic_to_ecef(np.deg2rad(start.lat), np.deg2rad(start.lon), start.alt))
    axes = local_axes(r)
    v = axes.T @ np.array([start.VE, start.VN, -start.VD])
    C = axes.T @ from_angles(np.deg2rad(start[["roll", "pitch", "heading"]].to_numpy(float)))
    values, dt = imu.to_numpy()[1:], np.diff(imu.index)
    calls = np.array_split(np.arange(len(dt)), max(round(len(dt) / RATE_HZ * 10.0), 1))
    track, marks = [r], [0]
    for part in calls:
        r, v, C, *_ = mechanise(
            r, v, C, dt[part], values[part, :3], values[part, 3:], np.zeros(12), STIM300.densities()
        )
        track.append(r)
        marks.append(int(part[-1]) + 1)
    whole = np.full((len(dt) + 1, 3), np.nan)
    whole[marks] = np.array(track)
    return whole
