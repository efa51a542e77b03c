"""The filter behind the precise estimators: predict, relax and correct on rows of code, carrier, products."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from pntegrity.estimators._carrier import PRODUCTS, Names, PreciseRows
from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators._layout import columns
from pntegrity.estimators._navigation import no_prior, not_started
from pntegrity.estimators._precise import (
    jacobian,
    layout_of,
    satellite_clock_variance,
    stationary_variance,
    transition,
)
from pntegrity.estimators._precise_births import births, middle
from pntegrity.kernels.sparse import sandwich
from pntegrity.physics.atmosphere import zenith_delays_m
from pntegrity.records import Epoch, FloatArray, Layout, Prior, State, Update
from pntegrity.sensors.noise import NoiseModel
from pntegrity.sensors.snapshot import Fix, snapshot
from pntegrity.states import ANEW

__all__ = ["PreciseFilter"]

Mask = npt.NDArray[np.bool_]
RowsAt = Callable[[Epoch, FloatArray, GnssOptions], PreciseRows]
#: Ends the name of an ambiguity whose satellite was left out at the last epoch.
LEFT_OUT = "~"
#: Code residuals spread wider than this about their median: the position is not where it was, m.
ASTRAY_M = 25.0


def _as_it_is(epoch: Epoch) -> Epoch:
    return epoch


@dataclass(frozen=True)
class PreciseFilter:
    """The steps that precise estimators share; see `ppp.Ppp` for what they do.

    Parameters
    ----------
    options : GnssOptions
    rows_at : callable
        Makes the rows of an epoch at a position.
    for_fix : callable
        Gives the epoch from whose code a position can be made.
    """

    options: GnssOptions
    rows_at: RowsAt
    for_fix: Callable[[Epoch], Epoch] = _as_it_is

    def predict(self, state: State, epoch: Epoch) -> Prior:
        """Return the prior at `epoch`."""
        dt = (epoch.t_ns - state.t_ns) * 1e-9
        if not len(state) or dt > self.options.max_gap_s or dt <= 0.0:
            events = (f"restart after a gap of {dt:.0f} s",) if len(state) else ()
            guess = state.mean[:3] if len(state) else np.zeros(3)
            return self._start(epoch, guess, len(state), (*events, "start"))
        moved = state.mean[:3] + (dt * state.mean[3:6] if self.options.motion == "velocity" else 0.0)
        rows = self.rows_at(epoch, moved, self.options)
        if self.options.motion == "white" and _spread_m(rows, state) > ASTRAY_M:
            fix = snapshot(self.for_fix(epoch), self.options, moved)
            if not fix.reason:
                return self._step(state, epoch, self.rows_at(epoch, fix.position_m, self.options), fix)
        return self._step(state, epoch, rows, None)

    def relax(self, prior: Prior) -> Prior:
        """Return the prior with position, velocity and clock born anew; all else stays known."""
        if not len(prior.state):
            return prior
        layout = prior.state.layout
        free = np.concatenate([layout.block(b) for b in ("pos", "vel", "clk")])
        variance = stationary_variance(layout, prior.context, self.options)[free]
        event = "motion or clock beyond the model: started anew"
        return replace(_reborn(prior, free, variance, event), consumed=prior.consumed + len(free) - 1)

    def correct(self, prior: Prior, epoch: Epoch, exclude: frozenset[str] = frozenset()) -> Update:
        """Use the epoch's rows but for those of the groups in `exclude`."""
        if exclude and len(prior.state) and not prior.F.any():  # the fix behind a start must be without them
            prior = self._start(epoch, prior.state.mean[:3], prior.F.shape[1], prior.events, exclude)
        if not len(prior.state):
            return not_started(prior)
        rows: PreciseRows = prior.context
        few = len(set(rows.names.groups) - exclude - set(PRODUCTS))
        reason = "" if few else "no satellite above the mask"
        if few < 4 and self.options.motion == "white":
            reason = f"{few} satellites do not determine a position"
        used = np.zeros(len(rows), dtype=bool) if reason else ~rows.names.left_out(exclude)
        return _update(prior, rows, used, exclude, self.options.noise, reason)

    def _start(
        self, epoch: Epoch, guess_m: FloatArray, n_old: int, events: tuple[str, ...],
        exclude: frozenset[str] = frozenset(),
    ) -> Prior:  # fmt: skip
        fix = snapshot(self.for_fix(epoch), self.options, guess_m, exclude)
        if fix.reason:
            return no_prior(epoch.t_ns, n_old, (*events, fix.reason))
        rows = self.rows_at(epoch, fix.position_m, self.options)
        layout = layout_of(Layout(), rows, self.options)
        mean = np.zeros(len(layout))
        mean[layout.block("pos")] = fix.position_m
        if fix.velocity_mps is not None and len(layout.block("vel")):
            mean[layout.block("vel")] = fix.velocity_mps
        mean[layout.block("zwd")] = zenith_delays_m(fix.position_m)[1]
        F = np.zeros((len(layout), n_old))
        mean, consumed, _ = births(mean, layout, F, rows, exclude)
        Q = np.diag(stationary_variance(layout, rows, self.options))
        return Prior(State(epoch.t_ns, mean, Q, layout), F, Q, consumed + 3, events, rows)

    def _step(self, state: State, epoch: Epoch, rows: PreciseRows, fix: Fix | None) -> Prior:
        """Return the prior after `state`; with a `fix` its position is born there."""
        dt = (epoch.t_ns - state.t_ns) * 1e-9
        rows = _inflated(_as_left(rows, state.layout), state.layout, dt, self.options.noise)
        layout = layout_of(state.layout, rows, self.options)
        F, Q = transition(state.layout, layout, dt, rows, self.options)
        mean = F @ state.mean
        events: tuple[str, ...] = ()
        consumed = 0
        if fix is not None:
            F[:3], mean[:3], consumed = 0.0, fix.position_m, 3
            events = ("position started anew from code",)
        mean, born, more = births(mean, layout, F, rows)
        P = sandwich(F, state.P) + Q
        return Prior(State(epoch.t_ns, mean, P, layout), F, Q, consumed + born, events + more, rows)


