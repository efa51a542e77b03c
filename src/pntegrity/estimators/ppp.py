"""Kalman precise point positioning with float ambiguities."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from pntegrity.estimators._carrier import PreciseRows, names_of, precise_rows
from pntegrity.estimators._gnss import Fix, GnssOptions, snapshot
from pntegrity.estimators._layout import columns
from pntegrity.estimators._navigation import no_prior
from pntegrity.estimators._precise import (
    clock_name,
    jacobian,
    layout_of,
    satellite_clock_variance,
    stationary_variance,
    transition,
)
from pntegrity.kernels.sparse import sandwich
from pntegrity.physics.atmosphere import zenith_delays_m
from pntegrity.records import Epoch, FloatArray, Layout, Prior, State, Update
from pntegrity.sensors.noise import PPP, Fitted, NoiseModel

#: Ends the name of an ambiguity whose satellite was left out at the last epoch.
LEFT_OUT = "~"
#: Code residuals spread wider than this about their median: the position is not where it was, m.
ASTRAY_M = 25.0


@dataclass(frozen=True)
class Ppp:
    """Precise point positioning: code and carrier, receiver clock, wet delay, one ambiguity an arc.

    The position is white noise, a random walk, constant velocity with white acceleration, or static
    (`GnssOptions.motion`). The clock is white: its mean is taken from the epoch's code, so is that of a
    constellation seen first and that of an ambiguity born; each counts as consumed. Further constellations
    have an inter-system bias. The wet delay and its gradients walk; ambiguities walk a little, which carries
    the slow errors of orbits, clocks and multipath; satellites have a code bias each, which those of GLONASS
    keep. An arc that ends takes its ambiguity with it.

    Rows are ionosphere-free pairs where the epochs hold them. The ambiguity of a satellite that is left out
    is made of its own carrier at the epoch of its exclusion (its name then ends with ``~``), and lives on:
    its carrier shows what came after, to centimetres, and needs no other reset.

    Parameters
    ----------
    options : GnssOptions
    """

    default_noise: ClassVar[NoiseModel] = PPP
    max_gap_s: ClassVar[float] = 3600.0
    monitoring: ClassVar[dict[str, dict[str, Any]]] = {
        "srctm": {"block": "pos+amb"}, "aime": {"window": 10}, "sraime": {"block": "pos+amb", "window": 10},
    }  # fmt: skip
    policy: ClassVar[dict[str, Any]] = {"proof_s": 10.0}
    settle_s: ClassVar[float] = 3600.0
    clip_sigma: ClassVar[float] = 4.0
    fitted: ClassVar[tuple[Fitted, ...]] = (
        Fitted("carrier_m", 1e-4, 0.1, 1.5e-3, "white", rows="carrier"),
        Fitted("ambiguity_m", 1e-6, 0.01, 2e-4, "slow", rows="carrier"),
        Fitted("code_white_m", 0.02, 30.0, 0.25, "white", rows="code"),
        Fitted("code_bias_m", 0.02, 20.0, 0.3, "slow", rows="code"),
        Fitted("code_bias_tau_s", 60.0, 86400.0, 600.0, size="code_bias_m"),
        Fitted("zwd_walk_m", 1e-6, 1e-3),
        Fitted("isb_m", 1e-6, 0.1),
        Fitted("satellite_clock_m", 1e-5, 0.1, rows="carrier"),
        Fitted("glonass_factor", 1.0, 6.0),
        Fitted("glonass_carrier_factor", 1.0, 6.0),
        Fitted("bds2_factor", 1.0, 6.0),
    )
    options: GnssOptions = field(default_factory=lambda: GnssOptions(noise=PPP, max_gap_s=Ppp.max_gap_s))

    def predict(self, state: State, epoch: Epoch) -> Prior:
        """Return the prior at `epoch`; starts from a code fix where there is no state or the gap is too
        long.
        """
        dt = (epoch.t_ns - state.t_ns) * 1e-9
        if not len(state) or dt > self.options.max_gap_s or dt <= 0.0:
            events = (f"restart after a gap of {dt:.0f} s",) if len(state) else ()
            return self._start(state, epoch, (*events, "start"))
        moved = state.mean[:3] + (dt * state.mean[3:6] if self.options.motion == "velocity" else 0.0)
        rows = precise_rows(epoch, moved, self.options)
        if self.options.motion == "white" and _spread_m(rows) > ASTRAY_M:
            fix = snapshot(epoch, self.options, moved)
            if not fix.reason:
                return self._step(state, epoch, precise_rows(epoch, fix.position_m, self.options), fix)
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
            prior = self._start_at(epoch, prior.state.mean[:3], prior.F.shape[1], prior.events, exclude)
        if not len(prior.state):
            reason = prior.events[-1] if prior.events else "not started"
            return Update.of(prior, (), np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0)), reason=reason)
        rows: PreciseRows = prior.context
        used = np.array([g not in exclude for g in rows.names.groups], dtype=bool)
        few = len(set(rows.names.groups) - exclude)
        if few < 4 and self.options.motion == "white":
            none = np.zeros(len(rows), dtype=bool)
            return _update(
                prior, rows, none, self.options.noise, f"{few} satellites do not determine a position"
            )
        return _update(prior, rows, used, self.options.noise, "" if few else "no satellite above the mask")

    def _start(self, old: State, epoch: Epoch, events: tuple[str, ...]) -> Prior:
        guess = old.mean[:3] if len(old) else np.zeros(3)
        return self._start_at(epoch, guess, len(old), events)

    def _start_at(
        self, epoch: Epoch, guess_m: FloatArray, n_old: int, events: tuple[str, ...],
        exclude: frozenset[str] = frozenset(),
    ) -> Prior:  # fmt: skip
        fix = snapshot(epoch, self.options, guess_m, exclude)
        if fix.reason:
            return no_prior(epoch.t_ns, n_old, (*events, fix.reason))
        rows = precise_rows(epoch, fix.position_m, self.options)
        layout = layout_of(Layout(), rows, self.options)
        mean = np.zeros(len(layout))
        mean[layout.block("pos")] = fix.position_m
        if fix.velocity_mps is not None and len(layout.block("vel")):
            mean[layout.block("vel")] = fix.velocity_mps
        mean[layout.block("zwd")] = zenith_delays_m(fix.position_m)[1]
        F = np.zeros((len(layout), n_old))
        mean, consumed, _ = _births(mean, layout, F, rows, exclude)
        Q = np.diag(stationary_variance(layout, rows, self.options))
        return Prior(State(epoch.t_ns, mean, Q, layout), F, Q, consumed + 3, events, rows)

    def _step(self, state: State, epoch: Epoch, rows: PreciseRows, fix: Fix | None) -> Prior:
        """Return the prior after `state`; with a `fix` its position is born there."""
        dt = (epoch.t_ns - state.t_ns) * 1e-9
        rows = _as_left(rows, state.layout)
        layout = layout_of(state.layout, rows, self.options)
        F, Q = transition(state.layout, layout, dt, rows, self.options)
        mean = F @ state.mean
        events: tuple[str, ...] = ()
        consumed = 0
        if fix is not None:
            F[:3], mean[:3], consumed = 0.0, fix.position_m, 3
            events = ("position started anew from code",)
        mean, born, more = _births(mean, layout, F, rows)
        P = sandwich(F, state.P) + Q
        return Prior(State(epoch.t_ns, mean, P, layout), F, Q, consumed + born, events + more, rows)


def _as_left(rows: PreciseRows, old: Layout) -> PreciseRows:
    """Return the rows with the marks that the last epoch left on their ambiguities."""
    names = rows.names.ambiguity
    marked = tuple(a + LEFT_OUT if a and a + LEFT_OUT in old.index else a for a in names)
    return rows if marked == names else replace(rows, names=names_of(rows.keys, marked))


def _middle(values: FloatArray) -> float:
    """Return the upper median."""
    return float(np.sort(values)[len(values) // 2])


def _spread_m(rows: PreciseRows) -> float:
    """Return how far code residuals spread about the medians of their constellations."""
    code = ~rows.names.carrier
    residual, system = (rows.y - rows.predicted)[code], rows.names.system[code]
    apart = [np.abs(own - _middle(own)) for s in set(system.tolist()) if len(own := residual[system == s])]
    return 1.4826 * _middle(np.concatenate(apart)) if apart else 0.0


def _births(
    mean: FloatArray, layout: Layout, F: FloatArray, rows: PreciseRows, exclude: frozenset[str] = frozenset()
) -> tuple[FloatArray, int, tuple[str, ...]]:
    """Return the mean with what the data initialise, how much that is, and what happened.

    The clock is the median of the code, a new constellation's bias that of its own code, an ambiguity what
    its carrier is longer than predicted.
    """
    mean, names = mean.copy(), rows.names
    new = np.asarray(~F.any(axis=1))
    residual = rows.y - rows.predicted - jacobian(layout, rows)[:, 3:] @ mean[3:]
    isb = columns(layout, names.isb)
    fresh = {i for i in isb.tolist() if i >= 0 and new[i]}
    code = ~names.carrier
    if exclude:
        kept = code & np.array([g not in exclude for g in names.groups], dtype=bool)
        code = kept if kept.any() else code
    known = code & ~np.isin(isb, list(fresh)) if fresh else code
    clock = _middle(residual[known if known.any() else code]) if code.any() else 0.0
    mean[layout.index[clock_name(layout)]] += clock
    residual -= clock
    events = []
    for i in sorted(fresh):
        own = isb == i
        shift = _middle(residual[own & code] if (own & code).any() else residual[own])
        mean[i] += shift
        residual[own] -= shift
        events.append(f"first satellites of {layout.names[i][4:]}")
    arcs = columns(layout, names.ambiguity)
    born = np.flatnonzero(names.carrier & new[arcs])
    mean[arcs[born]] += residual[born]
    return mean, int(code.any()) + len(fresh) + len(born), tuple(events)


def _reborn(prior: Prior, states: np.ndarray, variance: FloatArray, *event: str) -> Prior:
    """Return the prior with some states born anew: what came before says nothing of them."""
    F, Q, P = prior.F.copy(), prior.Q.copy(), prior.state.P.copy()
    F[states] = 0.0
    for matrix in (Q, P):
        matrix[states], matrix[:, states] = 0.0, 0.0
        matrix[states, states] = variance
    state = State(prior.state.t_ns, prior.state.mean, P, prior.state.layout)
    return replace(prior, state=state, F=F, Q=Q, events=(*prior.events, *event))


def _update(prior: Prior, rows: PreciseRows, used: np.ndarray, noise: NoiseModel, reason: str) -> Update:
    """Return the update with the rows `used`; the others become its spare rows.

    Where none is used nobody is at fault: ambiguities stay what they are, and there are no spare rows.
    """
    left_out = ~used & used.any()
    variance = _white_variance(prior.state.layout, rows, noise)
    if left_out.any():
        prior = _without(prior, rows, left_out)
    prior, rows = _marked(prior, rows, left_out, variance)
    H = jacobian(prior.state.layout, rows)
    nu = rows.y - rows.predicted - H[:, 3:] @ prior.state.mean[3:]
    aux = {name: getattr(rows, name)[used] for name in ("el_rad", "az_rad", "cn0_dbhz")}
    keys = rows.keys if used.all() else tuple(k for k, u in zip(rows.keys, used, strict=True) if u)
    update = Update.of(prior, keys, nu[used], H[used], np.diag(variance[used]), aux=aux, reason=reason)
    if not left_out.any():
        return update
    left = tuple(k for k, out in zip(rows.keys, left_out, strict=True) if out)
    return update.with_spares(left, nu[left_out], H[left_out], variance[left_out])


def _without(prior: Prior, rows: PreciseRows, left_out: np.ndarray) -> Prior:
    """Return the prior whose data-initialised means do without some rows."""
    out = frozenset(g for g, o in zip(rows.names.groups, left_out, strict=True) if o)
    mean = _births(prior.state.mean, prior.state.layout, prior.F, rows, out)[0]
    return replace(prior, state=State(prior.state.t_ns, mean, prior.state.P, prior.state.layout))


def _marked(
    prior: Prior, rows: PreciseRows, left_out: np.ndarray, variance: FloatArray
) -> tuple[Prior, PreciseRows]:
    """Return prior and rows whose ambiguities bear the mark of those left out, and are born anew for that.

    Born anew an ambiguity is what its carrier is longer than predicted, with the errors of the prediction:
    what is open of position and clock is the same later, and the carrier shows what came after.
    """
    old = rows.names.ambiguity
    bare = [a.removesuffix(LEFT_OUT) for a in old]
    new = tuple(a + LEFT_OUT if a and out else a for a, out in zip(bare, left_out, strict=True))
    if new == old:
        return prior, rows
    again = [r for r, (a, b) in enumerate(zip(old, new, strict=True)) if b.endswith(LEFT_OUT) and a != b]
    renamed = dict(zip(old, new, strict=True))
    layout = Layout(tuple(renamed.get(n, n) for n in prior.state.layout.names))
    rows = replace(rows, names=names_of(rows.keys, new))
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
