"""Separation in a city: sectors that fail together, and levels made of the separations observed."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import binom, norm
from test_separation_groups import run_without
from test_separation_monitor import levels, plain, stepped

from pntegrity.bounds import CITY, Ism, with_risen
from pntegrity.evaluate.stanford import plain_levels, stanford
from pntegrity.monitors._levels import EXPECTED, Spread
from pntegrity.monitors._members import Cast
from pntegrity.monitors.separation import Separation, SeparationMemory
from pntegrity.records import Prior, State, Update
from pntegrity.simulate.linear import Disturbance, LinearModel, draw, gains, shifts, spp_model
from pntegrity.states import rows_touched_by

#: Azimuths, rad, and constellations of the satellites: two or three in most of 8 sectors.
AZ = np.radians([5.0, 20.0, 70.0, 100.0, 130.0, 175.0, 200.0, 235.0, 260.0, 290.0, 310.0, 350.0])
EL = np.radians([60.0, 25.0, 40.0, 70.0, 30.0, 50.0, 20.0, 65.0, 35.0, 45.0, 80.0, 28.0])
NAMES = tuple(f"{'GC'[i % 2]}{i + 1:02d}" for i in range(len(AZ)))
TESTED = Separation(ism=CITY, pairs=False)
OBSERVED = replace(TESTED, levels="observed")


def model(correlated: bool = False) -> LinearModel:
    quick = spp_model(angles_rad=(EL, AZ), accel_mps2=0.1 if correlated else 1.0, code_m=3.0)
    return replace(quick, keys=tuple(f"{s}:{signal}" for signal in ("C1C", "D1C") for s in NAMES))


def placed(updates: Sequence[Update], az_rad: dict[str, float] | None = None) -> list[Update]:
    """Return updates that tell the azimuths of their rows."""
    az = dict(zip(NAMES, AZ.tolist(), strict=True)) | (az_rad or {})
    return [u.altered(aux={"az_rad": np.array([az[k[:3]] for k in u.keys])}) for u in updates]


@lru_cache(maxsize=2)
def quiet(correlated: bool = False, epochs: int = 25) -> list[Update]:
    return placed(gains(model(correlated), epochs))


def noisy(seed: int = 1, fault_m: float = 0.0, groups: tuple[str, ...] = ()) -> list[Update]:
    updates = quiet()
    rng = np.random.default_rng(seed)
    drawn = draw(updates, rng.standard_normal((len(updates), len(updates[0].keys))))
    rows = np.zeros((len(updates), len(updates[0].keys)))
    rows[:, [i for i, k in enumerate(updates[0].keys) if k[:3] in groups and k.endswith("C1C")]] = fault_m
    g = shifts(updates, Disturbance(rows=rows))[0]
    return [u.altered(nu=d.nu + s) for u, d, s in zip(updates, drawn, g, strict=True)]


def end(monitor: Separation, updates: Sequence[Update]):
    return stepped(monitor, updates)[-1]


# --- coverage: faults of any size on any hypothesis


@dataclass(frozen=True)
class Street:
    """What a bank without data gives after its last epoch, and runs of it; shapes (directions, ...)."""

    monitor: Separation
    updates: list[Update]
    tests: list
    cast: Cast
    spread: Spread
    error: np.ndarray
    apart: np.ndarray

    def of_fault(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return by how much faults move the errors (3,) and the separations (members, 3)."""
        g, mean = shifts(self.updates, Disturbance(rows=rows))
        apart = np.zeros((0, len(mean[0]), 1))
        for u, t, shift in zip(self.updates, self.tests, g, strict=True):
            apart = t.step(apart, np.linalg.solve(u.L, shift)[:, None])
        return mean[-1][:3], apart[:, :3, 0]


RUNS = 3000


