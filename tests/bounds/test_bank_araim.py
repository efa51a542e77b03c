"""The published ARAIM examples through the bank of subfilters: snapshot ARAIM is a filter without a prior."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from araim_vectors import GROUPS, KEYS, VECTORS, araim_reference, design, ism_of

from pntegrity.bounds.ism import Ism
from pntegrity.kernels.protection import largest_threshold
from pntegrity.monitors._members import cast_of
from pntegrity.monitors.separation import Separation, SeparationMemory
from pntegrity.records import Bound, FloatArray, Layout, Prior, State, Update, Verdict

NAMES = Layout(("pos:x", "pos:y", "pos:z", "clk:G", "clk:E"))
#: Wider than any error of the example, and not so wide that a difference of two variances is rounding.
WIDE_M2 = 1e8


def snapshot(vector: dict[str, Any], nu: FloatArray | None = None, wide_m2: float = WIDE_M2) -> Update:
    P = wide_m2 * np.eye(5)
    prior = Prior(State(10**9, np.zeros(5), P, NAMES), np.zeros((5, 0)), P)
    rows = np.zeros(10) if nu is None else nu
    R, accuracy = np.diag(vector["c_int_m2"]), np.diag(vector["c_acc_m2"])
    return Update.of(prior, KEYS, rows, design(vector), R, R_accuracy=accuracy)


def monitor(ism: Ism, **changes: Any) -> Separation:
    return Separation(p_fa=ism.p_fa, ism=ism, **changes)


def judged(
    version: str, nu: FloatArray | None = None, **changes: Any
) -> tuple[Verdict, Bound, SeparationMemory]:
    m = monitor(ism_of(VECTORS[version]), **changes)
    verdict, memory = m.step(m.start(), snapshot(VECTORS[version], nu))
    assert verdict.bound is not None
    return verdict, verdict.bound, memory


@pytest.mark.parametrize("pairs", [True, False])
@pytest.mark.parametrize("version", VECTORS)
def test_levels_are_the_exact_roots_to_a_millimetre(version: str, pairs: bool) -> None:
    verdict, bound, _ = judged(version, pairs=pairs)
    exact = VECTORS[version]["exact_root"]
    assert verdict.status == "ok"
    assert bound.vpl_m == pytest.approx(exact["vpl_m"], abs=1e-3)
    assert bound.hpl_m == pytest.approx(exact["hpl_m"], abs=1e-3)
    want = araim_reference(VECTORS[version])
    np.testing.assert_allclose([bound.east_m, bound.north_m, bound.up_m], want["levels"], atol=1e-3)
    np.testing.assert_allclose(bound.sigma_m, want["sigma0"], atol=1e-6)
    assert (bound.modes, bound.unmonitored) == (12, want["modes"].unmonitored)


@pytest.mark.parametrize("version", VECTORS)
def test_the_effective_monitor_threshold_is_that_of_the_exact_root(version: str) -> None:
    # GIVEN the variances of the separations that the monitor carries
    _, _, memory = judged(version, pairs=False)
    vector, beside = VECTORS[version], memory.beside
    assert beside is not None
    ism = ism_of(vector)
    p = cast_of(ism, tuple(sorted(GROUPS)), False).probability
    sigma = np.sqrt(beside.separation()[1 : 1 + len(p), 2, 2])
    # THEN with the factor of the test up they give the published threshold
    factor = monitor(ism)._factors(spread_of(beside.own), cast_of(ism, tuple(sorted(GROUPS)), False))[2]
    emt = largest_threshold(p, factor * sigma, ism.p_emt)
    assert emt == pytest.approx(vector["exact_root"]["emt_m"], abs=1e-3)
    accuracy = float(np.sqrt(beside.own[0, 2, 2]))
    assert accuracy == pytest.approx(vector["exact_root"]["sigma_acc_m"], abs=1e-4)


def spread_of(own: FloatArray) -> Any:
    from pntegrity.monitors._levels import Spread

    n = len(own)
    return Spread.of(
        np.eye(3),
        np.zeros((n, 3)),
        own[:, :3, :3],
        np.full(n, np.inf),
        np.zeros((n, 0, 3)),
        np.zeros(n, bool),
    )


@pytest.mark.parametrize("version", VECTORS)
def test_an_alert_comes_where_one_separation_reaches_its_threshold(version: str) -> None:
    # GIVEN a bias on one satellite that moves its separation up to just below, and above, the threshold
    vector = VECTORS[version]
    want = araim_reference(vector)
    G, c = design(vector), np.array(vector["c_int_m2"])
    at = KEYS.index("G01:C1C")
    mode = [m.name for m in want["modes"].monitored].index("G01")
    S0 = np.linalg.solve((G.T / c) @ G, G.T / c)
    keep = np.arange(10) != at
    S1 = np.zeros_like(S0)
    S1[:, keep] = np.linalg.solve((G[keep].T / c[keep]) @ G[keep], G[keep].T / c[keep])
    ratio = np.abs((S1 - S0)[:3, at]) / want["threshold"][mode]
    size = 1.0 / ratio.max()
    for factor, status in ((0.999, "ok"), (1.001, "alert")):
        nu = np.zeros(10)
        nu[at] = factor * size
        verdict, _, _ = judged(version, nu)
        assert (verdict.status, verdict.statistic) == (status, pytest.approx(factor, rel=1e-5))
    # THEN that satellite is named
    assert verdict.suspect_groups == ("G01",)


def test_a_prior_wide_enough_is_none() -> None:
    vector = VECTORS["add_v3_1"]
    m = monitor(ism_of(vector), pairs=False)
    levels = []
    for wide in (1e6, 1e8, 1e10):
        bound = m.step(m.start(), snapshot(vector, wide_m2=wide))[0].bound
        assert bound is not None
        levels.append((bound.hpl_m, bound.vpl_m))
    np.testing.assert_allclose(levels, [levels[1]] * 3, atol=2e-4)


def test_without_nominal_biases_and_with_one_covariance_the_levels_fall() -> None:
    vector = VECTORS["add_v3_1"]
    plain = monitor(replace(ism_of(vector), b_code_m=0.0))
    u = replace(snapshot(vector), R_accuracy=None)
    verdict, memory = plain.step(plain.start(), u)
    assert memory.beside is None
    assert verdict.bound is not None
    assert verdict.bound.vpl_m < judged("add_v3_1")[1].vpl_m