def _as_left(rows: PreciseRows, old: Layout) -> PreciseRows:
    """Return the rows with the marks that the last epoch left on their ambiguities."""
    names = rows.names.ambiguity
    marked = tuple(a + LEFT_OUT if a and a + LEFT_OUT in old.index else a for a in names)
    return rows if marked == names else replace(rows, names=rows.names.marked(marked))


def _inflated(rows: PreciseRows, old: Layout, dt: float, noise: NoiseModel) -> PreciseRows:
    """Return the rows with the larger noise of errors that are correlated with those of epochs before.

    A carrier is seen first where its ambiguity is new, a code where its satellite has none that is older;
    code without carriers counts as seen before.
    """
    if not noise.correlated_part:
        return rows
    grown = _seen_before(rows.names, old)
    return replace(rows, inflation=np.where(grown, noise.inflation(dt), 1.0))


@lru_cache(maxsize=64)
def _seen_before(names: Names, old: Layout) -> Mask:
    """Return which rows of code and carrier have predecessors."""
    known = {n.split(":")[1] for n in old.names if n.startswith("amb:")}
    phased = {g for g, c in zip(names.groups, names.carrier, strict=True) if c}
    seen = np.array([g in known or g not in phased for g in names.groups], dtype=bool)
    return np.asarray((names.code & seen) | (names.carrier & (columns(old, names.ambiguity) >= 0)))


def _spread_m(rows: PreciseRows, state: State) -> float:
    """Return how far code residuals spread about the medians of their constellations, where the slant delay
    is known or not needed.
    """
    code, residual = rows.names.code, rows.y - rows.predicted
    slanted = rows.names.slanted
    if len(slanted):
        at = columns(state.layout, rows.names.ionosphere)[slanted]
        residual[slanted] -= np.where(at >= 0, rows.iono[slanted] * state.mean[at], np.nan)
        code = code & np.isfinite(residual)
    residual, system = residual[code], rows.names.system[code]
    apart = [np.abs(own - middle(own)) for s in set(system.tolist()) if len(own := residual[system == s])]
    return 1.4826 * middle(np.concatenate(apart)) if apart else 0.0


def _reborn(prior: Prior, states: np.ndarray, variance: FloatArray, *event: str) -> Prior:
    """Return the prior with some states born anew: what came before says nothing of them."""
    F, Q, P = prior.F.copy(), prior.Q.copy(), prior.state.P.copy()
    F[states] = 0.0
    for matrix in (Q, P):
        matrix[states], matrix[:, states] = 0.0, 0.0
        matrix[states, states] = variance
    state = State(prior.state.t_ns, prior.state.mean, P, prior.state.layout)
    return replace(prior, state=state, F=F, Q=Q, events=(*prior.events, *event))


def _update(
    prior: Prior, rows: PreciseRows, used: Mask, exclude: frozenset[str], noise: NoiseModel, reason: str
) -> Update:
    """Return the update with the rows `used`; the others become its spare rows.

    Where none is used nobody is at fault: ambiguities stay what they are, and there are no spare rows.
    """
    left_out = ~used & used.any()
    once = _white_variance(prior.state.layout, rows, noise)
    variance = once + (rows.inflation - 1.0) * rows.sigma_m**2
    if left_out.any():
        prior = _without(prior, rows, exclude)
    prior, rows = _marked(prior, rows, left_out, once, exclude)
    H = jacobian(prior.state.layout, rows)
    nu = rows.y - rows.predicted - H[:, 3:] @ prior.state.mean[3:]
    aux = {name: getattr(rows, name)[used] for name in ("el_rad", "az_rad", "cn0_dbhz")}
    keys = rows.keys if used.all() else tuple(k for k, u in zip(rows.keys, used, strict=True) if u)
    update = Update.of(prior, keys, nu[used], H[used], np.diag(variance[used]), aux=aux, reason=reason)
    if not left_out.any():
        return update
    spare = rows.select(left_out)
    update = update.with_spares(spare.keys, *_levelled(spare, used, rows, nu, H, once))
    groups = dict.fromkeys(g for g in spare.names.groups if g in exclude)
    return update.altered(excluded=tuple(groups))


