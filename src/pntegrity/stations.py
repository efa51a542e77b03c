"""A station whose place is known -> products of the atmosphere."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from pntegrity.errors import InputError
from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators.ppp_rtk import PppRtk
from pntegrity.exclusion import Policy
from pntegrity.kernels.linear import cholesky, correct_covariance, gain
from pntegrity.monitors.rctm import Rctm
from pntegrity.physics.atmosphere_products import AtmosphereProducts, Samples, metres_per_tecu
from pntegrity.physics.time import SECOND_NS
from pntegrity.pipeline import Pipeline
from pntegrity.protocols import Estimator
from pntegrity.records import Epoch, FloatArray, Prior, State, Update, group_of

__all__ = ["SLANT_FLOOR_M", "ZENITH_FLOOR_M", "products_from_station"]

#: Smallest standard deviation that is stated, whatever the filter believes: slant on the first frequency, m.
SLANT_FLOOR_M = 0.02
#: The same of the wet delay at the zenith, m.
ZENITH_FLOOR_M = 0.005
#: Probability of a false alarm of the test that watches the filter, an epoch.
P_FA = 1e-6
#: Slant delays may walk this far, m/sqrt(s): a slower walk lags behind rising and setting satellites, whose
#: delays change steadily, and moves the wet delay (measured: 0.11 m with 1e-3, 0.02 m with 3e-3).
IONO_WALK_M = 0.03
#: The same of ambiguities: combined for no ionosphere as those of `ppp`. With 3e-5 the wet delay of the same
#: station ends 0.01 m lower, twice its sigma then.
AMBIGUITY_WALK_M = 1e-4
#: How well the coordinates are taken to be known, m.
COORDINATES_M = 1e-3
#: A fix further from the coordinates than this shows that these are another place's, m.
ASTRAY_M = 100.0
ION = "ion:"
Progress = Callable[[str, int, int], None]


def products_from_station(
    epochs: Sequence[Epoch],
    position_m: npt.ArrayLike,
    options: GnssOptions,
    *,
    latency_s: float = 30.0,
    interval_s: float | None = None,
    source: str = "",
    progress: Progress = lambda stage, done, total: None,
) -> AtmosphereProducts:
    """Return the atmosphere over a station whose place is known, as a filter of its own data estimates it.

    The filter is that of PPP-RTK without products, static, with the position at the coordinates; satellites
    whose innovations are too large (`Rctm`) are left out, and epochs that stay suspect give no sample. Slant
    delays are taken as they come: they hold the code biases of receiver and satellites, of which the
    part that is common to a constellation goes into the clock offsets of who uses them. **The products of a
    receiver share its noise and its multipath**: used with its own data they are better than those of a
    network. `simulate.products.disturbed` adds errors of their own.

    Parameters
    ----------
    epochs : sequence of Epoch
        Code and carrier, uncombined, on two frequencies.
    position_m : array_like, shape (3,)
        ECEF of the marker.
    options : GnssOptions
        `motion` does not matter; slant delays walk at least as `IONO_WALK_M`, ambiguities as
        `AMBIGUITY_WALK_M`.
    latency_s : float
        The sample of a time is the estimate of so long before.
    interval_s : float, optional
        Step of the samples; that of the log where not given.
    source : str
        Name of the station.
    progress : callable
        Told the stage, how much is done and how much there is.

    Returns
    -------
    AtmosphereProducts
        Standard deviations are the filter's, at least `SLANT_FLOOR_M` and `ZENITH_FLOOR_M`.

    Raises
    ------
    InputError
        No slant delay could be estimated, or the coordinates are not the station's.
    """
    place = np.array(position_m, dtype=np.float64)
    if place.shape != (3,) or not np.isfinite(place).all():
        raise ValueError(f"`position_m` must be three finite numbers, not {place.tolist()}")
    if not (np.isfinite(latency_s) and latency_s >= 0.0):
        raise ValueError(f"`latency_s` must be at least 0, not {latency_s}")
    watched = _Watched(PppRtk(_cautious(options)), place)
    pipeline = Pipeline(watched, (Rctm(P_FA),), Policy(p_fa=P_FA, **PppRtk.policy))
    found, due_ns = _Found(), 0
    for i, epoch in enumerate(epochs):
        outcome = pipeline.push(epoch)
        state = pinned(outcome.update.posterior, place)
        if len(state) and outcome.status == "alert":
            found.withheld += 1
        elif len(state) and epoch.t_ns >= due_ns:
            found.take(state, epoch, outcome.update.excluded)
            due_ns = epoch.t_ns + round((interval_s or 0.0) * SECOND_NS)
        progress("estimating the atmosphere", i + 1, len(epochs))
    return found.products(round(latency_s * SECOND_NS), latency_s, interval_s or 0.0, source)


def _cautious(options: GnssOptions) -> GnssOptions:
    """Return the options of a filter at rest that assumes little of ionosphere and ambiguities."""
    old = options.noise
    noise = replace(
        old, iono_walk_m=max(old.iono_walk_m, IONO_WALK_M), ambiguity_m=max(old.ambiguity_m, AMBIGUITY_WALK_M)
    )
    return replace(options, noise=noise, motion="static")


@dataclass(frozen=True)
class _Watched:
    """An estimator that is told at every step where it is."""

    inner: Estimator
    position_m: FloatArray

    def predict(self, state: State, epoch: Epoch) -> Prior:
        """Return the prior after the state given the position."""
        return self.inner.predict(pinned(state, self.position_m), epoch)

    def relax(self, prior: Prior) -> Prior:
        """Return what the estimator does."""
        return self.inner.relax(prior)

    def correct(self, prior: Prior, epoch: Epoch, exclude: frozenset[str] = frozenset()) -> Update:
        """Return what the estimator does."""
        return self.inner.correct(prior, epoch, exclude)


def pinned(state: State, position_m: FloatArray) -> State:
    """Return the belief of a filter that is told where it is: the state given the position.

    Raises
    ------
    InputError
        Where the two are so far apart that the coordinates must be wrong.
    """
    if not len(state):
        return state
    at = state.layout.block("pos")
    nu = position_m - state.mean[at]
    if float(np.linalg.norm(nu)) > ASTRAY_M:
        raise InputError(
            f"the code puts the station {np.linalg.norm(nu):.0f} m from the coordinates that were given",
            hint="Check --position: ECEF X,Y,Z in metres of this station",
        )
    H, R = np.eye(len(state))[at], COORDINATES_M**2 * np.eye(len(at))
    K = gain(state.P, H, cholesky(state.P[np.ix_(at, at)] + R))
    return State(state.t_ns, state.mean + K @ nu, correct_covariance(state.P, H, R, K), state.layout)


class _Found:
    """Estimates so far: of the zenith, and of each satellite; time, value and sigma."""

    def __init__(self) -> None:
        self.withheld = 0
        self.left_out: Counter[str] = Counter()
        self.zenith: list[tuple[int, float, float]] = []
        self.slant: dict[str, list[tuple[int, float, float]]] = {}

    def take(self, state: State, epoch: Epoch, excluded: Sequence[str]) -> None:
        """Take the delays of the satellites that the epoch has, but for those left out."""
        self.left_out.update(excluded)
        per_tecu = {sat: m for sat, m in _metres_per_tecu(epoch).items() if sat not in excluded}
        index, sigma = state.layout.index, np.sqrt(np.diagonal(state.P))
        for sat, metres in per_tecu.items():
            i = index.get(ION + sat)
            if i is not None:
                sample = state.t_ns, float(state.mean[i]) / metres, max(sigma[i], SLANT_FLOOR_M) / metres
                self.slant.setdefault(sat, []).append(sample)
        if per_tecu:
            i = index["zwd"]
            self.zenith.append((state.t_ns, float(state.mean[i]), max(float(sigma[i]), ZENITH_FLOOR_M)))

    def products(self, later_ns: int, latency_s: float, interval_s: float, source: str) -> AtmosphereProducts:
        """Return what was found, as it becomes known `later_ns` after its time.

        Raises
        ------
        InputError
            Where there is nothing.
        """
        if not self.slant:
            raise InputError(
                "no slant delay could be estimated",
                hint="It takes code and carrier on two frequencies, and 5 satellites at the start",
            )
        slant = {sat: _series(rows, later_ns) for sat, rows in self.slant.items()}
        told = f"estimated at {source or 'a station'} with fixed coordinates; its noise is in it"
        return AtmosphereProducts(
            slant, _series(self.zenith, later_ns), "ZWD", interval_s, told, True, latency_s, self._notes()
        )

    def _notes(self) -> tuple[str, ...]:
        out = [f"{self.withheld} epochs with an alert that nobody could resolve: no sample"]
        out = out if self.withheld else []
        some = ", ".join(f"{sat} {n}" for sat, n in sorted(self.left_out.items()))
        return (*out, f"excluded as faulty, no sample: {some} epochs") if some else tuple(out)


def _metres_per_tecu(epoch: Epoch) -> dict[str, float]:
    """Return the delay by 1 TECU on the first frequency of each satellite."""
    o = epoch.sensor("code")
    if o is None:
        return {}
    metres = metres_per_tecu(o.aux["freq_hz"]).tolist()
    rows = zip(o.keys, o.aux["iono_factor"].tolist(), metres, strict=True)
    return {group_of(key): m for key, factor, m in rows if factor == 1.0}


def _series(rows: Sequence[tuple[int, float, float]], later_ns: int) -> Samples:
    times = np.array([r[0] for r in rows], dtype=np.int64) + later_ns
    numbers = np.array([r[1:] for r in rows])
    return Samples(times, numbers[:, 0], numbers[:, 1])
