"""Logs of a vessel with an inertial unit and any sources: what each would measure on a known motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pntegrity.formats.truth import Truth
from pntegrity.physics.frames import enu_rotation, geodetic_to_ecef
from pntegrity.records import Epoch, FloatArray, Inertial, Observation
from pntegrity.sensors.imu import STIM300, ImuSpec
from pntegrity.sensors.increments import with_increments
from pntegrity.sensors.source import Pose, Source, Track
from pntegrity.simulate.imu import increments, with_errors
from pntegrity.simulate.motion import Motion, motion_of

__all__ = ["Fault", "VesselLog", "cruise", "led_astray", "measured", "pose_at", "vessel_log", "with_faults"]

Fault = tuple[str, float, float, float, float]
"""Key of a row, jump and rate a second in its unit, from and to, s."""

#: How long ago a signal may have left, s, and how often a second the way is known in between.
TRACK_S, TRACK_HZ = 6.0, 10
#: Time of travel is found by going back and forth so many times.
PASSES = 3


@dataclass(frozen=True, eq=False)
class VesselLog:
    """Epochs with increments and what the sources said, and the motion behind them."""

    epochs: tuple[Epoch, ...]
    sources: tuple[Source, ...]
    motion: Motion
    inertial: Inertial

    @property
    def truth(self) -> Truth:
        """The motion at the epochs."""
        t_ns = np.array([e.t_ns for e in self.epochs], dtype=np.int64)
        return Truth(t_ns, self.motion.at(t_ns)[0])


def cruise(
    start_ns: int, seconds: float, lat_deg: float = 32.0, lon_deg: float = 122.0, speed_mps: float = 2.5
) -> Motion:
    """Return a cruise at sea: a course that weaves, swell from the side.

    Parameters
    ----------
    start_ns : int
    seconds : float
    lat_deg, lon_deg : float
        Where it begins.
    speed_mps : float
    """
    s = np.arange(0.0, seconds + 0.5, 0.5)
    heading = np.radians(10.0 + 35.0 * np.sin(2.0 * np.pi * s / 50.0))
    step = 0.5 * speed_mps
    enu = np.stack([np.cumsum(step * np.sin(heading)), np.cumsum(step * np.cos(heading)),
                    0.3 * np.sin(2.0 * np.pi * s / 7.0)], axis=1)  # fmt: skip
    place = geodetic_to_ecef(np.radians(lat_deg), np.radians(lon_deg), 0.0)
    attitude = np.stack([np.radians(4.0) * np.sin(2.0 * np.pi * s / 9.0),
                         np.radians(2.0) * np.sin(2.0 * np.pi * s / 7.0 + 1.0), heading], axis=1)  # fmt: skip
    t_ns = start_ns + np.round(s * 1e9).astype(np.int64)
    return motion_of(Truth(t_ns, place + enu @ enu_rotation(place), attitude_rad=attitude))


def pose_at(motion: Motion, t_ns: int) -> Pose:
    """Return the true pose at a time, with the way there: up to `TRACK_S` of it, where the motion has it.

    Parameters
    ----------
    motion : Motion
    t_ns : int
        Within the motion's span.
    """
    first = max(t_ns - round(TRACK_S * 1e9), motion.span_ns[0])
    times = np.unique(np.linspace(first, t_ns, round(TRACK_S * TRACK_HZ) + 1).round().astype(np.int64))
    position, velocity, C = motion.at(times)
    rate = motion.attitude(motion.seconds([t_ns]), 1)[0]
    return Pose(t_ns, position[-1], velocity[-1], C[-1], rate, Track(times, position, C))


def measured(
    source: Source, keys: Sequence[str], pose: Pose, rng: np.random.Generator, guess: float = 1.0
) -> Observation:
    """Return what a source measures at a pose, with white errors of its own covariance.

    Parameters
    ----------
    source : Source
    keys : sequence of str
        Rows.
    pose : Pose
        The true one.
    rng : numpy.random.Generator
    guess : float
        What the rows read about, in their units.

    Raises
    ------
    ValueError
        Rows that the source cannot have there.
    """
    own = {n.name: 0.0 for n in source.nuisances()}
    o = Observation(source.name, pose.t_ns, tuple(keys), np.full(len(keys), guess), aux=_spread(len(keys)))
    for _ in range(PASSES):
        rows = source.rows(o, replace(pose, nuisance=own))
        if rows.keys != o.keys:
            raise ValueError(f"{source.name}: {rows.reason}")
        o = replace(o, y=o.y - rows.nu)
    noise = np.linalg.cholesky(rows.R) @ rng.standard_normal(len(keys))
    return replace(o, y=o.y + noise)


def _spread(rows: int) -> dict[str, FloatArray]:
    """Return what a fix says of its covariance: nothing beyond the floors of its source."""
    return {"cov": np.zeros((rows, rows))}


def vessel_log(
    motion: Motion, sources: Mapping[Source, Sequence[str]], rng: np.random.Generator, *,
    spec: ImuSpec = STIM300, imu_hz: float = 100.0, rate_hz: float = 1.0,
    besides: Mapping[int, Observation] | None = None,
) -> VesselLog:  # fmt: skip
    """Return a log of a vessel.

    Parameters
    ----------
    motion : Motion
    sources : mapping of Source to sequence of str
        With the rows of each.
    rng : numpy.random.Generator
    spec : ImuSpec
    imu_hz, rate_hz : float
        Increments and epochs a second.
    besides : mapping of int to Observation, optional
        What a further source says, by time.
    """
    first, last = motion.span_ns
    inertial, _ = with_errors(increments(motion, first, last, imu_hz), spec, rng)
    epochs = []
    for k in range(round(TRACK_S * rate_hz), int((last - first) * 1e-9 * rate_hz)):
        t_ns = first + round(k * 1e9 / rate_hz)
        pose = pose_at(motion, t_ns)
        said = [measured(s, keys, pose, rng) for s, keys in sources.items()]
        said += [o for o in [(besides or {}).get(t_ns)] if o is not None]
        epochs.append(Epoch(t_ns, tuple(said)))
    return VesselLog(with_increments(epochs, inertial), tuple(sources), motion, inertial)


def with_faults(log: VesselLog, faults: Sequence[Fault]) -> VesselLog:
    """Return a log with faults: its errors stay what they were.

    Parameters
    ----------
    log : VesselLog
    faults : sequence of Fault
    """
    return replace(
        log, epochs=tuple(_faulty(e, (e.t_ns - log.motion.span_ns[0]) * 1e-9, faults) for e in log.epochs)
    )


def _faulty(epoch: Epoch, t_s: float, faults: Sequence[Fault]) -> Epoch:
    off = {f[0]: f[1] + f[2] * (t_s - f[3]) for f in faults if f[3] <= t_s < f[4]}
    said = (replace(o, y=o.y + np.array([off.get(k, 0.0) for k in o.keys])) for o in epoch.observations)
    return replace(epoch, observations=tuple(said)) if off else epoch


def led_astray(
    log: VesselLog, names: Sequence[str], enu_mps: Sequence[float], from_s: float, to_s: float
) -> VesselLog:
    """Return a log in which some sources measure as from a place that drifts off.

    Parameters
    ----------
    log : VesselLog
    names : sequence of str
        Of the sources that drift together.
    enu_mps : sequence of float
        East, north, up.
    from_s, to_s : float
        After the begin of the motion.
    """
    first = log.motion.span_ns[0]
    axes = enu_rotation(log.motion.at([first])[0][0])
    drift_mps = np.asarray(enu_mps) @ axes
    apart = [s for s in log.sources if s.name in names]

    def moved(epoch: Epoch) -> Epoch:
        t_s = (epoch.t_ns - first) * 1e-9
        if not from_s <= t_s < to_s:
            return epoch
        pose = pose_at(log.motion, epoch.t_ns)
        there = _shifted(pose, drift_mps * (t_s - from_s), drift_mps)
        said = {s.name: o for o in epoch.observations for s in apart if o.sensor == s.name}
        new = {s.name: _as_from(s, said[s.name], pose, there) for s in apart if s.name in said}
        return replace(epoch, observations=tuple(new.get(o.sensor, o) for o in epoch.observations))

    return replace(log, epochs=tuple(moved(e) for e in log.epochs))


def _shifted(pose: Pose, by_m: FloatArray, by_mps: FloatArray) -> Pose:
    track = replace(pose.track, position_m=pose.track.position_m + by_m)
    return replace(
        pose, position_m=pose.position_m + by_m, velocity_mps=pose.velocity_mps + by_mps, track=track
    )


def _as_from(source: Source, o: Observation, here: Pose, there: Pose) -> Observation:
    """Return a measurement as it would be elsewhere, with the errors that it has here."""
    own = {n.name: 0.0 for n in source.nuisances()}
    before, after = (source.rows(o, replace(pose, nuisance=own)) for pose in (here, there))
    off = dict(zip(before.keys, (before.nu - after.nu).tolist(), strict=True))
    return replace(o, y=o.y + np.array([off.get(k, 0.0) for k in o.keys]))
