"""Solution separation on linear filters: levels against a second computation, and every case without one."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import norm

from pntegrity.bounds.ism import Ism
from pntegrity.bounds.modes import events_of, fault_modes
from pntegrity.monitors.separation import NO_MODES, Separation, SeparationMemory
from pntegrity.records import Bound, Layout, Prior, State, Update, Verdict
from pntegrity.simulate.linear import LinearModel, draw, gains, spp_model
from pntegrity.states import rows_touched_by

ISM = Ism(p_sat=1e-4, p_hmi=1e-6, unmonitored_share=0.1)


@lru_cache(maxsize=8)
def quiet(satellites: int = 8, epochs: int = 20) -> tuple[Update, ...]:
    return gains(spp_model(satellites), epochs)


def noisy(satellites: int = 8, epochs: int = 20, seed: int = 1) -> tuple[Update, ...]:
    """Return innovations as they are without a fault, of a receiver that stands still."""
    updates = quiet(satellites, epochs)
    drawn = draw(updates, np.random.default_rng(seed).standard_normal((epochs, len(updates[0].keys))))
    return tuple(u.altered(nu=d.nu) for u, d in zip(updates, drawn, strict=True))


def stepped(
    monitor: Separation, updates: Sequence[Update], memory: SeparationMemory | None = None
) -> list[tuple[Verdict, SeparationMemory]]:
    memory, out = memory or monitor.start(), []
    for u in updates:
        verdict, memory = monitor.step(memory, u)
        out.append((verdict, memory))
    return out


def last(monitor: Separation, updates: Sequence[Update]) -> tuple[Verdict, Bound]:
    verdict = stepped(monitor, updates)[-1][0]
    assert verdict.bound is not None
    return verdict, verdict.bound


def named(update: Update, name: Any) -> Update:
    """Return the update with other names of its groups."""
    return update.altered(keys=tuple(f"{name(k[:3])}{k[3:]}" for k in update.keys))


# --- the levels, computed a second time


def plain(updates: Sequence[Update], patterns: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return position and covariance of the textbook filter without some rows, relative to the filter."""
    x, P = np.zeros(len(updates[0].prior)), updates[0].prior.P
    x0 = np.zeros_like(x)
    for k, u in enumerate(updates):
        if k:
            x, x0, P = u.F @ x, u.F @ x0, u.F @ P @ u.F.T + u.Q
        z = u.nu + u.H @ x0
        keep = ~rows_touched_by(patterns, u.keys)
        H, R = u.H[keep], u.R[np.ix_(keep, keep)]
        K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
        x, x0 = x + K @ (z[keep] - H @ x), x0 + u.K @ u.nu
        P = P - K @ H @ P
    at = updates[0].prior.layout.block("pos")
    return (x - x0)[at], P[np.ix_(at, at)]


@pytest.mark.parametrize(
    "ism", [ISM, replace(ISM, p_constellation=1e-6, p_sat=3e-4), replace(ISM, p_hmi=1e-5)]
)
def test_levels_and_statistic_are_those_of_plain_filters_and_a_root_finder(ism: Ism) -> None:
    # GIVEN two constellations, clean innovations
    updates = [named(u, lambda g: g if int(g[1:]) < 6 else "E" + g[1:]) for u in noisy(10, 12)]
    found = stepped(Separation(p_fa=1e-5, ism=ism), updates)[-1][0]
    bound = found.bound
    assert bound is not None
    # WHEN each mode's filter is run by itself
    modes = fault_modes(events_of(ism, tuple(updates[0].groups())), ism.p_hmi, ism.p_unmonitored)
    d0, P0 = plain(updates, ())
    np.testing.assert_allclose(d0, 0.0, atol=1e-9)
    each = [plain(updates, m.patterns) for m in modes.monitored]
    worst = 0.0
    for q, (level, share) in enumerate(
        zip((bound.east_m, bound.north_m, bound.up_m), ism.split, strict=True)
    ):
        s0 = np.sqrt(P0[q, q])
        k = norm.isf(1e-5 * ism.fa_split[q] / (2 * len(each)))
        T = np.array([k * np.sqrt(P[q, q] - P0[q, q]) for _, P in each])
        s = np.array([np.sqrt(P[q, q]) for _, P in each])
        p = np.array([m.probability for m in modes.monitored])
        risk = share * (ism.p_hmi - modes.unmonitored)

        def excess(L: float, s0=s0, T=T, s=s, p=p, risk=risk) -> float:
            return 2 * norm.sf(L / s0) + float(p @ norm.sf((L - T) / s)) - risk

        # THEN levels and the largest ratio are the same
        assert level == pytest.approx(brentq(excess, 0.0, 1e3, xtol=1e-12), rel=1e-6)
        assert bound.sigma_m[q] == pytest.approx(s0, rel=1e-9)
        worst = max(worst, max(abs(d[q]) / t for (d, _), t in zip(each, T, strict=True)))
    assert found.statistic == pytest.approx(worst, rel=1e-6)
    assert (bound.modes, bound.unmonitored) == (len(each), modes.unmonitored)
    assert found.dof == 3 * len(each)


