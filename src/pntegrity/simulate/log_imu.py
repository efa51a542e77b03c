"""An inertial measurement unit on the track of a real log that has none."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pntegrity.formats._acoustics import AcousticLog
from pntegrity.formats.truth import Truth
from pntegrity.kernels.rotations import attitude_angles
from pntegrity.physics.frames import enu_rotation
from pntegrity.records import FloatArray, Inertial
from pntegrity.sensors.imu import ImuSpec
from pntegrity.simulate.imu import increments, with_errors
from pntegrity.simulate.motion import Motion, motion_through

__all__ = ["LogImu", "log_motion", "simulated_imu"]

#: How much of the log beside the asked span shapes the motion, s.
MARGIN_S = 60.0
#: A unit begins so long before what it is made for, s: an alignment needs to feel something.
BEFORE_S = 1.0
#: Increments are made in stretches of this length, s.
STRETCH_S = 600.0


@dataclass(frozen=True, eq=False)
class LogImu:
    """A simulated unit, and the motion that is its truth.

    Parameters
    ----------
    increments : Inertial
        As measured, body axes.
    errors : ndarray, shape (n, 12)
        As `simulate.imu.with_errors` returns them.
    motion : Motion
        Of the unit, which is where the antenna is.
    """

    increments: Inertial
    errors: FloatArray
    motion: Motion

    @property
    def span_ns(self) -> tuple[int, int]:
        """Begin of the first increment, end of the last."""
        t, dt = self.increments.t_ns, self.increments.dt_s
        return int(t[0]) - round(float(dt[0]) * 1e9), int(t[-1])

    def heading_rad(self, t_ns: int) -> float:
        """Return the heading at a time, clockwise from north."""
        position, _, C = self.motion.at([t_ns])
        return float(attitude_angles(enu_rotation(position[0]) @ C[0])[2] % (2.0 * np.pi))


def log_motion(log: AcousticLog, start_ns: int | None = None, end_ns: int | None = None) -> Motion:
    """Return the smooth motion of a log's antenna.

    Parameters
    ----------
    log : AcousticLog
    start_ns, end_ns : int, optional
        Only what is needed of it.

    Raises
    ------
    ValueError
        Too few positions or attitudes in that time.
    """
    fixes = Truth(
        np.array([o.t_ns for o in log.fixes], dtype=np.int64), np.array([o.y[:3] for o in log.fixes])
    )
    return motion_through(_cut(fixes, start_ns, end_ns), _cut(log.attitude, start_ns, end_ns))


def _cut(track: Truth, start_ns: int | None, end_ns: int | None) -> Truth:
    margin, n = round(MARGIN_S * 1e9), len(track.t_ns)
    first = 0 if start_ns is None else max(int(np.searchsorted(track.t_ns, start_ns - margin)) - 1, 0)
    last = n if end_ns is None else int(np.searchsorted(track.t_ns, end_ns + margin)) + 1
    kept = slice(first, last)
    angles = None if track.attitude_rad is None else track.attitude_rad[kept]
    return replace(track, t_ns=track.t_ns[kept], position_m=track.position_m[kept], attitude_rad=angles)


def simulated_imu(
    log: AcousticLog, spec: ImuSpec, seed: int, start_ns: int | None = None, end_ns: int | None = None
) -> LogImu:
    """Return what a unit at the antenna of a log would have measured.

    The truth is the log's own smoothed track: fixes fit it better than their errors are, and waves that are
    faster than the fixes are not in it.

    Parameters
    ----------
    log : AcousticLog
    spec : ImuSpec
        Its errors and its rate.
    seed : int
    start_ns, end_ns : int, optional
        Of a run that uses it: the unit begins a second before. All that the log knows positions and attitudes
        of, where not given.

    Raises
    ------
    ValueError
        Nothing of that is in the log.
    """
    motion = log_motion(log, start_ns, end_ns)
    first, last = motion.span_ns
    begin = first if start_ns is None else max(first, start_ns - round(BEFORE_S * 1e9))
    end = last if end_ns is None else min(last, end_ns)
    measured, errors = with_errors(
        _increments(motion, begin, end, spec.rate_hz), spec, np.random.default_rng(seed)
    )
    return LogImu(measured, errors, motion)


def _increments(motion: Motion, begin_ns: int, end_ns: int, rate_hz: float) -> Inertial:
    step = round(STRETCH_S * 1e9)
    starts = [t for t in range(begin_ns, end_ns, step) if t + 0.5e9 / rate_hz < end_ns] or [begin_ns]
    ends = [*starts[1:], end_ns]
    parts = [increments(motion, a, b, rate_hz) for a, b in zip(starts, ends, strict=True)]
    return Inertial(
        np.concatenate([p.t_ns for p in parts]), np.concatenate([p.dt_s for p in parts]),
        np.concatenate([p.angle_rad for p in parts]), np.concatenate([p.velocity_mps for p in parts]),
    )  # fmt: skip
