"""Where arcs begin: every cause alone, slips that hide from one of the two tests, and none where there is
none.
"""

import numpy as np
import pytest

from pntegrity.kernels import slips
from pntegrity.kernels.slips import arc_starts

C = 299_792_458.0
F1, F2 = 1575.42e6, 1227.60e6
L1, L2 = C / F1, C / F2
WIDE = C / (F1 - F2)
LIMITS = {"max_gap_s": 130.0, "gf_limit_m": 0.05, "gf_rate_mps": 5e-5, "step_limit_m": 0.5}


class Series:
    """A satellite's carriers: ionosphere, noise of carriers and codes, and what is done to them."""

    def __init__(self, n=60, step_s=30.0, seed=0, code_m=0.3, carrier_m=0.002, rate_mps=0.0):
        rng = np.random.default_rng(seed)
        self.n, self.t = n, step_s * np.arange(n)
        delay = rate_mps * self.t
        e1, e2 = carrier_m * rng.standard_normal((2, n))
        p1, p2 = code_m * rng.standard_normal((2, n))
        self.first, self.second = e1, e2
        self.gf = delay + e1 - e2
        self.wide = (F1 * e1 - F2 * e2) / (F1 - F2) - (F1 * p1 + F2 * p2) / (F1 + F2)
        self.lli, self.piece = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64)
        self.step = np.full(n, np.nan)
        self.sat = np.zeros(n, dtype=np.int64)

    def slip(self, at, n1, n2):
        self.gf[at:] += L1 * n1 - L2 * n2
        self.wide[at:] += WIDE * (n1 - n2)
        return self

    def keep(self, rows):
        for name in ("t", "gf", "wide", "lli", "piece", "step", "sat"):
            setattr(self, name, getattr(self, name)[rows])
        return self

    def starts(self, **limits):
        found = arc_starts(
            self.sat, self.t, self.lli, self.piece, self.gf, self.wide, np.full(len(self.t), WIDE), self.step,
            *(LIMITS | limits).values(),
        )  # fmt: skip
        return {int(i): int(found[i]) for i in np.flatnonzero(found)}


@pytest.mark.parametrize("step_s", [1.0, 30.0])
@pytest.mark.parametrize(
    ("n1", "n2", "why"),
    [
        (1, 0, slips.GEOMETRY_FREE),
        (0, 1, slips.GEOMETRY_FREE),
        (1, 1, slips.GEOMETRY_FREE),  # 5.4 cm, and no change of the wide lane
        (-1, -1, slips.GEOMETRY_FREE),
        (9, 7, slips.WIDE_LANE),  # 0.3 cm
        (-9, -7, slips.WIDE_LANE),
        (101, 77, slips.GEOMETRY_FREE),
    ],
)
def test_a_slip_is_found_where_it_is(n1, n2, why, step_s):
    for seed in range(20):
        found = Series(seed=seed, step_s=step_s, code_m=0.15, carrier_m=0.0003).slip(40, n1, n2).starts()
        assert found == {0: slips.FIRST, 40: why}, seed


@pytest.mark.parametrize(("code_m", "least", "most"), [(0.1, 85, 100), (0.3, 0, 20)])
def test_one_cycle_of_the_wide_lane_takes_good_codes(code_m, least, most):
    # 5 and 4 cycles: 2.5 cm
    series = (Series(seed=k, code_m=code_m, carrier_m=0.0005).slip(40, 5, 4) for k in range(100))
    found = [s.starts() for s in series]
    assert {why for f in found for at, why in f.items() if at} == {slips.WIDE_LANE}
    assert least <= sum(40 in f for f in found) <= most


@pytest.mark.parametrize("step_s", [1.0, 30.0])
def test_where_nothing_slips_nothing_is_found(step_s):
    # 2000 satellites: carriers of 2.5 mm, codes of 0.5 m, a lively ionosphere
    cut = 0
    for seed in range(2000):
        one = Series(seed=seed, n=120, step_s=step_s, code_m=0.5, carrier_m=0.0025, rate_mps=0.02 / 30.0)
        cut += len(one.starts()) - 1
    assert cut <= 2  # of 240,000 epochs