def test_a_verdict_says_what_was_tested_and_since_when() -> None:
    updates = noisy()
    for k, (verdict, memory) in enumerate(stepped(Separation(p_fa=1e-6, ism=ISM), updates)):
        bound = verdict.bound
        assert bound is not None
        assert (verdict.status, verdict.threshold, verdict.p_fa) == ("ok", 1.0, 1e-6)
        assert 0.0 < verdict.statistic < 1.0
        assert bound.since_ns == int(memory.began_ns.max()) == updates[0].t_ns
        assert all(
            s < least <= level
            for s, least, level in zip(bound.sigma_m, bound.smallest_m, levels(bound), strict=True)
        )
        assert bound.hpl_m == np.hypot(bound.east_m, bound.north_m)
        assert all(name in updates[k].groups() for name in bound.dominant)
        assert bound.reason == ""


def levels(bound: Bound) -> tuple[float, float, float]:
    return bound.east_m, bound.north_m, bound.up_m


def test_levels_do_not_depend_on_the_innovations() -> None:
    one, two = (last(Separation(ism=ISM), noisy(seed=s))[1] for s in (1, 2))
    np.testing.assert_allclose(levels(one), levels(two), rtol=1e-12)


@pytest.mark.parametrize(
    ("change", "grows"),
    [({"p_hmi": 1e-7}, True), ({"p_sat": 1e-5}, False), ({"p_fa": 1e-3}, False), ({"b_code_m": 0.5}, True),
     ({"independent_epochs": 100.0}, True)],
)  # fmt: skip
def test_levels_move_the_way_the_message_says(change: dict[str, float], grows: bool) -> None:
    before = last(Separation(p_fa=1e-6, ism=ISM), noisy())[1]
    other = replace(ISM, **change)
    after = last(Separation(p_fa=other.p_fa if "p_fa" in change else 1e-6, ism=other), noisy())[1]
    for a, b in zip(levels(before), levels(after), strict=True):
        assert (b > a) is grows


# --- no level, and why


def unavailable(verdict: Verdict, words: str) -> None:
    assert verdict.status == "unavailable"
    assert verdict.reason
    assert words in verdict.reason


def test_without_any_probability_nothing_is_tested_and_the_level_is_that_of_no_fault() -> None:
    none = Ism(p_sat=0.0, p_trop=0.0, p_iono=0.0, p_other=0.0)
    verdict, bound = last(Separation(ism=none), noisy())
    unavailable(verdict, NO_MODES)
    want = [s * norm.isf(0.5 * none.p_hmi * w) for s, w in zip(bound.sigma_m, none.split, strict=True)]
    np.testing.assert_allclose(levels(bound), want, rtol=1e-9)
    assert (bound.modes, bound.dominant) == (0, ("", "", ""))


def test_no_position_no_rows_no_states() -> None:
    monitor = Separation(ism=ISM)
    u = noisy()[3]
    other = replace(u, prior=renamed(u.prior), posterior=renamed(u.posterior))
    verdict, _ = monitor.step(monitor.start(), other)
    unavailable(verdict, "no position")
    empty = Update.of(
        Prior(u.prior, u.F, u.Q), (), np.zeros(0), np.zeros((0, 8)), np.zeros((0, 0)), reason="tunnel"
    )
    unavailable(monitor.step(monitor.start(), empty)[0], "tunnel")
    nothing = Prior(State.empty(u.t_ns), np.zeros((0, 0)), np.zeros((0, 0)))
    not_begun = Update.of(nothing, (), np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0)), reason="not started")
    verdict, memory = monitor.step(stepped(monitor, noisy())[-1][1], not_begun)
    unavailable(verdict, "not started")
    assert memory.bank is None


