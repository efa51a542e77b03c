"""Errors of products: as large and as lasting as they are told to be."""

import numpy as np
import pytest

from pntegrity.physics.atmosphere_products import AtmosphereProducts, metres_per_tecu
from pntegrity.simulate.products import disturbed, gauss_markov

T0, SECOND = 1_325_030_400 * 10**9, 10**9
N = 40_000


@pytest.fixture
def rng():
    return np.random.default_rng(5)


@pytest.mark.parametrize("tau_s", [0.0, 20.0, 300.0])
def test_the_process_has_its_size_and_its_memory(rng, tau_s):
    # GIVEN steps of 5 and of 10 s in turn
    t_ns = T0 + SECOND * np.cumsum(np.tile([5, 10], N // 2))
    x = gauss_markov(t_ns, 0.2, tau_s, rng)
    # THEN correlations are those of the steps; a long memory leaves fewer independent samples
    slack = 4.0 * np.sqrt((1.0 + 2.0 * tau_s / 7.5) / N)
    assert x.std() == pytest.approx(0.2, rel=slack)
    for first, step in ((1, 10.0), (0, 5.0)):
        found = np.mean(x[first:-1:2][: N // 2 - 1] * x[first + 1 :: 2][: N // 2 - 1]) / 0.2**2
        expected = np.exp(-[10.0, 5.0][first] / tau_s) if tau_s else 0.0
        assert found == pytest.approx(expected, abs=2.0 * slack), step


def test_it_is_stationary_from_the_first_sample_on(rng):
    t_ns = T0 + SECOND * np.arange(50)
    first = np.array([gauss_markov(t_ns, 1.0, 600.0, rng)[[0, 49]] for _ in range(3000)])
    np.testing.assert_allclose(first.std(axis=0), 1.0, rtol=0.05)
    assert np.corrcoef(first.T)[0, 1] == pytest.approx(np.exp(-49 / 600), abs=0.02)


def test_long_gaps_and_no_samples(rng):
    x = gauss_markov(np.array([0, 10**18, 2 * 10**18]), 1.0, 1.0, rng)
    assert np.isfinite(x).all()
    assert len(gauss_markov(np.zeros(0, dtype=np.int64), 1.0, 1.0, rng)) == 0


def flat(n=2000):
    t_ns = T0 + 30 * SECOND * np.arange(n)
    slant = {sat: (t_ns, np.full(n, 20.0), np.full(n, 0.3)) for sat in ("G05", "C21")}
    return AtmosphereProducts(slant, (t_ns, np.full(n, 0.1), np.full(n, 0.01)), source="a station")


def test_products_get_errors_of_the_stated_size_and_say_so(rng):
    made = disturbed(flat(), 0.2, 0.1, 0.0, rng)
    g, c = (made.ionosphere[s] for s in ("G05", "C21"))
    tecu = 0.2 / metres_per_tecu(1575.42e6)
    assert (g[1] - 20.0).std() == pytest.approx(tecu, rel=0.07)
    assert (made.troposphere[1] - 0.1).std() == pytest.approx(0.1, rel=0.07)
    np.testing.assert_allclose(g[2], np.hypot(0.3, tecu))
    np.testing.assert_allclose(made.troposphere[2], np.hypot(0.01, 0.1))
    assert abs(np.corrcoef(g[1], c[1])[0, 1]) < 0.1
    assert made.source == "a station; errors added: slant 0.2 m on L1, zenith 0.1 m, white"


def test_nothing_added_is_nothing_changed_and_a_seed_is_a_seed(rng):
    made = disturbed(flat(), 0.0, 0.0, 1800.0, rng)
    np.testing.assert_array_equal(made.ionosphere["G05"], flat().ionosphere["G05"])
    one, two = (disturbed(flat(), 0.2, 0.1, 1800.0, np.random.default_rng(3)) for _ in range(2))
    np.testing.assert_array_equal(one.ionosphere["C21"], two.ionosphere["C21"])


@pytest.mark.parametrize("sizes", [(-1.0, 0.1, 0.0), (0.2, np.nan, 0.0), (0.2, 0.1, -1.0)])
def test_sizes_below_zero_are_refused(rng, sizes):
    with pytest.raises(ValueError, match="must be at least 0"):
        disturbed(flat(), *sizes, rng)
