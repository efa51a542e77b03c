"""The whole driver on simulated logs: who is left out, since when, what the position does, who comes back."""

from __future__ import annotations

import numpy as np
import pytest

from gnss_logs import PLACE, groups, horizontal_m, log, navigation, only, options, run, shifted, without
from pntegrity.estimators.spp import Spp
from pntegrity.estimators.spp_kf import SppKf
from pntegrity.monitors import discover
from pntegrity.pipeline import Pipeline
from pntegrity.records import State

SYSTEMS = "GE"


def kalman(**changes):
    return SppKf(options(navigation(SYSTEMS), **changes))


def every():
    return [cls() for cls in discover().values()]


def excluded(outcomes):
    return {e.group for o in outcomes for e in o.exclusions}


@pytest.fixture(scope="module")
def clean():
    return run(kalman(), every(), log(90))


def test_without_a_fault_nothing_happens(clean):
    assert not excluded(clean)
    assert {o.status for o in clean} == {"ok"}
    assert all(o.first == o.verdicts and not o.rewound for o in clean)


@pytest.mark.parametrize("size", [15, -15])
def test_one_step_is_excluded_at_once_and_the_position_is_kept(clean, size):
    # GIVEN a clean log, WHEN one code jumps by 15 m for 20 s
    outcomes = run(kalman(), every(), log(90, f"G07 bias {size} m 40:60"))
    # THEN it alone is left out at that very epoch, with its size
    first = outcomes[40]
    assert [e.group for e in first.exclusions] == ["G07"]
    assert first.exclusions[0].size == pytest.approx(size, abs=1.0)
    assert any(v.status == "alert" for v in first.first)
    assert excluded(outcomes) == {"G07"}
    # THEN no alert remains, and the position is that of the clean log to some centimetres
    assert {o.status for o in outcomes} == {"ok"}
    assert "G07" in {k[:3] for k in outcomes[39].update.keys}
    assert not any(k.startswith("G07") for o in outcomes[40:60] for k in o.update.keys)
    for o, c in zip(outcomes, clean, strict=True):
        assert horizontal_m(o) == pytest.approx(horizontal_m(c), abs=0.5)


