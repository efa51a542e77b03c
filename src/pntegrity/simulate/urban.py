"""A drive through a town: real motion and ephemerides, streets that hide satellites, errors of a real log.

Where buildings stand, the errors of satellites are blocks of an `ErrorLibrary`: a moving-block bootstrap. All
satellites of a block take their errors from the same seconds of the library, so that errors keep their
correlation in time and what satellites have in common; the ends of blocks are staggered from satellite to
satellite. Blocks come from seconds in which the library's vehicle was about as fast.

References
----------
Kuensch (1989), The jackknife and the bootstrap for general stationary observations, Annals of Statistics
17(3): moving blocks. Groves (2011), Shadow matching, Journal of Navigation 64: buildings as masks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pntegrity.physics.frames import elevation_azimuth, enu_rotations
from pntegrity.physics.tables import Navigation, SignalTable
from pntegrity.records import Epoch, FloatArray, Observation, group_of
from pntegrity.sensors.ranges import C_MPS, geometry
from pntegrity.simulate._urban_blocks import LOST, IntArray, Plan, Sky
from pntegrity.simulate.error_library import ErrorLibrary
from pntegrity.simulate.motion import Motion
from pntegrity.simulate.receiver import Receiver, epochs_of, simulate
from pntegrity.simulate.urban_scenario import Section, UrbanScenario

__all__ = ["Section", "Urban", "UrbanScenario", "urban_epochs"]


@dataclass(frozen=True, eq=False)
class Urban:
    """A simulated drive.

    Parameters
    ----------
    epochs : tuple of Epoch
        Code and range rates.
    position_m, velocity_mps, axes : ndarray, shapes (n, 3), (n, 3) and (n, 3, 3)
        Truth of the IMU.
    antenna_m : ndarray, shape (n, 3)
    kind : tuple of str
        Of the section of each epoch.
    sats : tuple of str, length m
    fate : ndarray of int, shape (n, m)
        -2 not received, -1 free of the library's errors, else the column of the library that its errors are
        of.
    """

    epochs: tuple[Epoch, ...]
    position_m: FloatArray
    velocity_mps: FloatArray
    axes: FloatArray
    antenna_m: FloatArray
    kind: tuple[str, ...]
    sats: tuple[str, ...]
    fate: IntArray


def urban_epochs(
    scenario: UrbanScenario,
    load: str,
    motion: Motion,
    t_ns: IntArray,
    nav: Navigation,
    library: ErrorLibrary,
    rng: np.random.Generator,
) -> Urban:
    """Return what a receiver on a drive observes.

    Parameters
    ----------
    scenario : UrbanScenario
    load : str
        One of the scenario's.
    motion : Motion
        Of the IMU; the antenna is a lever arm away.
    t_ns : ndarray of int64, shape (n,)
        Epochs; sections count from the first.
    nav : Navigation
    library : ErrorLibrary
        Of the same rate as the epochs.
    rng : numpy.random.Generator

    Raises
    ------
    ValueError
        Where the scenario has no such load, or the library is shorter than a block.
    """
    if load not in scenario.loads:
        raise ValueError(f"load {load!r} is none of {', '.join(scenario.loads)}")
    position, velocity, axes = motion.at(t_ns)
    antenna, moving = motion.of_point(t_ns, scenario.lever_arm_m)
    epochs = _open_sky(scenario, t_ns, antenna, moving, nav, rng)
    sky = _sky(epochs, antenna, axes)
    plan = Plan(scenario, scenario.loads[load], (t_ns - t_ns[0]) * 1e-9, sky, library)
    speed = np.linalg.norm(velocity, axis=1)
    fate, errors = plan.draw(speed, rng)
    kinds = tuple(scenario.sections[i].kind for i in plan.section.tolist())
    return Urban(
        tuple(_with(e, sky.sats, f, x) for e, f, x in zip(epochs, fate, errors, strict=True)),
        position, velocity, axes, antenna, kinds, sky.sats, fate,
    )  # fmt: skip


def _open_sky(
    scenario: UrbanScenario,
    t_ns: IntArray,
    place: FloatArray,
    moving: FloatArray,
    nav: Navigation,
    rng: np.random.Generator,
) -> tuple[Epoch, ...]:
    """Return what the receiver would see without buildings."""
    t_s = (t_ns - t_ns[0]) * 1e-9

    def trajectory(at_s: float) -> tuple[FloatArray, FloatArray]:
        k = int(np.abs(t_s - at_s).argmin())  # a clock's error away from an epoch
        return place[k] + (at_s - t_s[k]) * moving[k], moving[k]

    receiver = Receiver(
        scenario.noise, mask_rad=float(np.deg2rad(scenario.mask_deg)), drift_mps=scenario.drift_mps
    )
    kept = tuple(r for r in nav.kepler if r.satellite[0] in scenario.systems)
    nav = replace(nav, kepler=kept, glonass=nav.glonass if "R" in scenario.systems else ())
    table = simulate(nav, trajectory, t_ns, receiver, rng).table
    epochs = epochs_of(_stepped(table, scenario.clock_steps), nav)
    return tuple(
        replace(e, observations=tuple(o for o in e.observations if o.sensor != "carrier")) for e in epochs
    )


def _stepped(table: SignalTable, steps: Sequence[tuple[float, int]]) -> SignalTable:
    """Return the table of a receiver whose clock steps: time tags and pseudoranges move alike."""
    since = (table.t_ns - table.t_ns[0]) * 1e-9
    ms = np.zeros(len(since), dtype=np.int64)
    for at_s, step in steps:
        ms[since >= at_s] += step
    return replace(
        table,
        t_ns=table.t_ns + ms * 1_000_000,
        pseudorange_m=table.pseudorange_m + 1e-3 * C_MPS * ms[table.epoch],
    )


def _sky(epochs: Sequence[Epoch], place: FloatArray, axes: FloatArray) -> Sky:
    code = [e.sensor("code") for e in epochs]
    sats = tuple(sorted({group_of(k) for o in code if o is not None for k in o.keys}))
    forward = np.einsum("nij,nj->ni", enu_rotations(place), axes[:, :, 0])
    course = np.arctan2(forward[:, 0], forward[:, 1])
    el, relative = (np.full((len(epochs), len(sats)), np.nan) for _ in range(2))
    for k, o in enumerate(code):
        if o is not None:
            at = [sats.index(group_of(key)) for key in o.keys]
            up, az = elevation_azimuth(place[k], geometry(place[k], o.aux["sv_pos_m"]).los)
            el[k, at], relative[k, at] = up, az - course[k]
    return Sky(sats, el, relative)


def _with(epoch: Epoch, sats: tuple[str, ...], fate: IntArray, errors: FloatArray) -> Epoch:
    """Return the epoch with the fates and errors of its satellites."""
    made = tuple(_changed(o, sats, fate, errors) for o in epoch.observations)
    return replace(epoch, observations=tuple(o for o in made if o.keys))


def _changed(o: Observation, sats: tuple[str, ...], fate: IntArray, errors: FloatArray) -> Observation:
    at = np.array([sats.index(group_of(k)) for k in o.keys], dtype=np.intp)
    kept = fate[at] != LOST
    added = np.nan_to_num(errors[0 if o.sensor == "code" else 1, at])
    cn0 = np.where(np.isfinite(errors[2, at]), errors[2, at], o.aux["cn0_dbhz"])
    return replace(o, y=o.y + added, aux={**o.aux, "cn0_dbhz": cn0}).select(kept)
