"""The runs behind the campaign on hidden errors of PPP-RTK: faults, many runs, exact risks.

Gains and levels are taken from one run; errors of many runs, and their exact covariances, are carried
through them under another truth (`evaluate.linear_risk`). Faults come from the modes of the integrity support
message, each mode as often as any other, with random onset, shape and size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy import special

from pntegrity.evaluate.linear_risk import Exact, RowErrors, Runs, carry_exact, carry_runs, hidden
from pntegrity.kernels.carried_test import CarriedTest
from pntegrity.kernels.protection import false_alert_factor
from pntegrity.monitors.separation import Separation
from pntegrity.records import Bound, FloatArray, State, Update
from pntegrity.scenarios._rtk_simulated import Sky, estimator, facts, isms, model
from pntegrity.sensors.noise import NoiseModel
from pntegrity.states import rows_touched_by

__all__ = [
    "COUNTED_P_FA",
    "ONSETS",
    "SHAPES",
    "SIZES",
    "Campaign",
    "Faults",
    "Figures",
    "campaign",
    "row_errors",
]

#: Shapes of faults: what they are on, and how they grow.
SHAPES = ("step", "code step", "ramp", "product step")
ONSETS = 4
RAMP_EPOCHS = 10
#: Pairings of noise and faults at each epoch, and sizes in units of what the fault's own test allows.
PAIRINGS, SIZES = 10, (0.3, 2.5)
#: False alerts are counted at this probability: at the nominal one there are none to count.
COUNTED_P_FA = 1e-3
#: Variance of a state's step above which the data determine it anew: nothing of it is carried.
DIFFUSE_M2 = 1.0


def row_errors(
    update: Update, noise: NoiseModel, truth: dict[str, float], stated: tuple[float, float]
) -> RowErrors:
    """Return what errors of rows and states really are at an epoch.

    Parameters
    ----------
    update : Update
    noise : NoiseModel
        Sizes of white code and carrier at the zenith.
    truth : dict
        A table of ``[truth]`` in ``ppp_rtk.toml``.
    stated : tuple of float
        Standard deviations of the products of ionosphere and troposphere, m.
    """
    keys, part = update.keys, truth["correlated_part"]
    zenith = noise.scale(update.aux["el_rad"], update.aux["cn0_dbhz"])
    code = noise.code_white_m * noise.code_factor(keys) * zenith
    carrier = noise.carrier_m * noise.carrier_factor(keys) * zenith
    kind = np.array([{"iono": 2, "trop": 3}.get(k[:4], int(k[4] == "L")) for k in keys])
    sizes = np.choose(kind, [code, carrier, np.full(len(keys), stated[0]), np.full(len(keys), stated[1])])
    product = kind > 1
    return RowErrors(
        sizes * np.where(product, noise.product_white, np.sqrt(1.0 - part)),
        sizes * np.where(product, 1.0, np.sqrt(part)),
        np.where(product, truth["product_tau_s"], truth["correlated_tau_s"]),
        _drive(update),
    )


def _drive(update: Update) -> FloatArray:
    """Return the variance of the states' true steps; the filter's states of product errors have none: what
    products really do is in their rows.
    """
    q = np.diagonal(update.Q)
    own = np.array([n.startswith("prod:") for n in update.prior.layout.names])
    return np.where(own | (q >= DIFFUSE_M2), 0.0, q)


@dataclass(frozen=True, eq=False)
class Faults:
    """Unit faults, one a column: whose they are, their rows and sizes by key, onset, and how they grow."""

    mode: np.ndarray[Any, np.dtype[np.intp]]
    patterns: tuple[tuple[str, ...], ...]
    shape: tuple[str, ...]
    onset: np.ndarray[Any, np.dtype[np.intp]]
    signs: tuple[dict[str, float], ...]

    @staticmethod
    def drawn(modes: Sequence[Any], last: int, rng: np.random.Generator) -> Faults:
        """Return faults of all modes and shapes, with random onsets; products get a random part each."""
        rows = [(i, m.patterns, s) for i, m in enumerate(modes) for s in SHAPES for _ in range(ONSETS)]
        onset = rng.integers(0, max(last - RAMP_EPOCHS, 1), len(rows))
        signs = tuple(_Signs(rng) for _ in rows)
        mode = np.array([r[0] for r in rows], dtype=np.intp)
        return Faults(mode, tuple(r[1] for r in rows), tuple(r[2] for r in rows), onset, signs)

    def at(self, k: int, keys: tuple[str, ...]) -> FloatArray:
        """Return the unit faults on the rows of epoch `k`, shape (m, faults)."""
        out = np.zeros((len(keys), len(self.mode)))
        for j in np.flatnonzero(self.onset <= k).tolist():
            hit = rows_touched_by(self.patterns[j], keys) & _on(self.shape[j], self.patterns[j], keys)
            size = (k - self.onset[j] + 1) / RAMP_EPOCHS if self.shape[j] == "ramp" else 1.0
            many = self.patterns[j] == ("iono:*",)
            out[hit, j] = [size * (self.signs[j][keys[i]] if many else 1.0) for i in np.flatnonzero(hit)]
        return out


class _Signs(dict[str, float]):
    """A size for each key, drawn when it is first asked for."""

    def __init__(self, rng: np.random.Generator) -> None:
        super().__init__()
        self._rng = rng

    def __missing__(self, key: str) -> float:
        self[key] = float(self._rng.standard_normal())
        return self[key]


def _on(shape: str, patterns: tuple[str, ...], keys: tuple[str, ...]) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Return which rows a shape is on; of products alone all shapes are on all their rows."""
    if patterns[0] in ("iono:*", "trop:*"):
        return np.ones(len(keys), dtype=bool)
    product = np.array([k.startswith(("iono:", "trop:")) for k in keys])
    if shape == "product step":
        return product
    code = np.array([k[4:5] == "C" for k in keys]) & ~product
    return code if shape == "code step" else ~product


