"""The factor-set monitor: its own test, and what it says of an estimator's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from pntegrity.kernels.factor_set import FactorMemory, FactorSet, screen_factor_set
from pntegrity.kernels.snapshot_fix import design
from pntegrity.monitors._snapshot import code_rows
from pntegrity.monitors.factor_set import FactorSetTest
from pntegrity.records import Layout, Prior, State, Update
from pntegrity.scenarios.evidence_factor_set_rate import sky, with_noise
from pntegrity.simulate.linear import Disturbance, linear_updates, spp_model
from pntegrity.verdicts import Screening


def update_of(rows, prior_sigma=1000.0):
    """A filter whose states are position and clocks, at the linearisation point."""
    A, numbers = design(rows)
    names = ("pos:x", "pos:y", "pos:z", "clk:G", *(f"isb:{n}" for n in numbers[1:]))
    A[:, 3] = 1.0
    state = State(10**9, np.zeros(len(names)), prior_sigma**2 * np.eye(len(names)), Layout(names))
    prior = Prior(state, np.eye(len(names)), np.zeros((len(names), len(names))))
    return Update.of(prior, rows.keys, rows.residual_m, A, np.diag(rows.sigma_m**2))


def noisy(n=12, seed=0, faults=()):
    rng = np.random.default_rng(seed)
    rows = with_noise(sky(n, rng), rng)
    z = rows.residual_m.copy()
    for i, size in faults:
        z[i] += size
    return type(rows)(rows.keys, rows.los, rows.clock, z, rows.sigma_m, rows.enu)


@pytest.mark.parametrize("prior_sigma", [0.1, 10.0, 1e4])
def test_the_statistic_is_that_of_a_snapshot_whatever_the_prior(prior_sigma):
    rows = noisy(11, 4)
    verdict, _ = FactorSetTest().step(FactorMemory(), update_of(rows, prior_sigma))
    screening = screen_factor_set(FactorSet(), FactorMemory(), rows)[0]
    assert verdict.statistic == pytest.approx(screening.first, rel=1e-6)
    assert verdict.threshold == pytest.approx(screening.first_limit)
    assert verdict.dof == 6


@pytest.mark.parametrize("variant", ["exact", "published"])
def test_suspects_are_what_detection_leaves_out_in_order(variant):
    rows = noisy(16, 2, faults=[(3, 70.0), (8, -40.0), (13, 55.0)])
    verdict, _ = FactorSetTest(variant=variant).step(FactorMemory(), update_of(rows))
    screening = screen_factor_set(FactorSet(variant), FactorMemory(), rows)[0]
    assert verdict.status == "alert"
    assert [s.groups[0] for s in verdict.suspects] == [k[:3] for k, _ in screening.dropped]
    sizes = {s.groups[0]: s.size for s in verdict.suspects}
    assert sizes[rows.keys[3][:3]] == pytest.approx(70.0, abs=6.0)
    assert sizes[rows.keys[8][:3]] == pytest.approx(-40.0, abs=6.0)
    assert not verdict.ambiguous


def test_with_one_degree_of_freedom_every_satellite_may_be_at_fault():
    verdict, _ = FactorSetTest().step(FactorMemory(), update_of(noisy(6, 2, faults=[(3, 400.0)])))
    assert verdict.status == "alert"
    assert verdict.suspects == ()
    assert verdict.ambiguous


def test_range_rates_and_other_states_do_not_spoil_the_chi_square():
    updates = linear_updates(spp_model(9), 3000, np.random.default_rng(1))
    monitor, memory = FactorSetTest(), FactorMemory()
    values = []
    for update in updates:
        verdict, memory = monitor.step(memory, update)
        values.append(verdict.statistic)
    assert verdict.dof == 5
    assert np.mean(values) == pytest.approx(5.0, abs=5.0 * np.sqrt(10.0 / 3000))
    assert np.mean(np.array(values) > chi2.isf(0.01, 5)) == pytest.approx(0.01, abs=0.006)


def test_a_fault_of_the_range_rate_alone_is_not_seen():
    rows = np.zeros((10, 18))
    rows[5, 12] = 50.0
    updates = linear_updates(spp_model(9), 10, np.random.default_rng(1), Disturbance(rows=rows))
    assert set(code_rows(updates[5])) == set(range(9))
    assert FactorSetTest().step(FactorMemory(), updates[5])[0].status == "ok"


def test_an_estimators_screening_is_reported():
    rows = noisy(14, 5, faults=[(2, 60.0), (6, -80.0)])
    screening = screen_factor_set(FactorSet(), FactorMemory(), rows)[0]
    update = replace(update_of(noisy(14, 5)), screening=screening)
    verdict, _ = FactorSetTest().step(FactorMemory(), update)
    assert verdict.status == "ok"
    assert verdict.statistic == screening.last
    assert verdict.threshold == pytest.approx(screening.last_limit)
    assert "left out: " + rows.keys[6] + " (1)" in verdict.reason
    assert FactorSetTest(factor=2.0).step(FactorMemory(), update)[0].threshold == 2.0 * verdict.threshold


def test_a_set_that_stayed_inconsistent_is_an_alert():
    screening = Screening(
        "lsr", first=90.0, first_limit=40.0, last=90.0, last_limit=40.0, dof=7, dropped=(("G01:C1C", 1),)
    )
    update = replace(update_of(noisy(12, 5)), screening=screening)
    verdict, _ = FactorSetTest().step(FactorMemory(), update)
    assert verdict.status == "alert"
    assert verdict.suspect_groups == ("G01",)


def test_an_estimator_without_a_test_leaves_it_to_the_monitor_or_says_why_there_is_none():
    untested = Screening("factor-set", used=False, reason="no redundancy: 5 satellites, 5 states")
    own = replace(update_of(noisy(12, 5)), screening=untested)
    assert FactorSetTest().step(FactorMemory(), own)[0].status == "ok"
    empty = State(10**9, np.zeros(3), np.eye(3), Layout(("pos:x", "pos:y", "pos:z")))
    prior = Prior(empty, np.eye(3), np.zeros((3, 3)))
    fix = Update.of(prior, ("fix:X", "fix:Y", "fix:Z"), np.zeros(3), np.eye(3), np.eye(3))
    verdict, _ = FactorSetTest().step(FactorMemory(), replace(fix, screening=untested))
    assert verdict.status == "unavailable"
    assert "no redundancy: 5 satellites" in verdict.reason


def test_the_published_sigmas_adapt_and_its_alarms_multiply():
    rng, rows = np.random.default_rng(8), sky(12, np.random.default_rng(3))
    monitors = {v: FactorSetTest(1e-3, v) for v in ("exact", "published")}
    alarms, memories = dict.fromkeys(monitors, 0), {v: m.start() for v, m in monitors.items()}
    for k in range(1500):
        update = update_of(with_noise(rows, rng))
        for v, monitor in monitors.items():
            verdict, memories[v] = monitor.step(memories[v], update)
            alarms[v] += k >= 200 and verdict.status == "alert"
    assert alarms["exact"] <= 6  # 1.3 expected
    assert alarms["published"] > 30
    assert memories["exact"].epochs == 0
