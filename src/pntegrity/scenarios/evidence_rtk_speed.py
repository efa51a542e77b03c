"""Campaign: CPU time, on one thread, of a bank of subfilters and of a step of the separation monitor."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
import numpy.typing as npt

from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators.ppp_rtk import PppRtk
from pntegrity.kernels.separation import Subfilters, advance, replicate
from pntegrity.monitors.separation import Separation
from pntegrity.physics.frames import geodetic_to_ecef
from pntegrity.physics.orbits import SatelliteStates, satellite_states
from pntegrity.physics.time import from_iso
from pntegrity.records import FloatArray, State, Update
from pntegrity.scenarios._real_logs import Row, row
from pntegrity.sensors.noise import PPP_RTK
from pntegrity.simulate.constellation import nominal_navigation
from pntegrity.simulate.precise import PreciseReceiver
from pntegrity.simulate.uncombined import simulate_uncombined

__all__ = ["Load", "bank_load", "cpu_ms", "plain_filter", "speed"]

NAME = "rtk-speed"
SATELLITES = 17
#: Position, clock, inter-system bias, zenith delay, two offsets of products, and one to spare.
COMMON = 9
SINGLES, WARM_PAIRS = 20, 136
PAIRS = {"G": "1C+2W", "E": "1C+7Q"}


@dataclass(frozen=True, eq=False)
class Load:
    """One epoch of a bank, ready to be taken again and again."""

    bank: Subfilters
    F: FloatArray
    Q: FloatArray
    H: FloatArray
    R: FloatArray
    nu: FloatArray
    used: npt.NDArray[np.bool_]

    def advanced(self) -> Subfilters:
        """Take the bank through the epoch."""
        return advance(self.bank, self.F, self.Q, self.H, self.R, self.nu, self.used)

    @property
    def size(self) -> str:
        """The size in words."""
        return f"{len(self.used)} members, {len(self.Q)} states, {len(self.H)} rows"


def cpu_ms(run: Callable[[], object], rounds: int) -> float:
    """Return the CPU time of the fastest of some calls, ms; one more before them is not counted."""
    run()
    best = float("inf")
    for _ in range(rounds):
        start = time.thread_time()
        run()
        best = min(best, time.thread_time() - start)
    return best * 1e3


def bank_load(members: int, own: int, rng: np.random.Generator) -> Load:
    """Return an epoch of PPP-RTK: two codes, two carriers and a product a satellite, and a zenith product.

    Parameters
    ----------
    members : int
        The filter, one without each satellite, the rest without two.
    own : int
        States of a satellite: ionosphere, two ambiguities, and from 4 on a bias of its product.
    rng : Generator
    """
    n, m = COMMON + own * SATELLITES, 5 * SATELLITES + 1
    H, r = np.zeros((m, n)), np.full(m, 0.01)
    H[-1, 5] = 1.0
    for s in range(SATELLITES):
        rows = H[5 * s : 5 * s + 5]
        rows[:, COMMON + own * s : COMMON + own * (s + 1)] = _own_columns(own)
        rows[:4, :3] = rng.standard_normal(3)
        rows[:4, 3], rows[:4, 4], rows[:4, 5] = 1.0, s % 2, 1.0 + rng.random()
        rows[4, 6 + s % 2] = 1.0
        r[5 * s : 5 * s + 5] = 0.09, 0.09, 9e-6, 9e-6, 0.04
    F, Q = np.eye(n), np.diag(np.full(n, 1e-6))
    white = [0, 1, 2, 3, 6, 7]
    F[white], Q[white, white] = 0.0, 1e4
    used = _without(members, np.repeat(np.arange(SATELLITES + 1), [5] * SATELLITES + [1]))
    load = Load(
        replicate(1e4 * np.eye(n)).take(np.zeros(members, np.intp)), F, Q, H, np.diag(r), H[:, 0], used
    )
    for _ in range(3):
        load = Load(load.advanced(), F, Q, H, np.diag(r), rng.standard_normal(m), used)
    return load


def _own_columns(own: int) -> FloatArray:
    """Return the columns of a satellite's own states in its five rows."""
    out = np.zeros((5, own))
    out[:, 0] = 1.0, 1.6, -1.0, -1.6, 1.0
    out[2, 1] = out[3, 2] = 1.0
    if own > 3:
        out[4, 3] = 1.0
    return out


def _without(members: int, satellite: npt.NDArray[np.intp]) -> npt.NDArray[np.bool_]:
    """Return which rows each member uses."""
    gone: list[tuple[int, ...]] = [
        (),
        *((s,) for s in range(SATELLITES)),
        *combinations(range(SATELLITES), 2),
    ]
    chosen = (gone * 2)[:members]
    return np.array([~np.isin(satellite, g) for g in chosen])


