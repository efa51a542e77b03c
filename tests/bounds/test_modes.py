"""Fault modes against brute force over everything that can happen."""

from itertools import combinations, product
from math import prod

import numpy as np
import pytest
from scipy.optimize import linprog

from pntegrity.bounds import Event, FaultModes, Ism, events_of, fault_modes
from pntegrity.states import rows_touched_by

SKY = ("G01", "G02", "G03", "E01", "E02", "trop", "iono", "z0")
KEYS = ("trop:ZTD", "z0:x", *(f"{s}:C1C" for s in SKY[:5]), *(f"iono:{s}" for s in SKY[:5]))


def single(name: str, p: float) -> Event:
    return Event(name, (f"{name}:*",), p, (name,))


def outcomes(events: tuple[Event, ...]) -> list[tuple[tuple[Event, ...], float]]:
    """Return all that can happen but nothing, with its probability."""
    out = []
    for happens in product((False, True), repeat=len(events)):
        p = prod(e.probability if h else 1.0 - e.probability for e, h in zip(events, happens, strict=True))
        out.append((tuple(e for e, h in zip(events, happens, strict=True) if h), p))
    return [(chosen, p) for chosen, p in out if chosen]


def rows(patterns: tuple[str, ...], keys: tuple[str, ...]) -> frozenset[str]:
    return frozenset(k for k, hit in zip(keys, rows_touched_by(patterns, keys), strict=True) if hit)


def unassigned(events: tuple[Event, ...], found: FaultModes, keys: tuple[str, ...]) -> float:
    """Return the least probability that is left when each outcome is charged to modes that leave out all its
    rows, and no mode is charged with more than its own.
    """
    happens = outcomes(events)
    spoilt = [rows(tuple(p for e in chosen for p in e.patterns), keys) for chosen, _ in happens]
    covers = [rows(m.patterns, keys) for m in found.monitored]
    pairs = [(a, m) for a, s in enumerate(spoilt) for m, c in enumerate(covers) if s <= c]
    per_outcome, per_mode = np.zeros((len(happens), len(pairs))), np.zeros((len(covers), len(pairs)))
    for k, (a, m) in enumerate(pairs):
        per_outcome[a, k] = per_mode[m, k] = 1.0
    limits = np.array([p for _, p in happens] + [m.probability for m in found.monitored])
    best = linprog(-np.ones(len(pairs)), np.vstack([per_outcome, per_mode]), limits)
    return sum(p for _, p in happens) + float(best.fun)


@pytest.mark.parametrize("threshold", [0.3, 0.1, 0.03, 1e-3, 0.0])
@pytest.mark.parametrize("p_constellation", [0.0, 0.02, 0.3])
def test_everything_that_can_happen_is_covered_or_counted(threshold: float, p_constellation: float) -> None:
    # GIVEN a sky with constellation faults, so probable that nothing is lost in rounding
    ism = Ism(
        p_sat=0.03, p_trop=0.1, p_iono=0.05, p_other=0.02, p_constellation=p_constellation,
        satellites=(("G02", 0.2),),
    )  # fmt: skip
    events = events_of(ism, SKY)
    # WHEN the modes are found
    found = fault_modes(events, 1.0, threshold, 10_000)
    # THEN what no mode can be charged with is at most what is said to be unmonitored, and that is small
    assert unassigned(events, found, KEYS) <= found.unmonitored + 1e-9
    assert found.unmonitored <= threshold


def test_no_mode_is_needless() -> None:
    events = tuple(single(f"b{i}", p) for i, p in enumerate((0.1, 0.05, 0.05, 0.01, 1e-3)))
    for threshold in (0.05, 0.01, 1e-3, 1e-5):
        found = fault_modes(events, 1.0, threshold)
        # without its last mode the bound would be above the threshold
        size = max(len(m.events) for m in found.monitored)
        last = min(m.probability for m in found.monitored if len(m.events) == size)
        assert found.unmonitored <= threshold < found.unmonitored + last


def test_the_most_probable_sets_come_first_within_a_size() -> None:
    events = tuple(single(f"b{i}", p) for i, p in enumerate((0.1, 0.05, 0.04, 0.01, 1e-3)))
    by_name = {e.name: e.probability for e in events}
    found = fault_modes(events, 1.0, 5e-3)
    pairs = [set(m.events) for m in found.monitored if len(m.events) == 2]
    ranked = sorted(combinations(by_name, 2), key=lambda c: -by_name[c[0]] * by_name[c[1]])
    assert 0 < len(pairs) < 10
    assert all(set(c) in pairs for c in ranked[: len(pairs)])


