import numpy as np
import pytest

from pntegrity.evaluate.whiteness import beside_others, judged, row_kinds, usual_lags_s, whiteness
from pntegrity.records import Layout, Prior, State, Update

EMPTY = {"autocorrelation": [None] * 3, "pairs": [0] * 3, "mean_square": None, "count": 0}


def one(t_s: float, nu: float, start: bool = False, key: str = "G01:C1C") -> Update:
    """Return an update of one row of unit variance."""
    state = State(round(t_s * 1e9), np.zeros(1), np.zeros((1, 1)), Layout(("pos:x",)))
    F = np.zeros((1, 1)) if start else np.eye(1)
    unit = np.eye(1)
    return Update(state.t_ns, (key,), np.array([nu]), unit, unit, F, np.zeros((1, 1)), state, state)


def precise(nu: tuple[float, ...], amb_var: float, clock_var: float = 0.0) -> Update:
    """Return an update of two codes and a carrier that share a clock; the carrier has an ambiguity."""
    layout = Layout(("clk:G", "amb:G01:L1C+L2W:2"))
    prior = Prior(
        State(10**9, np.zeros(2), np.diag([clock_var, amb_var]), layout), np.eye(2), np.zeros((2, 2))
    )
    H = np.array([[1.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    return Update.of(prior, ("G01:C1C", "G02:C1C", "G01:L1C+L2W"), nu, H, np.diag([1.0, 1.0, 1e-4]))


def test_whiteness_of_a_known_process():
    rng = np.random.default_rng(3)
    x = np.zeros(4000)
    for i in range(1, len(x)):
        x[i] = 0.8 * x[i - 1] + 0.6 * rng.standard_normal()
    w = whiteness([one(i + 1.0, v) for i, v in enumerate(x)])["code"]
    assert w["autocorrelation"] == pytest.approx([0.8, 0.8**5, 0.0], abs=0.06)
    assert w["mean_square"] == pytest.approx(1.0, abs=0.12)
    assert w["pairs"] == [3999, 3995, 3970]


def test_pairs_do_not_reach_over_gaps_and_starts():
    there = [1.0, 2.0, 3.0, 8.0, 9.0]
    w = whiteness([one(t, 1.0) for t in there])
    assert w["code"]["pairs"] == [3, 1, 0]  # 1-2, 2-3, 8-9; 3-8
    assert w["rate"] == w["carrier"] == EMPTY
    started = whiteness([one(t, 1.0, start=t == 3.0) for t in there])
    assert started["code"]["pairs"] == [2, 0, 0]


@pytest.mark.parametrize(
    ("interval", "lags"),
    [
        (0.1, (1.0, 5.0, 30.0)),
        (1.0, (1.0, 5.0, 30.0)),
        (0.3, (0.9, 4.5, 27.0)),
        (30.0, (30.0, 150.0, 900.0)),
        (60.0, (60.0, 300.0, 1200.0)),
        (300.0, (300.0, 1500.0, 3000.0)),
    ],
)
def test_lags_follow_the_sampling(interval, lags):
    t_ns = np.round(np.arange(20) * interval * 1e9).astype(np.int64)
    assert usual_lags_s(t_ns) == pytest.approx(lags)


def test_a_slow_log_has_pairs_at_its_lags():
    w = whiteness([one(30.0 * i, 1.0) for i in range(40)])
    assert w["lags_s"] == [30.0, 150.0, 900.0]
    assert w["code"]["pairs"] == [39, 35, 10]
    assert whiteness([one(30.0 * i, 1.0) for i in range(40)], lags_s=(60.0,))["code"]["pairs"] == [38]


def test_kinds_are_told_apart_and_level_is_both_ranges():
    assert row_kinds([precise((0.0,) * 3, 1.0), one(1.0, 0.0, key="G01:D1C")]) == {
        "G01:C1C": "code",
        "G02:C1C": "code",
        "G01:L1C+L2W": "carrier",
        "G01:D1C": "rate",
    }
    assert row_kinds([one(1.0, 0.0, key="gnss:L")]) == {"gnss:L": "code"}  # nothing has an ambiguity
    w = whiteness([precise((1.0, 2.0, 3.0), 4.0)])
    assert (w["code"]["count"], w["carrier"]["count"], w["level"]["count"]) == (2, 1, 3)
    assert w["rate"] == EMPTY


def test_a_carrier_does_not_count_where_its_ambiguity_is_born():
    born, known = precise((1.0, 2.0, 3.0), 1e4), precise((1.0, 2.0, 3.0), 4.0)
    assert np.isnan(judged(born)).tolist() == [False, False, True]
    assert np.isfinite(judged(known)).all()
    assert whiteness([born])["carrier"] == EMPTY
    assert whiteness([born])["code"]["count"] == 2


def test_what_a_clock_without_memory_takes_is_not_in_a_row():
    free, shifted = (precise(tuple(nu), 4.0, 1e8) for nu in ((1.0, 2.0, 3.0), (51.0, 52.0, 53.0)))
    assert beside_others(shifted) == pytest.approx(beside_others(free), abs=1e-3)
    apart = precise((-20.0, 20.0, 0.0), 1e8, 1e8)
    assert beside_others(apart)[:2] == pytest.approx([-40 / np.sqrt(2), 40 / np.sqrt(2)], rel=1e-4)
    assert abs(apart.nu / np.sqrt(np.diagonal(apart.S))).max() < 0.01


def test_it_is_unit_normal_under_the_model():
    rng = np.random.default_rng(5)
    root = np.linalg.cholesky(precise((0.0,) * 3, 4.0, 100.0).S)
    z = np.array(
        [beside_others(precise(tuple(root @ rng.standard_normal(3)), 4.0, 100.0)) for _ in range(4000)]
    )
    assert (z**2).mean(axis=0) == pytest.approx(1.0, abs=0.08)