@dataclass
class Figures:
    """What was found under one truth, epoch by epoch.

    Parameters
    ----------
    ratio : list of ndarray (3,)
        True over stated standard deviation.
    beyond : list of float
        Probability of an error beyond a level without a fault, alerts not counted.
    outside : ndarray, shape (runs,)
        Whether a run ever left its levels; `now`: at the last epoch.
    misled : int
        Runs and epochs beyond a level without an alert, without a fault.
    alerts, tests, rises : int
        Epochs with an alert, epochs, and beginnings of alerts, at the nominal P_FA; `counted`, `begun` at the
        larger one.
    union : list of float
        Sum of the probabilities of all tests of an epoch.
    risk : list of float
        The weighted sum of the worst of all modes, and the case without a fault, by epoch.
    hits, trials : ndarray, shape (modes,)
        Hidden errors of drawn faults.
    """

    ratio: list[FloatArray] = field(default_factory=list)
    beyond: list[float] = field(default_factory=list)
    outside: Any = None
    now: Any = None
    misled: int = 0
    alerts: int = 0
    rises: int = 0
    tests: int = 0
    counted: int = 0
    begun: int = 0
    union: list[float] = field(default_factory=list)
    risk: list[float] = field(default_factory=list)
    hits: FloatArray = field(default_factory=lambda: np.zeros(0))
    trials: FloatArray = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True, eq=False)
class Campaign:
    """One filter: its figures by truth, its probabilities, and how long it ran."""

    label: str
    figures: dict[str, Figures]
    probability: FloatArray
    allowed: float
    bounds: list[Bound]
    step_s: float


@dataclass
class _Carried:
    """What goes on under one truth."""

    truth: dict[str, float]
    found: Figures
    exact: Exact | None = None
    runs: Runs | None = None
    was: Any = None
    was_counted: Any = None