def renamed(state: State) -> State:
    return replace(state, layout=Layout(tuple(n.replace("pos", "place") for n in state.layout.names)))


def test_an_epoch_without_rows_does_not_end_the_bank() -> None:
    updates = list(quiet(8, 12))
    u = updates[6]
    monitor = Separation(ism=ISM)
    before = stepped(monitor, updates[:6])[-1][1]
    prior = Prior(u.prior, u.F, u.Q)
    empty = Update.of(prior, (), np.zeros(0), np.zeros((0, 8)), np.zeros((0, 0)), reason="tunnel")
    verdict, memory = monitor.step(before, empty)
    unavailable(verdict, "tunnel")
    assert (int(memory.began_ns.max()), memory.groups) == (updates[0].t_ns, before.groups)
    assert memory.bank is not None
    np.testing.assert_allclose(memory.bank.P[0], u.prior.P, rtol=1e-9, atol=1e-9)


@lru_cache(maxsize=4)
def snapshot_model(satellites: int) -> LinearModel:
    """Four states that every epoch determines anew, one code a satellite."""
    m = spp_model(satellites)
    rows = [i for i, k in enumerate(m.keys) if ":C" in k]
    states = [0, 1, 2, 6]
    names = Layout(tuple(m.layout.names[i] for i in states))
    Q = 1e8 * np.eye(4)
    keys = tuple(m.keys[i] for i in rows)
    H, R = m.H[np.ix_(rows, states)], m.R[np.ix_(rows, rows)]
    return LinearModel(np.zeros((4, 4)), Q, H, R, Q, keys, names)


@pytest.mark.parametrize("satellites", [3, 4, 5, 6, 9])
def test_with_too_few_satellites_levels_are_inf_with_the_reason(satellites: int) -> None:
    # four satellites determine a position and a clock, and none of them can be tested
    model = snapshot_model(max(satellites, 5))
    keep = np.arange(len(model.keys)) < satellites
    few = replace(model, H=model.H[keep], R=model.R[np.ix_(keep, keep)], keys=model.keys[:satellites])
    verdict, bound = last(Separation(p_fa=1e-6, ism=replace(ISM, p_sat=1e-5)), gains(few, 2))
    if satellites == 3:
        assert bound.reason == "the measurements do not determine the position"
        assert set(levels(bound)) == {np.inf}
        unavailable(verdict, "")
    elif satellites == 4:
        assert "nothing is left to check against without" in bound.reason
        assert set(levels(bound)) == {np.inf}
        unavailable(verdict, "")
    else:
        assert np.isfinite(levels(bound)).all()
        assert verdict.status == "ok"
    assert not np.isnan([*levels(bound), *bound.smallest_m]).any()


def alone(updates: Sequence[Update], ism: Ism) -> tuple[Verdict, Bound]:
    return last(Separation(p_fa=1e-6, ism=ism), updates)


def test_one_constellation_that_may_fail_as_a_whole_has_no_level_and_is_named() -> None:
    ism = replace(ISM, p_constellation=1e-5)
    for updates in (noisy()[:1], gains(snapshot_model(8), 4)):
        verdict, bound = alone(updates, ism)
        assert set(levels(bound)) == {np.inf}
        assert bound.reason == "nothing is left to check against without G"
        assert bound.dominant == ("G", "G", "G")
        assert verdict.status == "ok"  # the satellites are tested all the same


def test_nor_has_a_filter_whose_position_lives_on() -> None:
    verdict, bound = alone(noisy(), replace(ISM, p_constellation=1e-5))
    assert set(levels(bound)) == {np.inf}
    assert bound.reason == "nothing is left to check against without G"
    assert bound.dominant == ("G", "G", "G")
    assert verdict.status == "ok"  # the satellites are tested all the same


