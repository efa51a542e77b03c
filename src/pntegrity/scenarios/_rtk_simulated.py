"""Simulated PPP-RTK under real or nominal constellations: what the campaigns and the reproduction run on."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from pntegrity.bounds.ism import Ism
from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators.ppp_rtk import PppRtk
from pntegrity.formats.sp3 import read_orbits
from pntegrity.physics.frames import enu_rotation
from pntegrity.physics.orbits import satellite_states
from pntegrity.physics.precise import precise_states
from pntegrity.physics.time import from_iso
from pntegrity.records import Epoch, FloatArray, State, Update
from pntegrity.sensors.noise import PPP_RTK, PPP_RTK_PUBLISHED, NoiseModel
from pntegrity.simulate.constellation import nominal_navigation
from pntegrity.simulate.precise import PreciseReceiver, States
from pntegrity.simulate.uncombined import Air, simulate_uncombined

__all__ = ["Sky", "errors_m", "estimator", "facts", "isms", "model", "sky", "updates_of"]

LONGEST_S = 7200
CODES = {"G": "1C+2W", "C": "2I+6I"}
BASES = {"default": PPP_RTK, "published": PPP_RTK_PUBLISHED}


@cache
def facts() -> dict[str, Any]:
    """Return what ``ppp_rtk.toml`` holds."""
    return tomllib.loads(files("pntegrity.scenarios").joinpath("ppp_rtk.toml").read_text(encoding="utf-8"))


@dataclass(frozen=True, eq=False)
class Sky:
    """A place, a time and the satellites; `label` says how real they are."""

    label: str
    states: States
    sats: tuple[str, ...]
    start_ns: int
    place_m: FloatArray

    def epochs(
        self, noise: NoiseModel, step_s: float, n: int, rng: np.random.Generator, air: Air | None = None
    ) -> tuple[Epoch, ...]:
        """Return what a receiver there sees, whose errors are those of `noise`."""
        t_ns = self.start_ns + np.arange(n, dtype=np.int64) * round(step_s * 1e9)
        track = np.tile(self.place_m, (n, 1))
        receiver = PreciseReceiver(noise=noise)
        return simulate_uncombined(self.states, self.sats, t_ns, track, receiver, rng, air).epochs


@lru_cache(maxsize=4)
def sky(data: Path | None) -> Sky:
    """Return the geometry of the campaigns: real orbits where the data folder has them, else nominal ones."""
    g = facts()["geometry"]
    start, place = from_iso(g["start"]), np.array(g["place_m"])
    file = data / g["folder"] / g["sp3"] if data is not None else None
    if file is not None and file.is_file():
        orbits = read_orbits([file])
        sats = tuple(s for s in orbits.sats if s[0] in g["systems"])
        return Sky(
            "real orbits over OPEC", lambda n, t, r: precise_states(orbits, orbits.clocks, n, t, r), sats,
            start, place,
        )  # fmt: skip
    nav = nominal_navigation(start, start + LONGEST_S * 10**9, g["systems"])
    sats = tuple(sorted({r.satellite for r in nav.kepler}))

    def states(names: Any, times: Any, range_m: FloatArray) -> Any:
        return satellite_states(nav, names, times, range_m, [CODES[s[0]] for s in names.tolist()])

    return Sky("nominal constellations over OPEC", states, sats, start, place)


def model(name: str) -> NoiseModel:
    """Return a noise model of the file."""
    fields = dict(facts()["models"][name])
    return replace(BASES[fields.pop("base")], **fields)


def estimator(noise: NoiseModel) -> PppRtk:
    """Return the filter of a noise model; positions are white, as in the paper."""
    return PppRtk(GnssOptions(noise=noise, max_gap_s=PppRtk.max_gap_s))


def isms(split: str, **fields: Any) -> dict[str, Ism]:
    """Return the integrity support messages of the four cases."""
    shares = tuple(facts()["splits"][split])
    return {name: Ism(split=shares, **(p | fields)) for name, p in facts()["cases"].items()}


def updates_of(epochs: Sequence[Epoch], noise: NoiseModel) -> list[Update]:
    """Return the updates of a filter over epochs."""
    one, state, out = estimator(noise), State.empty(), []
    for epoch in epochs:
        out.append(one.correct(one.predict(state, epoch), epoch))
        state = out[-1].posterior
    return out


def errors_m(updates: Sequence[Update], place_m: FloatArray) -> FloatArray:
    """Return position errors east, north, up, shape (n, 3)."""
    return np.array([u.posterior.mean[:3] - place_m for u in updates]) @ enu_rotation(place_m).T