def test_a_fast_ionosphere_is_not_a_slip_and_a_slip_in_it_is_found():
    # 4 cm in 30 s, as auroral stations see them: the limit holds for what differs from the rate before
    rate = 0.04 / 30.0
    assert Series(rate_mps=rate).starts() == {0: slips.FIRST}
    for sign in (1, -1):
        found = Series(rate_mps=rate, carrier_m=0.0005).slip(30, sign, sign).starts()
        assert found == {0: slips.FIRST, 30: slips.GEOMETRY_FREE}


def test_only_the_past_decides():
    # multipath of one epoch costs an arc, there and back: what comes later is not known yet
    one = Series(code_m=0.1)
    one.wide[30] += 4.0 * WIDE
    found = one.starts()
    assert found == {0: slips.FIRST, 30: slips.WIDE_LANE, 31: slips.WIDE_LANE}
    for n in (31, 40, 60):
        seen = Series(code_m=0.1)
        seen.wide[30] += 4.0 * WIDE
        assert seen.keep(np.arange(n)).starts() == {k: v for k, v in found.items() if k < n}


def test_the_wide_lane_forgets_what_was_before_a_slip():
    found = Series(n=200, code_m=0.1).slip(50, 9, 7).slip(100, 9, 7).slip(150, -18, -14).starts()
    assert list(found) == [0, 50, 100, 150]


@pytest.mark.parametrize(("gap_s", "new"), [(60.0, False), (130.0, False), (131.0, True), (3600.0, True)])
def test_a_gap(gap_s, new):
    one = Series()
    one.t[30:] += gap_s - 30.0
    assert one.starts() == ({0: slips.FIRST, 30: slips.GAP} if new else {0: slips.FIRST})


def test_bits_of_the_receiver():
    one = Series()
    one.lli[10] = 1
    one.lli[20:30] = 2
    one.lli[40] = 4  # anti-spoofing: nothing of the carrier
    # a half-cycle ambiguity begins, and is resolved: the carrier may jump by half a cycle both times
    assert one.starts() == {
        0: slips.FIRST, 10: slips.LOST_LOCK, 20: slips.HALF_CYCLE, 30: slips.HALF_CYCLE,
    }  # fmt: skip


def test_another_signal_or_piece():
    one = Series()
    one.piece[25:] = 7
    assert one.starts() == {0: slips.FIRST, 25: slips.RESTART}


def test_each_satellite_begins_its_own():
    one = Series().slip(30, 1, 0)
    one.sat[30:] = 1
    one.t[30:] -= one.t[30]
    assert one.starts() == {0: slips.FIRST, 30: slips.FIRST}


def test_an_epoch_that_is_missing_is_a_short_gap():
    assert Series().keep(np.delete(np.arange(60), 30)).starts() == {0: slips.FIRST}
    found = Series(carrier_m=0.0005).slip(31, 1, 0).keep(np.delete(np.arange(60), 30)).starts()
    assert found == {0: slips.FIRST, 30: slips.GEOMETRY_FREE}


def test_one_frequency_is_tested_by_its_doppler():
    one = Series(step_s=1.0)
    one.gf[:], one.wide[:] = np.nan, np.nan
    one.step = 0.05 * np.random.default_rng(1).standard_normal(60)
    one.step[30] = 0.8
    assert one.starts() == {0: slips.FIRST, 30: slips.TIME_DIFFERENCE}
    one.step[30] = np.nan  # not known: nothing can be said
    assert one.starts() == {0: slips.FIRST}


def test_the_doppler_sees_what_two_frequencies_hide():
    # 4 and 3 cycles of E1 and E5a: 0.3 cm geometry-free, one wide lane under codes of 1 m, 76 cm of carrier
    one = Series(step_s=1.0, code_m=1.0)
    one.step = 0.02 * np.random.default_rng(1).standard_normal(60)
    one.step[30] += 0.76
    assert one.starts() == {0: slips.FIRST, 30: slips.TIME_DIFFERENCE}


def test_no_rows():
    assert Series(n=0).starts() == {}


def test_every_cause_has_a_word():
    assert sorted(slips.WORDS) == list(range(1, 9))