def campaign(
    where: Sky, span: str, epochs: int, runs: int, truths: Sequence[str], look: int = 10
) -> Campaign:
    """Run one filter with the ISM of case 4 under some truths; worst sizes are looked for now and then.

    Parameters
    ----------
    where : Sky
    span : str
        Of ``ppp_rtk.toml``.
    epochs, runs : int
    truths : sequence of str
    look : int
        Every how many epochs.
    """
    kind, step_s, _ = facts()["spans"][span]
    noise, ism = model(kind), isms("even")["case4"]
    seed = facts()["seeds"]["risk"]
    rng = np.random.default_rng(seed)
    one, state = estimator(noise), State.empty()
    monitor = Separation(p_fa=ism.p_fa, ism=ism, pairs=False)
    plan, step = monitor.start(), monitor.start()
    carried = {n: _Carried(facts()["truth"][n], Figures()) for n in truths}
    faults: Faults | None = None
    unit: Runs | None = None
    bounds: list[Bound] = []
    for k, epoch in enumerate(where.epochs(noise, step_s, epochs, np.random.default_rng(seed + 1))):
        update = one.correct(one.predict(state, epoch), epoch)
        state = update.posterior
        cast, _ = monitor.carried(step, update)
        verdict, step = monitor.step(step, update)
        test, plan = monitor.plan(plan, update)
        assert verdict.bound is not None
        bounds.append(verdict.bound)
        names = [m.name for m in cast.faults.monitored]
        if faults is None:
            faults, first = Faults.drawn(cast.faults.monitored, epochs, rng), names
        alive = np.array([names.index(n) if n in names else -1 for n in first])
        none = RowErrors(*(np.zeros(len(update.keys)),) * 3, np.zeros(len(update.prior)))
        unit = carry_runs(unit, update, test, none, len(faults.mode), None, faults.at(k, update.keys))
        level = np.array([bounds[-1].east_m, bounds[-1].north_m, bounds[-1].up_m])
        at = _Epoch(k, test, level, np.array(bounds[-1].sigma_m), unit, faults, alive, cast.probability)
        for c in carried.values():
            errors = row_errors(update, noise, c.truth, _stated())
            c.exact = carry_exact(c.exact, update, test, errors)
            c.runs = carry_runs(c.runs, update, test, errors, runs, rng)
            _without_fault(at, c, ism.fa_split)
            _drawn(at, c, len(first), rng)
            if k % look == look // 2 or k == epochs - 1:
                c.found.risk.append(_worst(at, c))
    allowed = ism.p_hmi - bounds[-1].unmonitored
    return Campaign(
        span,
        {n: c.found for n, c in carried.items()},
        np.full(len(first), ism.p_sat),
        allowed,
        bounds,
        step_s,
    )


def _stated() -> tuple[float, float]:
    p = facts()["published"]
    return p["sigma_iono_product_m"], p["sigma_zwd_product_m"]


@dataclass(frozen=True, eq=False)
class _Epoch:
    """One epoch: its test, levels, stated sigma, unit faults, and the member of each mode that began."""

    k: int
    test: CarriedTest
    level_m: FloatArray
    sigma_m: FloatArray
    unit: Runs
    faults: Faults
    alive: np.ndarray[Any, np.dtype[np.intp]]
    probability: FloatArray

    @property
    def threshold_m(self) -> FloatArray:
        """What separations may be, (members, 3); inf where nothing is tested."""
        inverse = self.test.inverse
        return np.divide(1.0, inverse, out=np.full_like(inverse, np.inf), where=inverse > 0.0)


def _without_fault(at: _Epoch, c: _Carried, split: tuple[float, float, float]) -> None:
    """Add what happens without a fault."""
    assert c.exact is not None
    assert c.runs is not None
    axes, found, n = at.test.axes, c.found, at.test.axes.shape[1]
    sigma = np.sqrt(np.einsum("da,ab,db->d", axes, c.exact.own[:n, :n], axes))
    found.ratio.append(sigma / at.sigma_m)
    found.beyond.append(float(2.0 * special.ndtr(-at.level_m / sigma).sum()))
    apart = np.sqrt(np.einsum("da,iab,db->id", axes, c.exact.apart, axes))
    tail = np.divide(at.threshold_m, apart, out=np.full_like(apart, np.inf), where=apart > 0.0)
    found.union.append(float(2.0 * special.ndtr(-tail).sum()))
    out = (np.abs(axes @ c.runs.error) > at.level_m[:, None]).any(axis=0)
    ratio = np.abs(axes @ c.runs.apart) * at.test.inverse[:, :, None]
    alert = ratio.max(axis=(0, 1)) > 1.0
    modes = at.test.inverse.any(axis=1).sum()
    raised = [
        false_alert_factor(1e-6 * s, modes) / false_alert_factor(COUNTED_P_FA * s, modes) for s in split
    ]
    counted = (ratio * np.array(raised)[None, :, None]).max(axis=(0, 1)) > 1.0
    found.misled += int((out & ~alert).sum())
    found.outside = out if found.outside is None else found.outside | out
    found.now = out
    found.tests += len(alert)
    found.alerts += int(alert.sum())
    found.counted += int(counted.sum())
    if c.was is not None:
        found.rises += int((alert & ~c.was).sum())
        found.begun += int((counted & ~c.was_counted).sum())
    c.was, c.was_counted = alert, counted


