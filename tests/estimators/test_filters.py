"""The GNSS estimators: Jacobians, noiseless runs, consistency, births and deaths, clocks and gaps."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.stats import chi2

from gnss_logs import (
    NOISE,
    PLACE,
    START,
    fingerprint,
    groups,
    log,
    navigation,
    only,
    options,
    run,
    shifted,
    simulated,
    without,
)
from pntegrity.estimators.spp import Spp
from pntegrity.estimators.spp_kf import SppKf
from pntegrity.monitors.rctm import Rctm
from pntegrity.monitors.srctm import Srctm
from pntegrity.records import Epoch, State, Update
from pntegrity.sensors.pseudoranges import code_rows, rate_rows
from pntegrity.sensors.ranges import C_MPS
from pntegrity.simulate.receiver import Receiver, epochs_of, simulate
from pntegrity.simulate.trajectory import car

SECOND = 10**9
MS = C_MPS * 1e-3
ESTIMATORS = pytest.mark.parametrize("make", [Spp, SppKf])


def kalman(systems: str = "GE", **changes) -> SppKf:
    return SppKf(options(navigation(systems), **changes))


def updates(estimator, epochs) -> list[Update]:
    state, out = State.empty(), []
    for epoch in epochs:
        out.append(estimator.correct(estimator.predict(state, epoch), epoch))
        state = out[-1].posterior
    return out


def errors(found: list[Update], truth=PLACE) -> np.ndarray:
    return np.linalg.norm([u.posterior.mean[:3] for u in found] - truth, axis=1)


# --- what a row means
# ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("systems", ["GE", "GREC"])
def test_the_jacobian_is_the_slope_of_the_prediction(systems):
    # GIVEN an update of the filter, WHEN each state is moved a little
    epoch = log(3, systems=systems)[0]
    estimator = kalman(systems)
    update = estimator.correct(estimator.predict(State.empty(), epoch), epoch)
    x, names = update.prior.mean, update.prior.layout.names

    def predicted(mean: np.ndarray) -> np.ndarray:
        """Written on its own: clocks and satellite errors by their names."""
        of = dict(zip(names, mean, strict=True))
        code = code_rows(epoch, mean[:3], estimator.options)
        rate = rate_rows(epoch, mean[:3], mean[3:6], estimator.options)
        clock = [mean[6] + of.get(f"isb:{k[0]}", 0.0) + of[f"bias:{k}"] + of[f"mp:{k}"] for k in code.keys]
        return np.concatenate([code.predicted + clock, rate.predicted + mean[7]])

    for i, name in enumerate(names):
        h = 10.0 if name.startswith("pos") else 1.0
        step = np.zeros(len(x))
        step[i] = h
        slope = (predicted(x + step) - predicted(x - step)) / (2.0 * h)
        # THEN the rows move by H, to what the troposphere changes over the way (1e-4) and a rate over
        # position (1e-3 /s)
        np.testing.assert_allclose(update.H[:, i], slope, atol=1.5e-3, err_msg=name)
    y = np.concatenate([epoch.sensor("code").y, epoch.sensor("doppler").y])
    order = [(*epoch.sensor("code").keys, *epoch.sensor("doppler").keys).index(k) for k in update.keys]
    np.testing.assert_allclose(update.nu, y[order] - predicted(x), atol=1e-6)


# --- truth in, truth out
# -------------------------------------------------------------------------------------


@pytest.mark.parametrize("systems", ["G", "GE", "GREC"])
@ESTIMATORS
def test_without_noise_it_stays_on_truth(make, systems):
    found = updates(make(options(navigation(systems))), log(20, systems=systems, scale=0.0))
    assert errors(found).max() < 0.01
    truth = simulated(20, systems, 1, 0.0)
    for u, drift in zip(found, truth.drift_mps, strict=True):
        assert np.linalg.norm(u.posterior.mean[3:6]) < 0.02  # the rate of the troposphere is not in the model
        assert u.posterior.mean[7] == pytest.approx(drift, abs=0.01)


@lru_cache(maxsize=1)
def drives() -> tuple[tuple[np.ndarray, list[Update]], ...]:
    """Return matched runs: position errors and updates of a receiver whose errors are those of the filter's
    model.
    """
    nav = navigation("GE")
    out = []
    for seed in range(12):
        t_ns = START + SECOND * np.arange(40, dtype=np.int64)
        log_ = simulate(nav, car(PLACE), t_ns, Receiver(NOISE), np.random.default_rng(100 + seed))
        found = updates(kalman(), epochs_of(log_.table, nav))
        out.append((np.array([u.posterior.mean[:3] for u in found]) - log_.position_m, found))
    return tuple(out)


def test_the_normalised_error_is_chi_square():
    # NEES of the position, one well separated epoch a run: 12 independent draws of chi-square 3
    nees = [e[-1] @ np.linalg.solve(u[-1].posterior.P[:3, :3], e[-1]) for e, u in drives()]
    low, high = chi2.ppf([5e-4, 1.0 - 5e-4], 3 * len(nees))
    assert low < sum(nees) < high


def test_the_innovations_are_as_large_as_their_covariance():
    white = [u.white for _, found in drives() for u in found[5:]]
    total, dof = sum(float(w @ w) for w in white), sum(len(w) for w in white)
    # the car's motion is not random: the innovations may be smaller than the model, not larger
    assert 0.75 < total / dof < 1.05


# --- births and deaths
# ---------------------------------------------------------------------------------------


def lively(n: int = 60) -> list[Epoch]:
    """GLONASS rises at 10 s, Galileo sets at 25 s and is back at 40 s, single satellites come and go all the
    time.
    """
    rng = np.random.default_rng(2)
    out = []
    for k, e in enumerate(log(n, systems="GRE")):
        gone = {g for g in groups(e) if rng.uniform() < 0.1}
        gone |= {g for g in groups(e) if (g[0] == "R" and k < 10) or (g[0] == "E" and 25 <= k < 40)}
        out.append(without(e, gone))
    return out


@ESTIMATORS
def test_satellites_and_constellations_come_and_go_and_the_covariance_stays_one(make):
    epochs = lively()
    found = updates(make(options(navigation("GRE"))), epochs)
    old = 0
    for u in found:
        n = len(u.prior)
        assert u.F.shape == (n, old)
        assert u.Q.shape == (n, n)
        for P in (u.prior.P, u.posterior.P):
            assert np.array_equal(P, P.T)
            scale = np.sqrt(np.diagonal(P))
            assert np.linalg.eigvalsh(P / np.outer(scale, scale)).min() > 0.0
        old = len(u.posterior)
    assert errors(found[5:]).max() < 3.0


def test_states_are_named_after_their_satellites_and_die_with_them():
    epochs = lively()
    for u, e in zip(updates(kalman("GRE"), epochs), epochs, strict=True):
        seen = {k for k in u.keys if ":C" in k}
        assert {n[5:] for n in u.prior.layout.names if n.startswith("bias:")} == seen
        assert {n[3:] for n in u.prior.layout.names if n.startswith("mp:")} == seen
        assert {k[:3] for k in seen} <= set(groups(e))


def test_a_newborn_state_has_its_whole_variance_and_no_history():
    epochs = [without(e, ["G07"]) if k < 20 else e for k, e in enumerate(log(25))]
    u = updates(kalman(), epochs)[20]
    i = u.prior.layout.index["bias:G07:C1C"]
    assert not u.F[i].any()
    assert u.prior.P[i, i] == u.Q[i, i] > 0.0
    assert np.count_nonzero(u.prior.P[i]) == 1


def test_a_constellation_that_returns_finds_its_clock():
    found = updates(kalman("GRE"), lively())
    assert "first satellites of R" in found[10].events
    assert not any("first satellites of E" in event for event in found[40].events)
    assert found[10].consumed == 1
    assert found[40].consumed == 0


# --- clocks and gaps
# -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("jump_m", [MS, -2.0 * MS], ids=["+1 ms", "-2 ms"])
def test_a_jump_of_whole_milliseconds_is_removed_and_told(jump_m):
    plain = log(40)
    jumped = [shifted(e, jump_m) if k >= 20 else e for k, e in enumerate(plain)]
    for_plain, found = updates(kalman(), plain), updates(kalman(), jumped)
    assert f"receiver clock jump of {round(jump_m / MS)} ms removed" in found[20].events
    assert found[20].consumed == 0
    for a, b in zip(for_plain, found, strict=True):
        np.testing.assert_allclose(b.posterior.mean[:3], a.posterior.mean[:3], atol=1e-5)
        np.testing.assert_allclose(b.nu, a.nu, atol=1e-5)


@pytest.mark.parametrize("jump_m", [0.4 * MS, -0.4 * MS, 400.0])
def test_another_jump_starts_the_clock_anew_and_the_position_stays(jump_m):
    epochs = [shifted(e, jump_m) if k >= 20 else e for k, e in enumerate(log(40))]
    found = updates(kalman(), epochs)
    assert any("clock started anew" in event for event in found[20].events)
    assert found[20].consumed == 1
    i = found[20].prior.layout.index["clk:E"]
    assert not found[20].F[i].any()
    moved = np.diff([u.posterior.mean[:3] for u in found], axis=0)
    assert np.linalg.norm(moved, axis=1)[18:22].max() < 0.3
    assert errors(found[5:]).max() < 1.5


@pytest.mark.parametrize(("jump_m", "said"), [(MS, "1 ms removed"), (0.4 * MS, "anew")])
def test_a_clock_jump_is_no_alarm(jump_m, said):
    epochs = [shifted(e, jump_m) if k >= 20 else e for k, e in enumerate(log(40))]
    outcomes = run(kalman(), [Rctm(), Srctm()], epochs)
    assert {o.status for o in outcomes} == {"ok"}
    assert not any(o.exclusions for o in outcomes)
    assert said in " ".join(outcomes[20].update.events)


def test_one_satellite_alone_does_not_move_the_clock():
    epochs = log(30, "G07 bias 2000 m 20:25")
    found = updates(kalman(), epochs[:21])
    assert not found[20].events


def test_a_long_gap_starts_anew_and_a_short_one_does_not():
    epochs = log(60)
    short = updates(kalman(max_gap_s=21.0), [*epochs[:20], *epochs[40:]])
    assert short[20].F.any()
    assert not short[20].events
    long = updates(kalman(max_gap_s=20.0), [*epochs[:20], *epochs[40:]])
    assert not long[20].F.any()
    assert long[20].events[0] == "restart after a gap of 21 s"
    assert "start" in long[20].events
    assert errors(long).max() < 3.0


def test_time_that_goes_back_starts_anew():
    epochs = log(10)
    state = updates(kalman(), epochs)[-1].posterior
    assert "restart after a gap of -4 s" in kalman().predict(state, epochs[5]).events


# --- too little
# ----------------------------------------------------------------------------------------------

FEW = ("G05", "G24", "E16")


@ESTIMATORS
def test_three_satellites_are_no_start_and_it_is_said(make):
    outcomes = run(make(options(navigation())), [Rctm()], [only(e, FEW) for e in log(5)])
    assert {o.status for o in outcomes} == {"unavailable"}
    assert all("a fix needs 5 satellites of this mix, there are 3" in o.reason for o in outcomes)
    assert all(v.reason for o in outcomes for v in o.verdicts)


def test_three_satellites_on_the_way_are_coasted_through():
    epochs = [only(e, FEW) if 20 <= k < 30 else e for k, e in enumerate(log(50))]
    outcomes = run(kalman(), [Rctm()], epochs)
    assert {o.status for o in outcomes} == {"ok"}
    assert all(o.update.F.any() for o in outcomes[1:])
    sigma = [np.sqrt(np.trace(o.update.posterior.P[:3, :3])) for o in outcomes]
    assert sigma[29] > sigma[19]
    assert sigma[45] < 1.5 * sigma[19]
    assert errors([o.update for o in outcomes[5:]]).max() < 5.0


@pytest.mark.parametrize("seen", [[], ["G05"]], ids=["nothing", "one satellite"])
def test_a_tunnel_is_bridged(seen):
    epochs = [only(e, seen) if 20 <= k < 30 else e for k, e in enumerate(log(50))]
    outcomes = run(kalman(), [Rctm()], epochs)
    assert {o.status for o in outcomes[:20] + outcomes[30:]} == {"ok"}
    if not seen:
        assert {o.status for o in outcomes[20:30]} == {"unavailable"}
        assert all("no satellite" in o.reason for o in outcomes[20:30])
    assert all(o.update.F.any() for o in outcomes[1:])
    assert errors([o.update for o in outcomes[30:]]).max() < 3.0


@ESTIMATORS
def test_an_epoch_without_any_observation(make):
    epochs = log(10)
    epochs[5] = Epoch(epochs[5].t_ns)
    outcomes = run(make(options(navigation())), [Rctm()], epochs)
    assert [o.status for o in outcomes] == ["ok"] * 5 + ["unavailable"] + ["ok"] * 4
    assert outcomes[5].reason


@ESTIMATORS
def test_without_range_rates_there_is_a_solution_too(make):
    estimator = make(options(navigation(), doppler=False))
    found = updates(estimator, log(30))
    assert not any(":D" in k for u in found for k in u.keys)
    assert errors(found[5:]).max() < 4.0
    bare = [replace(e, observations=tuple(o for o in e.observations if o.sensor == "code")) for e in log(30)]
    assert fingerprint(updates(estimator, bare)[-1]) == fingerprint(found[-1])


@ESTIMATORS
def test_no_row_below_the_mask_is_used(make):
    mask = np.deg2rad(25.0)
    found = updates(make(options(navigation(), mask_rad=mask)), log(5))
    wide = updates(make(options(navigation())), log(5))
    assert all(u.aux["el_rad"].min() >= mask for u in found)
    assert len(found[3].keys) < len(wide[3].keys)


@ESTIMATORS
def test_nothing_above_the_mask_is_a_reason_and_no_crash(make):
    outcomes = run(make(options(navigation(), mask_rad=np.deg2rad(89.0))), [Rctm()], log(3))
    assert {o.status for o in outcomes} == {"unavailable"}
    assert all(o.reason for o in outcomes)
