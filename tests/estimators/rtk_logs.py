"""Logs for PPP-RTK that several test files share: simulated epochs of each band apart, with products."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from gnss_logs import PLACE, SECOND, START, navigation, without
from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators.ppp_rtk import PppRtk
from pntegrity.physics.frames import enu_rotation
from pntegrity.physics.orbits import satellite_states
from pntegrity.records import Epoch, State, Update
from pntegrity.sensors.noise import PPP_RTK, PPP_RTK_PUBLISHED, NoiseModel
from pntegrity.simulate.precise import PreciseReceiver
from pntegrity.simulate.uncombined import Air, Uncombined, simulate_uncombined

STEP = 30
PAIR = {"G": "1C+2W", "E": "1C+7Q", "R": "1C"}
NO_PRODUCTS = Air(iono_m=0.0, wet_m=0.0)
QUIET = replace(
    PPP_RTK_PUBLISHED, code_white_m=1e-3, carrier_m=1e-5, zwd_walk_m=1e-9, iono_walk_m=1e-4, isb_m=1e-6
)


@lru_cache(maxsize=24)
def simulated(
    n: int = 40, noise: NoiseModel = PPP_RTK, air: Air | None = None, seed: int = 1, systems: str = "GE",
    step_s: int = STEP, **receiver
) -> Uncombined:  # fmt: skip
    """Return what a receiver at `PLACE` sees, whose errors are those of the filter's model."""
    nav = navigation(systems, 7200)
    names = sorted({r.satellite for r in (*nav.kepler, *nav.glonass)})
    t_ns = START + step_s * SECOND * np.arange(n, dtype=np.int64)

    def states(sats, t, ranges):
        return satellite_states(nav, sats, t, ranges, [PAIR[s[0]] for s in sats.tolist()])

    made = PreciseReceiver(noise=noise, **receiver)
    rng = np.random.default_rng(seed)
    return simulate_uncombined(states, names, t_ns, np.tile(PLACE, (n, 1)), made, rng, air)


def rtk(noise: NoiseModel = PPP_RTK, **changes) -> PppRtk:
    return PppRtk(replace(GnssOptions(noise=noise, max_gap_s=PppRtk.max_gap_s), **changes))


def updates(estimator: PppRtk, epochs, exclude=lambda k: frozenset()) -> list[Update]:
    state, out = State.empty(), []
    for k, epoch in enumerate(epochs):
        out.append(estimator.correct(estimator.predict(state, epoch), epoch, exclude(k)))
        state = out[-1].posterior
    return out


def enu(found: list[Update]) -> np.ndarray:
    return np.array([u.posterior.mean[:3] - PLACE for u in found]) @ enu_rotation(PLACE).T


def from_epoch(k0: int, *names: str):
    return lambda k: frozenset(names) if k >= k0 else frozenset()


def row(update: Update, key: str) -> int:
    return update.keys.index(key)


def edited(epochs, sensor: str, change) -> list[Epoch]:
    """Return the epochs with `change(k, observation)` in the place of a sensor's observation."""
    return [
        replace(e, observations=tuple(change(k, o) if o.sensor == sensor else o for o in e.observations))
        for k, e in enumerate(epochs)
    ]


def kept(o, wanted):
    return o.select(np.array([wanted(key) for key in o.keys], dtype=bool))


def without_products(epoch: Epoch, *names: str) -> Epoch:
    """Return the epoch without the products whose keys begin with one of some names."""
    return edited([epoch], "atmosphere", lambda k, o: kept(o, lambda key: not key.startswith(names)))[0]


def absent(epoch: Epoch, sat: str) -> Epoch:
    """Return the epoch as if a satellite was not there, its product neither."""
    return without_products(without(epoch, [sat]), f"iono:{sat}")
