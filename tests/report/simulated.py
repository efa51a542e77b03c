"""A small GNSS run whose measurements are the estimator's own model plus white noise, with known faults."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators.spp_kf import SppKf
from pntegrity.exclusion import Policy
from pntegrity.monitors.aime import Aime
from pntegrity.monitors.glr import Glr
from pntegrity.monitors.rctm import Rctm
from pntegrity.monitors.srctm import Srctm
from pntegrity.physics.frames import enu_rotation
from pntegrity.physics.time import civil_to_ns
from pntegrity.pipeline import Outcome, Pipeline
from pntegrity.records import Epoch, Observation
from pntegrity.sensors.pseudoranges import code_rows, rate_rows

TRUTH = np.array([4027881.6280, 306998.5370, 4919498.9840])
START_NS = civil_to_ns(2019, 1, 14, 6, 15)
OPTIONS = GnssOptions()
SATELLITES = tuple(f"G{i:02d}" for i in range(1, 10)) + tuple(f"E{i:02d}" for i in range(11, 17))
RISES, SETS = {"G09": 12}, {"E16": 30}
Fault = Callable[[str, int], float]


def no_fault(key: str, k: int) -> float:
    return 0.0


def faults(key: str, k: int) -> float:
    """G05 ramps with 0.2 m/s from 15 to 39, E12 jumps by 50 m from 50 to 59."""
    if key.startswith("G05") and 15 <= k < 40:
        return 0.2 * (k - 15)
    return 50.0 if key.startswith("E12") and 50 <= k < 60 else 0.0


def _observation(sensor: str, t_ns: int, satellites: Sequence[str]) -> Observation:
    where = np.random.default_rng(7)
    el = np.arcsin(where.uniform(0.25, 1.0, len(SATELLITES)))
    az = where.uniform(0.0, 2.0 * np.pi, len(SATELLITES))
    up = np.stack([np.cos(el) * np.sin(az), np.cos(el) * np.cos(az), np.sin(el)], axis=1)
    position = TRUTH + 2.2e7 * up @ enu_rotation(TRUTH)
    n = len(satellites)
    letter = "C" if sensor == "code" else "D"
    aux = {
        "sv_pos_m": position[[SATELLITES.index(s) for s in satellites]].reshape(n, 3),
        "sv_vel_mps": np.zeros((n, 3)),
        "sv_clk_m": np.zeros(n),
        "sv_clk_rate_mps": np.zeros(n),
        "freq_hz": np.full(n, 1575.42e6),
        "cn0_dbhz": np.full(n, 45.0),
        "iono_factor": np.ones(n),
    }
    return Observation(sensor, t_ns, tuple(f"{s}:{letter}1C" for s in satellites), np.zeros(n), aux=aux)


def _epoch(k: int, t_ns: int, satellites: Sequence[str], fault: Fault, rng: np.random.Generator) -> Epoch:
    empty = Epoch(t_ns, tuple(_observation(s, t_ns, satellites) for s in ("code", "doppler")))
    code, rate = code_rows(empty, TRUTH, OPTIONS), rate_rows(empty, TRUTH, np.zeros(3), OPTIONS)
    y = code.predicted + 100.0 + 0.1 * rng.standard_normal(len(code.keys))
    y = y + np.array([fault(key, k) for key in code.keys])
    rates = rate.predicted + 0.01 * rng.standard_normal(len(rate.keys))
    return Epoch(t_ns, tuple(replace(o, y=v) for o, v in zip(empty.observations, (y, rates), strict=True)))


def epochs(n: int = 100, fault: Fault = no_fault, seed: int = 1) -> list[Epoch]:
    """Return epochs of 1 s; satellites rise and set, three epochs are missing."""
    rng = np.random.default_rng(seed)
    out = []
    for k in range(n):
        there = [s for s in SATELLITES if RISES.get(s, 0) <= k < SETS.get(s, n)]
        epoch = _epoch(k, START_NS + k * 10**9, there, fault, rng)
        if k not in (70, 71, 72):
            out.append(epoch)
    return out


def run(data: Sequence[Epoch], exclude: bool = True) -> list[Outcome]:
    """Return the outcomes of four monitors on the Kalman estimator."""
    pipeline = Pipeline(SppKf(OPTIONS), monitors(), Policy(exclude=exclude, proof_s=5.0))
    return [pipeline.push(e) for e in data]


def monitors() -> list[Rctm | Srctm | Aime | Glr]:
    return [Rctm(), Srctm(), Aime(), Glr(longest=16)]
