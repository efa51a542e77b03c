"""Factor-set detection, LSR and their window of residuals against numbers worked by hand and by force."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, ks_1samp, ncx2

from pntegrity.kernels.factor_set import (
    FactorMemory,
    FactorSet,
    Pseudoranges,
    araim_subsets,
    screen_factor_set,
    undetected,
)
from pntegrity.kernels.lsr import screen_lsr, screen_none
from pntegrity.kernels.snapshot_fix import design, eliminate, eliminate_correlated, project
from pntegrity.scenarios.evidence_factor_set_rate import sky, with_noise

EXACT, PUBLISHED = FactorSet(), FactorSet("published")


def rows_of(n=12, seed=0, systems=2, sigma=None, faults=()):
    rng = np.random.default_rng(seed)
    base = sky(n, rng)
    sigma = np.ones(n) if sigma is None else sigma
    clock = np.arange(n) % systems
    z = sigma * rng.standard_normal(n) + 30.0 * clock
    for i, size in faults:
        z[i] += size
    return Pseudoranges(base.keys, base.los, clock, z, sigma, base.enu)


def select(rows, kept):
    return Pseudoranges(
        tuple(k for k, use in zip(rows.keys, kept, strict=True) if use),
        rows.los[kept], rows.clock[kept], rows.residual_m[kept], rows.sigma_m[kept], rows.enu,
    )  # fmt: skip


def residual_square(rows, weights, sigma):
    """Statistic by a plain least squares."""
    A, _ = design(rows)
    x, *_ = np.linalg.lstsq(A * weights[:, None], rows.residual_m * weights, rcond=None)
    return float((((rows.residual_m - A @ x) / sigma) ** 2).sum())


def brute(rows, weights, sigma, limits, most=99):
    """Exclusion with one least squares a subset."""
    kept, order, tests = np.arange(len(rows.keys)), [], 0

    def statistic(index):
        part = select(rows, np.isin(np.arange(len(rows.keys)), index))
        return residual_square(part, weights[index], sigma[index])

    now, dof = statistic(kept), len(limits) - 1
    while now > limits[dof] and dof > 1 and len(order) < most:
        values = {}
        for i in kept:
            rest = kept[kept != i]
            if set(rows.clock[rest]) == set(rows.clock):
                tests += 1
                values[i] = statistic(rest)
        worst = min(values, key=values.get)
        kept, now, dof = kept[kept != worst], values[worst], dof - 1
        order.append(int(worst))
    return order, now, tests


@pytest.mark.parametrize("options", [EXACT, PUBLISHED], ids=["exact", "published"])
@pytest.mark.parametrize("seed", range(12))
def test_downdates_find_what_a_least_squares_for_every_subset_finds(options, seed):
    rng = np.random.default_rng(100 + seed)
    n = int(rng.integers(8, 18))
    faults = [(i, rng.uniform(-80, 80)) for i in rng.choice(n, 4, replace=False)]
    sigma = rng.uniform(0.5, 3.0, n)
    rows = rows_of(n, seed, systems=1 + seed % 2, sigma=sigma, faults=faults)
    screening, fix, kept, _ = screen_factor_set(options, FactorMemory(), rows)
    exact = options.variant == "exact"
    weights, used = (1.0 / sigma, sigma) if exact else (np.ones(n), np.ones(n))
    dof = n - 3 - (1 + seed % 2)
    limits = np.array([0.0, *chi2.isf(1e-5, np.arange(1, dof + 1))])
    order, last, tests = brute(rows, weights, used, limits)
    assert [key for key, _ in screening.dropped] == [rows.keys[i] for i in order]
    assert [k for _, k in screening.dropped] == list(range(1, len(order) + 1))
    assert screening.tests == tests
    assert screening.first == pytest.approx(residual_square(rows, weights, used))
    assert screening.last == pytest.approx(last, rel=1e-6)
    assert screening.last_limit == pytest.approx(limits[dof - len(order)])
    assert screening.satellites == (n, n - len(order))
    part = select(rows, kept)
    A, _ = design(part)
    w = weights[kept]
    x = np.linalg.solve((A * w[:, None] ** 2).T @ A, (A * w[:, None] ** 2).T @ part.residual_m)
    assert np.allclose(fix.offset_m, x[:3], atol=1e-8)
    assert np.allclose(fix.clocks, x[3:], atol=1e-8)
    assert np.allclose(fix.residuals, part.residual_m - A @ x, atol=1e-8)


def test_four_satellites_up_and_around_worked_by_hand():
    # one clock, five satellites: north, east, south, west on the horizon, one in the zenith
    los = np.array([[0, 1, 0], [1, 0, 0], [0, -1, 0], [-1, 0, 0], [0, 0, 1.0]])
    z = np.array([4.0, 0.0, 0.0, 0.0, 0.0])
    keys = tuple(f"G0{i}:C1C" for i in range(1, 6))
    rows = Pseudoranges(keys, los, np.zeros(5, dtype=int), z, np.ones(5), np.eye(3))
    screening, fix, kept, _ = screen_factor_set(EXACT, FactorMemory(), rows)
    # the clock is the mean of the four, 1; the residuals are 1, -1, 1, -1, 0; zenith takes the height
    assert np.allclose(fix.residuals, [1, -1, 1, -1, 0])
    assert screening.first == pytest.approx(4.0)
    assert np.allclose(fix.offset_m, [0.0, -2.0, 1.0])
    assert np.allclose(fix.clocks, [1.0])
    assert np.allclose(np.diag(fix.cov), [0.5, 0.5, 1.25])
    assert kept.all()
    assert screening.dof == 1
    # slopes: gain 1/2 over the root of the redundancy 1/4
    assert screening.missed_m == pytest.approx(np.sqrt(undetected(1e-5, 1e-5, 1)))
    assert screening.false_alarm_m == pytest.approx(np.sqrt(5.0))
    assert np.isnan(screening.false_alarm_limit_m)


def test_a_consistent_sky_has_exactly_a_chi_square():
    rng = np.random.default_rng(3)
    rows = replace_sigma(sky(11, rng), rng.uniform(0.5, 4.0, 11))
    values = [screen_factor_set(EXACT, FactorMemory(), with_noise(rows, rng))[0].first for _ in range(4000)]
    assert ks_1samp(values, chi2(6).cdf).pvalue > 1e-3


def replace_sigma(rows, sigma):
    return Pseudoranges(rows.keys, rows.los, rows.clock, rows.residual_m, sigma, rows.enu)


def test_the_missed_detection_factor_is_the_error_of_the_fault_that_is_missed():
    rng = np.random.default_rng(5)
    sigma = rng.uniform(0.5, 3.0, 10)
    rows = replace_sigma(sky(10, rng), sigma)
    factor = screen_factor_set(EXACT, FactorMemory(), rows)[0].missed_m
    lam = undetected(1e-5, 1e-5, 5)
    assert ncx2.cdf(chi2.isf(1e-5, 5), 5, lam) == pytest.approx(1e-5, rel=1e-4)
    worst = 0.0
    for i in range(10):
        z = np.zeros(10)
        z[i] = 1.0
        faulty = Pseudoranges(rows.keys, rows.los, rows.clock, z, sigma, rows.enu)
        _, fix, _, _ = screen_none(EXACT, FactorMemory(), faulty)
        square = residual_square(faulty, 1.0 / sigma, sigma)
        worst = max(worst, np.hypot(*fix.offset_m[:2]) * np.sqrt(lam / square))
    assert factor == pytest.approx(worst, rel=1e-9)


def test_several_faults_at_once_are_left_out():
    faults = [(1, 60.0), (4, -45.0), (9, 80.0), (12, 35.0)]
    for options in (EXACT, PUBLISHED):
        screening, _, kept, _ = screen_factor_set(options, FactorMemory(), rows_of(18, 8, faults=faults))
        assert set(np.flatnonzero(~kept)) == {1, 4, 9, 12}
        assert screening.used
        assert screening.tests == 18 + 17 + 16 + 15
        assert screening.pdop[1] > screening.pdop[0]


def test_the_only_satellite_of_a_constellation_is_never_left_out():
    rows = rows_of(10, 2, faults=[(3, 500.0)])
    clock = np.where(np.arange(10) == 3, 1, 0)
    alone = Pseudoranges(rows.keys, rows.los, clock, rows.residual_m, rows.sigma_m, rows.enu)
    clean = Pseudoranges(rows.keys, rows.los, clock, rows.residual_m * 0, rows.sigma_m, rows.enu)
    _, fix, kept, _ = screen_factor_set(EXACT, FactorMemory(), alone)
    assert kept[3]
    assert fix.numbers == (0, 1)
    assert abs(fix.residuals[list(np.flatnonzero(kept)).index(3)]) < 1e-6  # its own clock takes it all
    assert np.isfinite(screen_factor_set(EXACT, FactorMemory(), clean)[0].missed_m)  # it moves no position


def test_exclusion_ends_with_one_degree_of_freedom_and_the_false_alarm_check_decides():
    rng = np.random.default_rng(9)
    rows = rows_of(9, 1, faults=[(i, rng.uniform(-400, 400)) for i in range(9)])
    near, far = replace(EXACT, false_alarm_limit_m=1e9), replace(EXACT, false_alarm_limit_m=1e-9)
    screening, fix, kept, memory = screen_factor_set(near, FactorMemory(), rows)
    assert screening.last > screening.last_limit
    assert kept.sum() == 6
    assert screening.used
    assert screening.reason.endswith("passed the false-alarm check")
    assert screening.false_alarm_m == pytest.approx(np.linalg.norm(fix.offset_m))
    assert np.isnan(screening.missed_m)
    assert memory.epochs == 0  # `exact` learns from consistent epochs only
    assert screen_factor_set(replace(near, variant="published"), FactorMemory(), rows)[3].epochs == 1
    refused, _, _, after = screen_factor_set(far, FactorMemory(), rows)
    assert not refused.used
    assert "false-alarm factor above" in refused.reason
    assert after.epochs == 0


def test_no_update_and_nothing_learnt_where_the_missed_detection_check_fails():
    for variant in ("exact", "published"):
        options = FactorSet(variant, missed_limit_m=0.1)
        screening, fix, _, memory = screen_factor_set(options, FactorMemory(), rows_of())
        assert not screening.used
        assert fix is not None
        assert "missed-detection" in screening.reason
        assert memory.epochs == 0


@pytest.mark.parametrize(
    ("clock", "tested"),
    [
        ([0, 0, 0, 0, 1, 1, 1, 1], True),
        ([0, 0, 0, 0, 0, 1, 1, 1], False),
        ([0, 0, 0, 0, 0], True),
        ([0, 0, 0, 0], False),
        ([0, 0, 0, 0, 1, 1, 1, 1, 2], True),
        ([0, 0, 0, 0, 1, 1, 1, 2, 2, 2], False),
    ],
)
def test_the_gate_of_the_paper(clock, tested):
    n = len(clock)
    base = rows_of(n, 4, systems=1)
    rows = Pseudoranges(base.keys, base.los, np.array(clock), base.residual_m, base.sigma_m, base.enu)
    screening = screen_factor_set(PUBLISHED, FactorMemory(), rows)[0]
    assert (screening.dof > 0) == tested
    assert np.isfinite(screening.first) == tested
    exact = screen_factor_set(EXACT, FactorMemory(), rows)[0]
    assert (exact.dof > 0) == (n > 3 + len(set(clock)))


@pytest.mark.parametrize("screen", [screen_factor_set, screen_lsr, screen_none])
@pytest.mark.parametrize("n", [0, 1, 4])
def test_too_few_satellites_give_no_fix(screen, n):
    screening, fix, kept, _ = screen(EXACT, FactorMemory(), rows_of(n))
    assert fix is None
    assert not screening.used
    assert screening.reason
    assert screening.pdop == (np.inf, np.inf)
    assert len(kept) == n


def test_satellites_in_one_plane_determine_no_position():
    rows = rows_of(8, 1, systems=1)
    los = rows.los * [1.0, 0.0, 1.0]
    los /= np.linalg.norm(los, axis=1)[:, None]
    flat = Pseudoranges(rows.keys, los, rows.clock, rows.residual_m, rows.sigma_m, rows.enu)
    screening, fix, _, _ = screen_factor_set(EXACT, FactorMemory(), flat)
    assert fix is None
    assert "do not determine" in screening.reason


def test_lsr_thinks_of_one_fault_only():
    one = screen_lsr(EXACT, FactorMemory(), rows_of(14, 3, faults=[(5, 50.0)]))
    assert list(np.flatnonzero(~one[2])) == [5]
    assert one[0].last <= one[0].last_limit
    rows = rows_of(14, 3, faults=[(5, 50.0), (8, -70.0)])
    two = screen_lsr(EXACT, FactorMemory(), rows)
    assert np.count_nonzero(~two[2]) == 1
    assert two[0].used
    assert two[0].first > two[0].last > two[0].last_limit
    assert "more than one fault" in two[0].reason
    assert not np.allclose(two[1].offset_m, screen_none(EXACT, FactorMemory(), rows)[1].offset_m)
    clean = screen_lsr(EXACT, FactorMemory(), rows_of(14, 3))
    assert clean[0].dropped == ()
    assert clean[0].tests == 0


def test_the_published_lsr_has_its_own_sigma():
    rows = rows_of(10, 6, sigma=np.full(10, 3.0))
    wide = screen_lsr(replace(PUBLISHED, sigma_m=3.0), FactorMemory(), rows)[0]
    narrow = screen_lsr(PUBLISHED, FactorMemory(), rows)[0]
    assert narrow.first == pytest.approx(9.0 * wide.first)


def test_both_ways_of_elimination_agree_where_rows_are_independent():
    rows = rows_of(13, 21, sigma=np.linspace(0.5, 3.0, 13), faults=[(2, 40.0), (7, -60.0)])
    root = 1.0 / rows.sigma_m
    found = project(design(rows)[0], root)
    limits = np.array([0.0, *chi2.isf(1e-5, np.arange(1, found.dof + 1))])
    whitened = found.project @ (rows.residual_m * root)
    one = eliminate(found.project, whitened, np.ones(13), limits, found.dof - 1)
    V = root[:, None] * found.project * root
    two = eliminate_correlated(V, rows.residual_m, limits)
    assert one.order == two.order == (2, 7)  # 40 m of 0.9 m is more than 60 m of 2 m
    assert (one.tests, one.passed) == (two.tests, two.passed)
    assert two.last == pytest.approx(one.last, rel=1e-6)


def test_the_window_is_the_sum_of_its_last_epochs():
    rng = np.random.default_rng(2)
    memory, said = FactorMemory(), []
    for k in range(150):
        keys = tuple(f"G{i:02d}" for i in rng.choice(12, 5, replace=False))
        square, count = rng.random(5), rng.random(5)
        said.append((keys, square, count))
        before = pickle.dumps(memory)
        after = memory.pushed(keys, square, count, 40)
        assert pickle.dumps(memory) == before
        memory = pickle.loads(pickle.dumps(after)) if k % 7 == 0 else after
        for key in memory.keys:
            own = [(s[i], c[i]) for ks, s, c in said[-40:] for i, x in enumerate(ks) if x == key]
            square_sum, count_sum = memory.sums((key,))
            assert square_sum[0] == pytest.approx(sum(s for s, _ in own), abs=1e-9)
            assert count_sum[0] == pytest.approx(sum(c for _, c in own), abs=1e-9)
    assert memory.epochs == 40
    assert memory.sums(("never",)) == (0.0, 0.0)


def test_the_published_sigma_waits_for_its_window_and_has_a_floor():
    options = FactorSet("published", window=10, p_fa=1e-9, missed_limit_m=1e3)
    rng, memory = np.random.default_rng(1), FactorMemory()
    for k in range(30):
        rows = with_noise(replace_sigma(sky(10, np.random.default_rng(4)), np.full(10, 0.05)), rng)
        memory = screen_factor_set(options, memory, rows)[3]
        expected = 1.0 if k < 8 else 0.3  # more than 0.8 of 10 epochs
        assert np.allclose(memory.sigmas(rows.keys, 1.0), expected)


def test_the_published_sigma_is_the_residuals_own_and_the_exact_one_the_measurements():
    rng = np.random.default_rng(6)
    rows = sky(10, rng)
    redundancy = project(design(rows)[0], np.ones(10)).redundancy
    ratios = {}
    for variant in ("published", "exact"):
        options, memory = FactorSet(variant, window=4000), FactorMemory()
        for _ in range(4000):
            memory = screen_factor_set(options, memory, with_noise(rows, rng))[3]
        ratios[variant] = memory.sigmas(rows.keys, 1.0)
    assert np.allclose(ratios["published"], np.maximum(np.sqrt(redundancy), 0.3), rtol=0.06)
    assert np.allclose(ratios["exact"], 1.0, atol=0.05)


def test_the_exact_sigma_cannot_shrink_far():
    options, memory = FactorSet(window=50, missed_limit_m=1e3), FactorMemory()
    rows = sky(10, np.random.default_rng(4))
    for _ in range(300):
        memory = screen_factor_set(options, memory, rows)[3]  # residuals of nothing
    ratio = memory.sigmas(rows.keys, 1.0)
    assert (ratio >= np.sqrt(0.8 / 1.8)).all()
    assert (ratio < 1.0).all()
    assert ratio.min() < 0.8
    faulty = with_noise(rows, np.random.default_rng(1))
    assert screen_factor_set(options, memory, faulty)[0].used  # no lock-out when the noise comes back


def test_a_step_changes_nothing_and_is_pure():
    rows, memory = rows_of(12, 3, faults=[(1, 30.0)]), FactorMemory()
    memory = screen_factor_set(EXACT, memory, rows)[3]
    before = pickle.dumps((memory, rows))
    one, two = (screen_factor_set(EXACT, memory, rows) for _ in range(2))
    assert pickle.dumps((memory, rows)) == before
    assert one[0] == two[0]
    assert pickle.dumps(one[3]) == pickle.dumps(two[3])


def test_subsets_of_araim():
    assert araim_subsets(16, 3) == 696
    assert araim_subsets(5, 5) == 31


@pytest.mark.parametrize(
    ("field", "value"),
    [("variant", "other"), ("p_fa", 0.0), ("p_md", 0.7), ("sigma_m", -1.0), ("window", 0), ("filled", 1.5),
     ("missed_limit_m", float("nan"))],
)  # fmt: skip
def test_impossible_options_are_refused_by_name(field, value):
    with pytest.raises(ValueError, match=f"`{field}` must be"):
        FactorSet(**{field: value})


def test_rows_that_do_not_fit_are_refused():
    rows = rows_of(5)
    with pytest.raises(ValueError, match="do not fit 4 keys"):
        Pseudoranges(rows.keys[:4], rows.los, rows.clock, rows.residual_m, rows.sigma_m, rows.enu)