def _levelled(
    spare: PreciseRows, used: Mask, rows: PreciseRows, nu: FloatArray, H: FloatArray, variance: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return innovations, Jacobian and covariance of the rows left out, ready for their residuals.

    A residual is of one epoch: its variance is not inflated. Where all ionosphere products of a constellation
    are left out nothing tells what they share: their mean is taken off.
    """
    out = ~used
    nu, H, R = nu[out], H[out], np.diag(variance[out])
    told = {o for o, u in zip(rows.names.offset, used, strict=True) if u}
    for offset in set(spare.names.offset) - told - {""}:
        own = np.array([o == offset for o in spare.names.offset], dtype=bool)
        n = int(own.sum())
        if n > 1:
            level = np.eye(n) - 1.0 / n
            nu[own], H[own] = level @ nu[own], level @ H[own]
            R[np.ix_(own, own)] = level @ R[np.ix_(own, own)] @ level
    return nu, H, R


def _without(prior: Prior, rows: PreciseRows, exclude: frozenset[str]) -> Prior:
    """Return the prior whose data-initialised means do without some rows."""
    layout, F = prior.state.layout, prior.F
    mean, _, _ = births(prior.state.mean, layout, F, rows, exclude)
    out = rows.names.left_out(exclude)
    unseen = {o for o in rows.names.offset if o}
    unseen -= {o for o, gone in zip(rows.names.offset, out, strict=True) if not gone}
    state = State(prior.state.t_ns, mean, prior.state.P, layout)
    return replace(prior, state=state, consumed=prior.consumed - len(unseen))


def _marked(
    prior: Prior, rows: PreciseRows, left_out: Mask, variance: FloatArray, exclude: frozenset[str]
) -> tuple[Prior, PreciseRows]:
    """Return prior and rows whose ambiguities bear the mark of those left out, and are born anew for that.

    Born anew an ambiguity is what its carrier is longer than predicted, with the errors of the prediction:
    what is open of position, clock and slant delay is the same later, and the carrier shows what came after.
    So are those of groups that `exclude` names with `ANEW`.
    """
    old = rows.names.ambiguity
    bare = [a.removesuffix(LEFT_OUT) for a in old]
    new = tuple(a + LEFT_OUT if a and out else a for a, out in zip(bare, left_out, strict=True))
    anew = [g + ANEW in exclude for g in rows.names.groups]
    if new == old and not any(anew):
        return prior, rows
    pairs = enumerate(zip(old, new, anew, strict=True))
    again = [r for r, (a, b, asked) in pairs if b.endswith(LEFT_OUT) and (a != b or asked)]
    renamed = dict(zip(old, new, strict=True))
    layout = Layout(tuple(renamed.get(n, n) for n in prior.state.layout.names))
    rows = replace(rows, names=rows.names.marked(new))
    state = State(prior.state.t_ns, prior.state.mean, prior.state.P, layout)
    prior = replace(prior, state=state, context=rows)
    return (_from_carriers(prior, rows, again, variance) if again else prior), rows


def _from_carriers(prior: Prior, rows: PreciseRows, again: list[int], variance: FloatArray) -> Prior:
    """Return the prior whose ambiguities of some rows are made of these rows alone."""
    state = prior.state
    H = jacobian(state.layout, rows)[again]
    at = columns(state.layout, rows.names.ambiguity)[again]
    nu = (rows.y - rows.predicted)[again] - H[:, 3:] @ state.mean[3:]
    turn = np.eye(len(state))
    turn[at] = -H
    turn[np.ix_(at, at)] = 0.0
    mean = state.mean.copy()
    mean[at] += nu
    P, Q = sandwich(turn, state.P), sandwich(turn, prior.Q)
    for matrix in (P, Q):
        matrix[at, at] += variance[again]
    return replace(prior, state=State(state.t_ns, mean, P, state.layout), F=turn @ prior.F, Q=Q)


def _white_variance(layout: Layout, rows: PreciseRows, noise: NoiseModel) -> FloatArray:
    """Return the variance of the rows' white noise; that of satellite clocks where these have no states."""
    if len(layout.block("svclk")):
        return np.asarray(rows.sigma_m**2)
    return np.asarray(rows.sigma_m**2 + satellite_clock_variance(rows, noise))