def test_a_subfilter_that_sees_nothing_costs_its_probability_where_that_fits() -> None:
    # GIVEN a constellation whose fault is as improbable as a tenth of the smallest share of the risk
    updates = gains(snapshot_model(8), 4)
    one = alone(updates, ISM)[1]
    p = 0.1 * min(ISM.split) * ISM.p_hmi
    ism = replace(ISM, p_constellation=p, unmonitored_share=1e-3)
    bound = alone(updates, ism)[1]
    # THEN levels are finite and a little higher
    assert np.isfinite(levels(bound)).all()
    assert all(a < b < 1.1 * a for a, b in zip(levels(one), levels(bound), strict=True))
    # and where it is no longer there: inf
    ism = replace(ism, p_constellation=1.1 * max(ISM.split) * ISM.p_hmi)
    assert set(levels(alone(updates, ism)[1])) == {np.inf}


def test_a_budget_that_cannot_be_met_is_inf_with_the_reason() -> None:
    _, bound = last(Separation(ism=replace(ISM, p_sat=0.3, max_modes=5)), noisy())
    assert set(levels(bound)) == {np.inf}
    assert "no less than the integrity risk" in bound.reason


@pytest.mark.parametrize(
    ("field", "value"),
    [("ism", {}), ("ism", None), ("pairs", 1), ("pairs", "yes"), ("variant", "both"), ("p_fa", 1.0)],
)
def test_an_impossible_option_is_refused_by_its_name(field: str, value: object) -> None:
    with pytest.raises(ValueError, match=f"`{field}` must be"):
        Separation(**{field: value})  # type: ignore[arg-type]


# --- alerts


def faulty(size_m: float, group: str = "G03", since: int = 12, epochs: int = 16) -> list[Update]:
    """Return clean innovations with the mean of a code fault, carried through the filter exactly."""
    from pntegrity.kernels.windows import respond

    out, e = [], np.zeros((0, 1))
    for k, u in enumerate(noisy(9, epochs)):
        f = np.array([size_m * (k >= since and key == f"{group}:C1C") for key in u.keys])
        g, e = respond(e, u.F, u.H, u.K, f[:, None])
        out.append(u.altered(nu=u.nu + g[:, 0]))
    return out


def test_an_alert_names_the_satellite_and_exact_keeps_the_levels() -> None:
    updates = faulty(60.0)
    assert any(k == "G03:C1C" for k in updates[0].keys)
    exact, published = (
        stepped(Separation(p_fa=1e-6, ism=ISM, variant=v), updates) for v in ("exact", "published")
    )  # type: ignore[arg-type]
    for found in (exact, published):
        assert {v.status for v, _ in found[:12]} == {"ok"}
        assert found[12][0].status == "alert"
        assert found[12][0].suspect_groups == ("G03",)
        assert {s.kind for s in found[12][0].suspects} == {"separation"}
        assert all(v.bound is not None for v, _ in found[:12])
    assert exact[12][0].bound is not None
    assert published[12][0].bound is None
    # the right one explains the rest, the best of the others does not
    best, second = exact[12][0].suspects[:2]
    assert best.statistic <= 1.0 < second.statistic
    assert not exact[12][0].ambiguous


def test_published_and_exact_agree_until_an_alert() -> None:
    exact, published = (stepped(Separation(ism=ISM, variant=v), noisy()) for v in ("exact", "published"))  # type: ignore[arg-type]
    for (a, m), (b, n) in zip(exact, published, strict=True):
        assert replace(a, variant="published") == b
        assert len(n.members) < len(m.members)


def test_a_wider_factor_widens_levels_too() -> None:
    plain_, wide = (last(Separation(ism=ISM, factor=f), noisy()) for f in (1.0, 1.5))
    assert wide[0].statistic == pytest.approx(plain_[0].statistic, rel=1e-12)
    assert wide[0].threshold == 1.5
    assert all(b > a for a, b in zip(levels(plain_[1]), levels(wide[1]), strict=True))


def test_memory_and_verdict_survive_pickling() -> None:
    updates, monitor = noisy(), Separation(ism=replace(ISM, b_code_m=0.2))
    verdict, memory = stepped(monitor, updates[:10])[-1]
    kept = pickle.loads(pickle.dumps((monitor, verdict, memory)))
    assert kept[:2] == (monitor, verdict)
    assert [v for v, _ in stepped(kept[0], updates[10:], kept[2])] == [
        v for v, _ in stepped(monitor, updates[10:], memory)
    ]