def test_a_negligible_event_goes_unmonitored() -> None:
    events = (*(single(f"b{i}", 1e-5) for i in range(5)), single("rare", 1e-10))
    found = fault_modes(events, 1e-7, 8e-8)
    assert {m.name for m in found.monitored} == {f"b{i}" for i in range(5)}
    assert found.unmonitored == pytest.approx(1e-10 + 1e-9, rel=1e-4)


def test_many_satellites_need_pairs_of_them() -> None:
    ism = Ism()
    sky = ("trop", "iono", *(f"{c}{i:02}" for c in "GE" for i in range(1, 22)))
    found = fault_modes(events_of(ism, sky), ism.p_hmi, ism.p_unmonitored, ism.max_modes)
    sizes = [len(m.events) for m in found.monitored]
    assert sizes.count(1) == 44
    assert 0 < sizes.count(2) <= 300 - 44
    assert found.unmonitored <= ism.p_unmonitored


def test_pairs_inside_a_constellation_are_counted_as_its_fault() -> None:
    ism = Ism(p_sat=1e-5, p_constellation=1e-4)
    events = events_of(ism, ("G01", "G02", "G03", "E01", "E02"))
    found = fault_modes(events, 1e-7, 1e-10)
    by_name = {m.name: m for m in found.monitored}
    assert "G01+G02" not in by_name
    assert by_name["G"].probability == pytest.approx(1e-4 + 3e-10, rel=1e-12)
    assert "E01+G01" in by_name
    assert "G+G01" not in by_name
    assert set(by_name["E01+G"].patterns) == {"G[0-9][0-9]:*", "*:G[0-9][0-9]", "E01:*", "*:E01"}


def test_a_rare_constellation_fault_does_not_take_on_all_pairs() -> None:
    ism = Ism(p_sat=1e-3, p_constellation=1.5e-4)
    found = fault_modes(events_of(ism, ("G01", "G02", "G03", "E01")), 1e-3, 1e-8)
    by_name = {m.name: m for m in found.monitored}
    assert by_name["G"].probability == pytest.approx(1.5e-4 + 1e-6)
    assert sum(name in by_name for name in ("G01+G02", "G01+G03", "G02+G03")) == 2


def test_a_budget_that_cannot_be_met_says_why() -> None:
    events = tuple(single(f"b{i}", 1e-3) for i in range(30))
    found = fault_modes(events, 1e-7, 8e-8, 50)
    assert len(found.monitored) == 50
    assert found.unmonitored >= 1e-7
    assert "50 modes" in found.reason
    assert "1e-07" in found.reason


def test_the_events_of_a_sky() -> None:
    ism = Ism(p_iono_sat=1e-6, p_constellation=1e-8, constellations=(("E", 2e-5, 0.0),))
    events = {e.name: e for e in events_of(ism, ("iono", "G05", "E11", "trop", "z0", "G05"))}
    assert set(events) == {"iono", "G05", "E11", "trop", "z0", "G"}
    assert events["G05"].probability == pytest.approx(1.1e-5)
    assert events["E11"].probability == pytest.approx(2.1e-5)
    assert rows(events["G05"].patterns, (*KEYS, "G05:L1C", "iono:G05")) == {"G05:L1C", "iono:G05"}
    assert rows(events["G"].patterns, KEYS) == {k for k in KEYS if "G0" in k}
    assert rows(events["iono"].patterns, KEYS) == {k for k in KEYS if k.startswith("iono:")}
    assert events_of(Ism(p_other=0.0), ("z0",)) == ()


def test_a_constellation_takes_no_signals_of_its_letter_from_others() -> None:
    keys = ("G05:C1C", "G05:L1C", "G05:S1C", "C05:C2I", "C05:L2I", "iono:C05", "iono:G05")
    events = {e.name: e for e in events_of(Ism(p_constellation=1e-4), ("C05", "G05", "iono"))}
    assert rows(events["C"].patterns, keys) == {"C05:C2I", "C05:L2I", "iono:C05"}


def test_without_faults_there_is_nothing_to_monitor() -> None:
    assert fault_modes((), 1e-7, 8e-8) == FaultModes((), 0.0)