def test_a_slow_ramp_is_found_and_repaired_from_before_its_onset():
    # GIVEN a ramp of 0.1 m/s from 30 s on
    epochs = log(80, "G07 ramp 0.1 m/s 30:")
    outcomes = run(kalman(), every(), epochs)
    # THEN G07 alone is found, with its rate, and the past is run again
    assert excluded(outcomes) == {"G07"}
    at = next(k for k, o in enumerate(outcomes) if o.exclusions)
    found = outcomes[at]
    assert 30 < at <= 60
    assert found.rewound > 0
    assert found.exclusions[0].kind == "ramp"
    begun = at - found.rewound
    assert begun <= 32
    # THEN the filter is the one that never saw G07 since then
    other = Pipeline(kalman(), [])
    for k, epoch in enumerate(epochs[: at + 1]):
        other.push(without(epoch, ["G07"]) if k >= begun else epoch)
    mine, theirs = found.update.posterior, other.checkpoint.state
    names = [n for n in theirs.layout.names if n in mine.layout.index]
    i, j = ([s.layout.index[n] for n in names] for s in (mine, theirs))
    np.testing.assert_allclose(mine.mean[i], theirs.mean[j], rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(mine.P[np.ix_(i, i)], theirs.P[np.ix_(j, j)], rtol=0.0, atol=1e-6)
    assert np.allclose([horizontal_m(o) < 1.5 for o in outcomes[at:]], True)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_three_satellites_of_two_constellations_at_once(seed):
    faults = ("G07 bias 40 m 30:50", "E19 bias -70 m 30:50", "G10 bias 100 m 30:50")
    outcomes = run(kalman(), every(), log(70, *faults, seed=seed))
    assert {e.group for e in outcomes[30].exclusions} == {"G07", "E19", "G10"}
    assert excluded(outcomes) == {"G07", "E19", "G10"}
    sizes = {e.group: e.size for e in outcomes[30].exclusions}
    assert sizes == pytest.approx({"G07": 40.0, "E19": -70.0, "G10": 100.0}, abs=2.0)
    assert {o.status for o in outcomes} == {"ok"}
    assert max(map(horizontal_m, outcomes[5:])) < 3.0


@pytest.mark.parametrize("left", [10, 8])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_with_few_satellites_the_set_is_exact_or_the_ambiguity_is_said(left, seed):
    # GIVEN few satellites, WHEN three of two constellations jump by 40 to 100 m at once
    faulty = {"G07": 40.0, "E19": -70.0, "G10": 100.0}
    epochs = log(60, *(f"{g} bias {size} m 30:" for g, size in faulty.items()), seed=seed)
    others = ["G05", "E16", "G24", "E21", "G02", "E04", "G09", "E22", "G06", "E23"]
    seen = [*faulty, *[g for g in others if g in groups(epochs[0])]][:left]
    assert len(seen) == left
    outcomes = run(kalman(), every(), [only(e, seen) for e in epochs])
    # THEN exactly these are left out, or the pipeline says that others would explain the data as well
    exact = {e.group for e in outcomes[30].exclusions} == set(faulty)
    assert exact or "ambiguous" in outcomes[30].reason or outcomes[30].status == "alert"
    if exact:
        assert max(map(horizontal_m, outcomes[30:])) < 3.0


def test_a_jump_that_all_satellites_share_is_the_clock_and_nobody_is_blamed():
    # GIVEN a receiver clock that jumps by 25 m at 30 s
    epochs = [shifted(e, 25.0) if k >= 30 else e for k, e in enumerate(log(60))]
    outcomes = run(kalman(), every(), epochs)
    # THEN nothing is excluded, the jump is told, and the position does not move
    assert not excluded(outcomes)
    assert any("clock" in event for event in outcomes[30].update.events) or outcomes[30].reason
    assert max(map(horizontal_m, outcomes[5:])) < 1.5


def test_a_drift_that_all_codes_share_is_an_alert_with_a_reason():
    # GIVEN codes that all run away from the range rates, by 2 m/s
    epochs = [shifted(e, 2.0 * max(k - 30, 0)) for k, e in enumerate(log(60))]
    outcomes = run(kalman(), every(), epochs)
    # THEN nobody is excluded; it is told, or an alert with its reason
    assert not excluded(outcomes)
    told = [o for o in outcomes[30:45] if (o.status == "alert" and o.reason) or o.update.events]
    assert told
    assert max(map(horizontal_m, outcomes[5:])) < 1.5


def test_an_alert_that_nothing_resolves_starts_the_filter_anew():
    # GIVEN exclusion that may leave nobody out, WHEN a fault lasts
    epochs = log(80, "G07 bias 60 m 30:")
    outcomes = run(kalman(), every(), epochs, keep_rows=99, restart_s=20.0, restart_epochs=20)
    # THEN the alert has a reason, and after 20 s the filter starts anew
    assert not excluded(outcomes)
    assert outcomes[30].status == "alert"
    assert outcomes[30].reason == "too few measurements would be left"
    at = next(k for k, o in enumerate(outcomes) if "starts anew" in o.reason)
    assert at == 50
    assert "start" in outcomes[51].update.events
    assert not outcomes[51].update.F.any()


def test_a_satellite_comes_back_after_its_proof_and_not_before():
    # GIVEN a fault from 20 s to 30 s, WHEN the proof lasts 15 s
    outcomes = run(kalman(), every(), log(80, "G07 bias 40 m 20:30"), proof_s=15.0)
    back = next(k for k, o in enumerate(outcomes) if "G07" in o.readmitted)
    # THEN it is out while its residuals are large and 15 s longer, and used from the next epoch on
    assert 45 <= back <= 60
    assert all("G07" not in {k[:3] for k in o.update.keys} for o in outcomes[20 : back + 1])
    assert all("G07" in {k[:3] for k in o.update.keys} for o in outcomes[back + 1 :])
    assert excluded(outcomes[back:]) == set()


def test_a_second_offence_needs_twice_the_proof():
    outcomes = run(kalman(), every(), log(140, "G07 bias 40 m 10:15", "G07 bias 40 m 50:55"), proof_s=10.0)
    away = [o.t_ns for o in outcomes if any(e.group == "G07" for e in o.exclusions)]
    back = [o.t_ns for o in outcomes if "G07" in o.readmitted]
    assert len(away) == len(back) == 2
    first, second = ((b - a) * 1e-9 - 5.0 for a, b in zip(away, back, strict=True))
    assert first == pytest.approx(10.0, abs=5.0)
    assert second == pytest.approx(20.0, abs=5.0)


def test_a_satellite_that_went_out_of_view_is_forgotten():
    epochs = [
        without(e, ["G07"]) if 24 <= k < 40 else e for k, e in enumerate(log(60, "G07 bias 40 m 20:30"))
    ]
    outcomes = run(kalman(), every(), epochs, forget_s=10.0)
    assert "G07" in {g for o in outcomes[33:36] for g in o.readmitted}
    assert all("G07" in {k[:3] for k in o.update.keys} for o in outcomes[40:])


def test_monitors_may_speak_without_anything_being_left_out():
    outcomes = run(kalman(), every(), log(60, "G07 bias 40 m 30:"), exclude=False)
    assert not excluded(outcomes)
    assert outcomes[30].status == "alert"
    assert any(v.suspect_groups == ("G07",) for v in outcomes[30].verdicts)
    assert all("G07:C1C" in o.update.keys for o in outcomes)
    assert all(not o.rewound and o.first == o.verdicts for o in outcomes)


def test_the_snapshot_finds_one_bad_satellite_of_many():
    estimator = Spp(options(navigation(SYSTEMS)))
    outcomes = run(estimator, [discover()["rctm"]()], log(40, "G07 bias 60 m 20:30"))
    assert excluded(outcomes[:20]) == set()
    assert {e.group for e in outcomes[20].exclusions} == {"G07"}
    assert max(map(horizontal_m, outcomes)) < 3.0


@pytest.mark.parametrize("metres", [1e3, 1e5])
def test_an_excluded_blunder_leaves_nothing_in_the_snapshot(metres):
    epochs = log(3)
    spp = Spp(options(navigation(SYSTEMS)))
    for epoch in epochs:
        blunder = log(3, f"G07 bias {metres:.0f} m 0:")[epochs.index(epoch)]
        got = spp.correct(spp.predict(State.empty(), blunder), blunder, frozenset(["G07"])).posterior.mean
        gone = without(epoch, ["G07"])
        wanted = spp.correct(spp.predict(State.empty(), gone), gone).posterior.mean
        np.testing.assert_allclose(got[:6], wanted[:6], atol=1e-4)


def test_a_relaxed_epoch_stays_relaxed_when_the_past_is_run_again():
    # GIVEN a slow ramp, and a receiver clock that jumps while it grows
    epochs = [shifted(e, 25.0) if k >= 34 else e for k, e in enumerate(log(75, "G07 ramp 0.15 m/s 30:"))]
    outcomes = run(kalman(), every(), epochs)
    # THEN the ramp's satellite alone is left out, and the position is kept
    assert excluded(outcomes) == {"G07"}
    repair = next(o for o in outcomes if o.rewound)
    if any(u.t_ns == epochs[34].t_ns for u in repair.updates):
        again = next(u for u in repair.updates if u.t_ns == epochs[34].t_ns)
        assert again.events == outcomes[34].update.events
    assert max(horizontal_m(o) for o in outcomes[5:]) < 2.0
    assert np.linalg.norm(outcomes[-1].update.posterior.mean[:3] - PLACE) < 2.0


@pytest.mark.parametrize("make", [SppKf, Spp])
def test_a_blunder_of_kilometres_at_the_start_costs_its_satellite_only(make):
    outcomes = run(make(options(navigation(SYSTEMS))), every(), log(5, "G07 bias 5 km 0:"))
    assert excluded(outcomes) == {"G07"}


@pytest.mark.parametrize("km", [5, 300, 3000])
def test_a_blunder_of_kilometres_later_costs_its_satellite_only(km):
    outcomes = run(kalman(), every(), log(25, f"G07 bias {km} km 15:20"))
    assert excluded(outcomes) == {"G07"}
    assert max(map(horizontal_m, outcomes[5:])) < 1.5


def test_a_blunder_at_the_start_leaves_nothing_in_the_filter():
    # GIVEN a start around a fix that is kilometres off, WHEN its cause is excluded
    faulty, gone = log(3, "G07 bias 20 km 0:")[0], without(log(3)[0], ["G07"])
    kf = kalman()
    got = kf.correct(kf.predict(State.empty(), faulty), faulty, frozenset(["G07"])).posterior
    wanted = kf.correct(kf.predict(State.empty(), gone), gone).posterior
    # THEN the filter starts as if it had never been there
    np.testing.assert_allclose(got.mean[:8], wanted.mean[:8], atol=1e-4)