def _own(at: _Epoch, which: np.ndarray[Any, np.dtype[np.intp]]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what unit faults do: to the error, to their own separation (faults, 3), and its thresholds."""
    member = 1 + at.alive[at.faults.mode[which]]
    error = (at.test.axes @ at.unit.error[:, which]).T
    apart = np.einsum("dn,jn->jd", at.test.axes, np.moveaxis(at.unit.apart[:, :, which], 2, 0)[
        np.arange(len(which)), member])  # fmt: skip
    return error, apart, at.threshold_m[member]


def _active(at: _Epoch) -> np.ndarray[Any, np.dtype[np.intp]]:
    """Return the faults that began, whose mode is there, and that move something."""
    began = (at.faults.onset <= at.k) & (at.alive[at.faults.mode] >= 0)
    moved = np.abs(at.test.axes @ at.unit.error).max(axis=0) > 1e-9
    return np.flatnonzero(began & moved)


def _limit(apart: FloatArray, threshold: FloatArray) -> FloatArray:
    """Return the size at which a fault's own separation reaches what is allowed, shape (faults,)."""
    reach = np.divide(np.abs(apart), threshold)
    return np.asarray(1.0 / np.maximum(reach.max(axis=1), 1e-6))


def _drawn(at: _Epoch, c: _Carried, modes: int, rng: np.random.Generator) -> None:
    """Add a drawn fault to each run, several times, and count errors that no test sees."""
    found, which = c.found, _active(at)
    if not len(found.hits):
        found.hits, found.trials = np.zeros(modes), np.zeros(modes)
    if not len(which) or c.runs is None:
        return
    _, apart, threshold = _own(at, which)
    limit = _limit(apart, threshold)
    e, d = at.test.axes @ c.runs.error, at.test.axes @ c.runs.apart
    eu, du = at.test.axes @ at.unit.error[:, which], at.test.axes @ at.unit.apart[:, :, which]
    low, high = (float(np.log(s)) for s in SIZES)
    for _ in range(PAIRINGS):
        j = rng.integers(0, len(which), e.shape[1])
        sign = rng.choice((-1.0, 1.0), e.shape[1])
        size = limit[j] * np.exp(rng.uniform(low, high, e.shape[1])) * sign
        out = (np.abs(e + eu[:, j] * size) > at.level_m[:, None]).any(axis=0)
        mode = at.faults.mode[which[j]]
        np.add.at(found.trials, mode, 1.0)
        if out.any():
            few = np.flatnonzero(out)
            apart = d[:, :, few] + du[:, :, np.take(j, few)] * np.take(size, few)
            quiet = (np.abs(apart) * at.test.inverse[:, :, None]).max(axis=(0, 1)) <= 1.0
            np.add.at(found.hits, mode[few], quiet)


def _worst(at: _Epoch, c: _Carried) -> float:
    """Return the risk of an epoch where every mode's fault is the worst of those drawn, of the worst size.

    Of the tests only the mode's own count: a bound from above.
    """
    which = _active(at)
    if not len(which) or c.exact is None:
        return c.found.beyond[-1]
    error, apart, threshold = _own(at, which)
    member = 1 + at.alive[at.faults.mode[which]]
    axes, n = at.test.axes, at.test.axes.shape[1]
    sigma = np.sqrt(np.einsum("da,ab,db->d", axes, c.exact.own[:n, :n], axes))
    ss = np.sqrt(np.einsum("da,iab,db->id", axes, c.exact.apart, axes))[member]
    mixed = np.einsum("da,iab,db->id", axes, c.exact.cross[:, :, :n], axes)[member]
    size = _limit(apart, threshold)[:, None, None] * np.linspace(0.3, 1.6, 27)[None, :, None]
    shape = (size * error[:, None, :]).shape
    seen = np.where(np.isfinite(threshold), threshold, 1e6)
    p = hidden(
        np.broadcast_to(at.level_m, shape), seen[:, None, :], size * error[:, None, :],
        size * apart[:, None, :], sigma, ss[:, None, :], mixed[:, None, :],
    ).sum(axis=2).max(axis=1)  # fmt: skip
    worst = np.zeros(len(at.probability))
    np.maximum.at(worst, member - 1, np.minimum(p, 1.0))
    return float(at.probability @ worst) + c.found.beyond[-1]