def plain_filter(n: int, m: int, rng: np.random.Generator) -> Callable[[], object]:
    """Return one epoch of the textbook filter in numpy, dense: ``F P F^T + Q``, gain by a solution of `S`,
    ``P - K S K^T``, mean.
    """
    F, Q, P = np.eye(n), 1e-4 * np.eye(n), np.eye(n)
    H, R, nu, x = rng.standard_normal((m, n)), np.eye(m), rng.standard_normal(m), np.zeros(n)

    def epoch() -> object:
        prior = F @ P @ F.T + Q
        S = H @ prior @ H.T + R
        K = np.linalg.solve(S, H @ prior).T
        after = prior - K @ S @ K.T
        return F @ x + K @ nu, 0.5 * (after + after.T)

    return epoch


def _random_load(members: int, n: int, m: int, rng: np.random.Generator) -> Load:
    """Return a bank of dense members: ten states a row."""
    H = np.zeros((m, n))
    for k in range(m):
        H[k, rng.choice(n, 10, replace=False)] = rng.standard_normal(10)
    used = np.ones((members, m), dtype=bool)
    for i in range(1, members):
        used[i, (i - 1) % m] = False
    bank = replicate(np.eye(n)).take(np.zeros(members, np.intp))
    return Load(bank, np.eye(n), 1e-4 * np.eye(n), H, np.eye(m), rng.standard_normal(m), used)


def speed(data: Path) -> list[Row]:
    """Return the cost of the bank against what it must be, and of whole steps of the monitor."""
    rng, rows = np.random.default_rng(4), []
    for own in (3, 4):
        for members, must, rounds in ((SINGLES, 1.0, 60), (SINGLES + WARM_PAIRS, 8.0, 15)):
            load = bank_load(members, own, rng)
            t = cpu_ms(load.advanced, rounds)
            note = f"{t / members * 1e3:.0f} us a member"
            rows.append(
                row(NAME, f"bank, {load.size}: ms", f"at most {must:g}", round(t, 2), t <= must, note=note)
            )
    bank = cpu_ms(_random_load(41, 80, 40, rng).advanced, 40)
    plain = cpu_ms(plain_filter(80, 40, rng), 100)
    note = f"{bank:.2f} ms against {plain:.3f} ms: F P F^T + Q, gain, P - K S K^T and mean, dense, one thread"
    rows.append(
        row(NAME, "bank of 41 x 80 states x 40 rows, times one numpy filter", "at most 12",
            round(bank / plain, 1), bank <= 12.0 * plain, note=note)
    )  # fmt: skip
    return rows + _steps()


def _steps() -> list[Row]:
    """Return the cost of a whole step of the monitor on a simulated log, without and with pairs."""
    updates, rows = _updates(), []
    for pairs in (False, True):
        monitor = Separation(pairs=pairs)
        memory = monitor.start()
        for u in updates[:-1]:
            _, memory = monitor.step(memory, u)
        before, last = memory, updates[-1]

        def step(monitor: Separation = monitor, before: object = before, last: Update = last) -> object:
            return monitor.step(before, last)  # type: ignore[arg-type]

        t = cpu_ms(step, 20)
        bank = memory.bank
        members = 0 if bank is None else len(bank.P)
        size = f"{members} members, {len(last.posterior)} states, {len(last.keys)} rows"
        what = "with pairs" if pairs else "without pairs"
        rows.append(row(NAME, f"separation {what}, whole step: ms", "stated", round(t, 2), note=size))
    return rows


def _updates(epochs: int = 6) -> list[Update]:
    """Return updates of `ppp_rtk` on a simulated log of GPS and Galileo."""
    start = from_iso("2024-06-01T09:30:00")
    t_ns = start + 30 * 10**9 * np.arange(epochs, dtype=np.int64)
    nav = nominal_navigation(start, int(t_ns[-1]) + 10**9, "GE")
    place = geodetic_to_ecef(np.deg2rad(50.85), np.deg2rad(4.35), 60.0)

    def states(sats: npt.NDArray[np.str_], t: npt.NDArray[np.int64], ranges: FloatArray) -> SatelliteStates:
        return satellite_states(nav, sats, t, ranges, [PAIRS[s[0]] for s in sats.tolist()])

    names = sorted({r.satellite for r in nav.kepler})
    receiver = PreciseReceiver(noise=PPP_RTK)
    made = simulate_uncombined(
        states, names, t_ns, np.tile(place, (epochs, 1)), receiver, np.random.default_rng(1)
    )
    estimator = PppRtk(GnssOptions(noise=PPP_RTK, max_gap_s=PppRtk.max_gap_s))
    state, out = State.empty(), []
    for epoch in made.epochs:
        out.append(estimator.correct(estimator.predict(state, epoch), epoch))
        state = out[-1].posterior
    return out