@lru_cache(maxsize=4)
def street(monitor: Separation, correlated: bool) -> Street:
    updates, rng = quiet(correlated), np.random.default_rng(7)
    memory, tests, apart = monitor.start(), [], np.zeros((0, 8, RUNS))
    for u in updates:
        before = memory
        test, memory = monitor.plan(memory, u)
        apart = test.step(apart, rng.standard_normal((len(u.keys), RUNS)))
        tests.append(test)
    cast, after = monitor.carried(before, updates[-1])
    spread = monitor._spread(before, after, updates[-1])
    # the error of an optimal filter is independent of all innovations
    error = np.linalg.cholesky(updates[-1].posterior.P) @ rng.standard_normal((8, RUNS))
    return Street(monitor, updates, tests, cast, spread, error[:3], apart[:, :3])


def level_of(s: Street, q: int, apart: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return levels of runs (n,), and the probability that each mode may add (modes,), by a root finder."""
    p, modes = s.cast.probability, slice(1, 1 + len(s.cast.faults.monitored))
    sigma, expected = np.sqrt(s.spread.variance[:, q]), EXPECTED * np.sqrt(s.spread.separation[modes, q])
    risk = CITY.risks(s.cast.faults.unmonitored)[q]
    share = lambda L: 2.0 * norm.sf((L - expected) / sigma[modes])  # noqa: E731
    L = brentq(lambda L: 2.0 * norm.sf(L / sigma[0]) + p @ share(L) - risk, 0.0, 1e3, xtol=1e-12)
    over = (np.abs(apart[modes, q]) - expected[:, None]).max(axis=0)
    return L + np.maximum(over, 0.0), share(L)


def faults(s: Street, patterns: tuple[str, ...], rng: np.random.Generator) -> list[np.ndarray]:
    """Return shapes of faults on the codes that a mode spoils: alike, at random, the worst one, a ramp."""
    u = s.updates[-1]
    rows = np.array([k.endswith("C1C") for k in u.keys]) & rows_touched_by(patterns, u.keys)
    shapes = [np.ones(len(rows)), rng.standard_normal(len(rows)), np.sign(u.K[2]), np.sign(u.K[0])]
    steady = [np.tile(np.where(rows, shape, 0.0), (len(s.updates), 1)) for shape in shapes]
    return [*steady, steady[0] * np.linspace(0.0, 1.0, len(s.updates))[:, None]]


@pytest.mark.parametrize("correlated", [False, True])
def test_observed_levels_hold_for_faults_of_any_size_without_an_alert(correlated: bool) -> None:
    s, rng = street(OBSERVED, correlated), np.random.default_rng(1)
    beyond = np.zeros((3, len(s.cast.probability)))
    for i, mode in enumerate(s.cast.faults.monitored):
        for shape in faults(s, mode.patterns, rng):
            moved, parted = s.of_fault(shape)
            for q in (0, 2):
                sizes = np.array([0.0, 0.5, 1.0, 2.0, 4.0, 100.0]) / max(abs(moved[q]), 1e-9)
                beyond[q, i] = max(beyond[q, i], *(_share_beyond(s, q, z * moved, z * parted) for z in sizes))
    for q in (0, 2):
        # each hypothesis stays within its share ...
        _, shares = level_of(s, q, s.apart)
        assert (beyond[q] * RUNS <= binom.isf(1e-6, RUNS, np.minimum(shares, 1.0))).all()
        # ... and all together within the risk; without a fault by 2 Q(L / sigma) alone
        risk, total = CITY.risks(s.cast.faults.unmonitored)[q], float(s.cast.probability @ beyond[q])
        least = level_of(s, q, 0.0 * s.apart)[0][0]
        assert total + 2.0 * norm.sf(least / np.sqrt(s.spread.variance[0, q])) <= risk
        # the bound is not empty: some faults do come near to it
        assert total > 0.1 * risk


def _share_beyond(s: Street, q: int, moved: np.ndarray, parted: np.ndarray) -> float:
    level, _ = level_of(s, q, s.apart + parted[:, :, None])
    return float((np.abs(s.error[q] + moved[q]) > level).mean())


@pytest.mark.parametrize("q", [0, 2])
def test_tested_levels_hold_for_faults_of_any_size_where_there_is_no_alert(q: int) -> None:
    s, rng = street(TESTED, False), np.random.default_rng(q)
    modes = slice(1, 1 + len(s.cast.faults.monitored))
    allowed = s.monitor._allowed(s.spread, s.cast)
    bound = end(TESTED, s.updates)[0].bound
    assert bound is not None
    level, total = levels(bound)[q], 0.0
    for i, mode in enumerate(s.cast.faults.monitored):
        worst = 0.0
        for shape in faults(s, mode.patterns, rng):
            moved, parted = s.of_fault(shape)
            for size in np.linspace(0.0, 1.5, 7) * level / max(abs(moved[q]), 1e-9):
                apart = np.abs(s.apart[modes] + size * parted[modes, :, None])
                silent = (apart <= allowed[:, :, None]).all(axis=(0, 1))
                worst = max(worst, float(((np.abs(s.error[q] + size * moved[q]) > level) & silent).mean()))
        total += s.cast.probability[i] * worst
    assert total <= CITY.risks(s.cast.faults.unmonitored)[q]


def test_the_levels_of_a_verdict_are_those_of_the_formula() -> None:
    updates = noisy(3)
    verdict, _ = end(OBSERVED, updates)
    s = street(OBSERVED, False)
    apart = np.stack([plain(updates, patterns_of(s.cast, m))[0] for m in s.cast.members])
    for q in range(3):
        wanted = level_of(s, q, apart[:, :, None])[0][0]
        assert levels(verdict.bound)[q] == pytest.approx(wanted, rel=1e-6)
    assert verdict.bound.smallest_m == (0.0, 0.0, 0.0)


def patterns_of(cast: Cast, member: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(p for e in cast.events if e.name in member for p in e.patterns)


# --- what the verdict says


def test_a_gross_fault_makes_observed_levels_large_and_alerts_nobody() -> None:
    calm, gross = (end(OBSERVED, noisy(fault_m=f, groups=("G01", "C02")))[0] for f in (0.0, 200.0))
    tested, _ = end(TESTED, noisy(fault_m=200.0, groups=("G01", "C02")))
    assert (calm.status, gross.status, tested.status) == ("ok", "ok", "alert")
    assert gross.statistic == tested.statistic > gross.threshold > calm.statistic
    # the error is some tens of metres, and the level is beyond it; a sector is what makes it large
    error = np.abs(shifts(quiet(), Disturbance(rows=_rows(200.0)))[1][-1][:3])
    assert (levels(gross.bound) > error).all()
    assert (np.array(levels(gross.bound)) > 3.0 * np.array(levels(calm.bound))).all()
    assert gross.bound.dominant[0].startswith("az")


def _rows(size: float) -> np.ndarray:
    keys = quiet()[0].keys
    on = [k[:3] in ("G01", "C02") and k.endswith("C1C") for k in keys]
    return np.tile(np.where(on, size, 0.0), (len(quiet()), 1))


@pytest.mark.parametrize(("limit", "words"), [("hal_m", "horizontal"), ("val_m", "vertical")])
def test_a_level_above_its_alert_limit_is_unavailable(limit: str, words: str) -> None:
    wide, narrow = (end(replace(OBSERVED, ism=replace(CITY, **{limit: m})), noisy())[0] for m in (100.0, 1.0))
    assert (wide.status, wide.reason) == ("ok", "")
    assert narrow.status == "unavailable"
    assert f"the {words} protection level of" in narrow.reason
    assert "above the alert limit of 1 m" in narrow.reason
    assert narrow.bound == wide.bound


def test_where_satellites_are_out_of_view_observed_levels_go_on_and_grow() -> None:
    updates = placed(run_without(model(), 40, lambda k: NAMES if k >= 25 else ()))
    found = stepped(OBSERVED, updates)
    hpl = [v.bound.hpl_m for v, _ in found[24:]]
    assert np.isfinite(hpl).all()
    assert (np.diff(hpl) > 0.0).all()
    assert {v.status for v, _ in found[25:]} == {"ok"}
    # the test has nothing to say there
    assert stepped(TESTED, updates)[30][0].status == "unavailable"


def test_there_is_no_alert_to_plan() -> None:
    test, _ = OBSERVED.plan(OBSERVED.start(), quiet()[0])
    assert "no alert" in test.reason
    assert not TESTED.plan(TESTED.start(), quiet()[0])[0].reason


def test_only_the_two_kinds_of_levels_are_known() -> None:
    with pytest.raises(ValueError, match="`levels` must be 'tested' or 'observed', not 'both'"):
        Separation(levels="both")  # type: ignore[arg-type]


# --- sectors in a bank that remembers


def test_a_subfilter_without_a_sector_never_knew_who_rises_there_later() -> None:
    # GIVEN a satellite that rises in a sector of two, and the first one of another sector
    late = {"C02": 12, "C06": 8, "G07": 15}
    updates = placed(run_without(model(), 24, lambda k: [g for g, first in late.items() if k < first]))
    memory = end(OBSERVED, updates)[1]
    cast = OBSERVED.carried(stepped(OBSERVED, updates[:-1])[-1][1], updates[-1])[0]
    assert {e.name for e in cast.events} == {*NAMES, "C", "G", *(f"az{45 * k:03d}" for k in range(8))}
    assert memory.bank is not None
    position = updates[0].prior.layout.block("pos")
    for i, member in enumerate(memory.members):
        _, P = plain(updates, patterns_of(cast, member))
        np.testing.assert_allclose(memory.bank.P[i][np.ix_(position, position)], P, rtol=1e-6)
    assert (memory.began_ns == updates[0].t_ns).all()


def test_membership_is_that_of_the_first_sight() -> None:
    updates = quiet()
    turned = placed(updates, dict.fromkeys(NAMES, 0.0))
    memory = stepped(OBSERVED, [*updates[:10], *turned[10:]])[-1][1]
    assert memory.sectors == with_risen(CITY, (), (), dict(zip(NAMES, AZ.tolist(), strict=True)))
    # a start forgets it
    start = turned[0].altered(t_ns=turned[-1].t_ns + 1)
    again = OBSERVED.step(memory, start)[1]
    assert {name for name, _ in again.sectors} == {"az000", "az045"}
    assert pickle.loads(pickle.dumps(memory)).sectors == memory.sectors


def test_without_azimuths_the_bound_says_who_is_in_no_sector() -> None:
    bare = [u.altered(aux={}) for u in noisy()]
    known = end(OBSERVED, noisy())[0].bound
    verdict, memory = end(OBSERVED, bare)
    assert "no azimuth was given for C02, C04, C06, C08, C10 and others" in verdict.bound.reason
    assert memory.sectors == ()
    assert verdict.bound.modes < known.modes
    assert known.reason == ""
    # where azimuths come later, those who were used before stay in no sector
    later = end(OBSERVED, [*bare[:5], *noisy()[5:]])[1]
    assert later.sectors == ()


def test_a_whole_sector_out_of_view_is_remembered_while_it_moves_the_position() -> None:
    # GIVEN satellites that cannot fail alone, and a sector whose satellites all set
    ism = Ism(p_sat=0.0, sectors=4, sector_width_deg=90.0, p_sector=1e-4, p_hmi=1e-5)
    north = tuple(g for g, az in zip(NAMES, np.degrees(AZ), strict=True) if (az + 45.0) % 360.0 < 90.0)
    updates = placed(run_without(model(True), 30, lambda k: north if k >= 20 else ()))
    found = stepped(replace(OBSERVED, ism=ism), updates)
    assert ("az000",) in found[20][1].members
    assert dict(found[20][1].sectors)["az000"] == tuple(sorted(north))
    assert set(north) <= set(found[20][1].groups)


# --- after an exclusion


def switched(
    monitor: Separation, groups: tuple[str, ...]
) -> tuple[SeparationMemory, list[Update], list[Update]]:
    """Return the memory after the filter went over to a subfilter, and the updates before and since."""
    updates = noisy()
    memory = stepped(monitor, updates[:15])[-1][1]
    state = monitor.subfilter(memory, updates[14].posterior, frozenset(groups))
    rows = np.array([k[:3] not in groups for k in updates[15].keys])
    P = updates[15].F @ state.P @ updates[15].F.T + updates[15].Q
    u = updates[15]
    prior = Prior(State(u.t_ns, np.zeros(8), 0.5 * (P + P.T), u.prior.layout), u.F, u.Q)
    keys = tuple(k for k, kept in zip(u.keys, rows, strict=True) if kept)
    after = Update.of(prior, keys, u.nu[rows], u.H[rows], u.R[np.ix_(rows, rows)], switched=groups)
    after = placed([after])[0]
    return monitor.carried(memory, after)[1], updates[:15], [after]


@pytest.mark.parametrize("groups", [("G01",), ("C02", "C12", "G01")])
def test_after_an_exclusion_what_holds_it_and_what_lies_within_go_on_exactly(groups: tuple[str, ...]) -> None:
    memory, before, _ = switched(OBSERVED, groups)
    cast = OBSERVED.carried(stepped(OBSERVED, before[:-1])[-1][1], before[-1])[0]
    at = {m: i for i, m in enumerate(memory.members)}
    sectors = dict(memory.sectors)
    holding = [s for s, own in sectors.items() if set(groups) <= set(own)]
    assert holding
    for name in holding:
        # the sector's subfilter is without all of them since ever, and part of what it is tested against
        assert not memory.loose[at[name,]]
        assert memory.began_ns[at[name,]] == before[0].t_ns
    # others, without pairs, are not
    assert memory.loose[at["C08",]]
    for name in groups:
        # what lies within is the filter itself now
        np.testing.assert_array_equal(memory.bank.P[at[name,]], memory.bank.P[0])
        assert not memory.loose[at[name,]]
    if len(groups) > 1:
        # the three make up a whole sector: the filter went over to the subfilter without it
        assert [e.name for e in cast.events if set(e.groups) == set(groups)] == ["az000"]
        np.testing.assert_array_equal(memory.bank.P[at["az000",]], memory.bank.P[0])


def test_with_pairs_a_faulty_sector_is_named_as_one_suspect() -> None:
    ism = replace(CITY, p_constellation=1e-6)
    own = tuple(sorted(g for g, az in zip(NAMES, np.degrees(AZ), strict=True) if 45.0 <= az < 135.0))
    verdict, _ = end(Separation(ism=ism), noisy(fault_m=60.0, groups=own))
    assert verdict.status == "alert"
    assert verdict.suspects[0].groups == own


# --- declared groups, and plain levels beside


def test_declared_groups_are_left_out_together() -> None:
    ism = Ism(p_sat=1e-5, together=(("mast", ("C04", "G01"), 1e-4),), p_hmi=1e-5)
    memory = end(replace(OBSERVED, ism=ism), noisy())[1]
    at = memory.members.index(("mast",))
    _, P = plain(noisy(), ("G01:*", "C04:*"))
    position = quiet()[0].prior.layout.block("pos")
    np.testing.assert_allclose(memory.bank.P[at][np.ix_(position, position)], P, rtol=1e-6)


def test_misleading_epochs_of_plain_levels_stand_beside_those_of_separation() -> None:
    # GIVEN a street side that fails by 30 m
    groups = ("G01", "C02", "C12")
    found = [v for v, _ in stepped(OBSERVED, noisy(fault_m=30.0, groups=groups))]
    rows = np.zeros((25, 24))
    rows[:, [i for i, k in enumerate(quiet()[0].keys) if k[:3] in groups and k.endswith("C1C")]] = 30.0
    error = np.hypot(*shifts(quiet(), Disturbance(rows=rows))[1][:, :2].T)
    plain_h, _ = plain_levels([v.bound.sigma_m for v in found], CITY.risks())
    alert = np.zeros(25, dtype=bool)
    bank = stanford(error, [v.bound.hpl_m for v in found], 1e9, alert)
    assert bank.exceeded == 0
    assert stanford(error, plain_h, 1e9, alert).exceeded > 10
