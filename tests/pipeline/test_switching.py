"""Going over to a subfilter: after an exclusion the filter is one that never knew the group."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rtk_logs
import test_ppp

from gnss_logs import PLACE, fingerprint, log, navigation, options, run, without
from pntegrity.bounds.ism import Ism
from pntegrity.estimators.spp_kf import SppKf
from pntegrity.exclusion import Policy
from pntegrity.formats.update_record import read_record, write_record
from pntegrity.monitors import discover
from pntegrity.monitors.separation import Separation
from pntegrity.pipeline import Outcome, Pipeline
from pntegrity.protocols import Estimator
from pntegrity.records import Epoch, State
from pntegrity.replay import monitored
from pntegrity.report.write import entries
from pntegrity.simulate.faults import apply_faults, parse_fault

AT, STEP = 15, 30


def precise(name: str, n: int = 30) -> tuple[Estimator, list[Epoch]]:
    """Return an estimator of carriers and a clean log of half-minute epochs."""
    if name == "ppp":
        return test_ppp.ppp(), list(test_ppp.log(60)[0])[:n]
    return rtk_logs.rtk(), list(rtk_logs.simulated(40).epochs[:n])


def faulty(epochs: Sequence[Epoch], *faults: str) -> list[Epoch]:
    return apply_faults(epochs, [parse_fault(f) for f in faults])


def gone(epoch: Epoch, groups: Sequence[str]) -> Epoch:
    for g in groups:
        epoch = rtk_logs.absent(epoch, g)
    return epoch


def never(estimator: Estimator, epochs: Sequence[Epoch], groups: Sequence[str]) -> list[Outcome]:
    """Return the run of a filter to which some groups were never there."""
    return run(estimator, [Separation()], [gone(e, groups) for e in epochs], exclude=False)


def pushed(estimator: Estimator, epochs: Sequence[Epoch], **policy: Any) -> list[Outcome]:
    return run(estimator, [Separation()], epochs, **policy)


def excluded(outcomes: Sequence[Outcome]) -> list[tuple[int, str]]:
    return [(k, e.group) for k, o in enumerate(outcomes) for e in o.exclusions]


def apart(a: State, b: State) -> tuple[float, float]:
    """Return how far two positions are apart in standard deviations, and their sigmas."""
    (x, P), (y, Q) = a.block("pos"), b.block("pos")
    sigma = np.sqrt(np.diagonal(Q))
    return float(np.abs((x - y) / sigma).max()), float(np.abs(np.sqrt(np.diagonal(P)) / sigma - 1.0).max())


# --- a member without a group is the filter without it


@pytest.mark.parametrize(
    ("name", "group"),
    [("ppp_rtk", "G07"), ("ppp_rtk", "E19"), ("ppp", "G07"), ("spp_kf", "G07"), ("spp_kf", "E19")],
)
def test_a_subfilter_is_the_filter_that_never_had_the_group(name: str, group: str) -> None:
    # GIVEN a clean log, and the same without a satellite
    estimator, epochs = (SppKf(options(navigation())), log(40)) if name == "spp_kf" else precise(name)
    others = never(estimator, epochs, [group])
    monitor = Separation()
    state, memory, moves = State.empty(), monitor.start(), 0.0
    for epoch, other in zip(epochs, others, strict=True):
        update = estimator.correct(estimator.predict(state, epoch), epoch)
        state = update.posterior
        _, memory = monitor.step(memory, update)
        # THEN the member has its sigma, to rounding, and its position to what the other place of
        # linearisation makes of it: d^2 / 2r at a distance d from another, a few millimetres at a start
        position, sigma = apart(monitor.subfilter(memory, state, frozenset([group])), other.update.posterior)
        assert position < 0.02
        assert sigma < 1e-5
        moves = max(moves, apart(state, other.update.posterior)[0])
    assert moves > 0.2  # and that is not the filter itself


def test_of_unknown_groups_and_of_another_epoch_there_is_no_subfilter() -> None:
    estimator, epochs = precise("ppp_rtk", 3)
    outcomes = pushed(estimator, epochs)
    monitor, state = Separation(), outcomes[-1].update.posterior
    memory = monitor.start()
    assert monitor.subfilter(memory, state, frozenset(["G07"])) is state
    for o in outcomes:
        _, memory = monitor.step(memory, o.update)
    assert max(apart(monitor.subfilter(memory, state, frozenset(["X99"])), state)) < 1e-8
    assert (
        monitor.subfilter(memory, outcomes[0].update.posterior, frozenset(["G07"]))
        is outcomes[0].update.posterior
    )


# --- after an exclusion


@lru_cache(maxsize=4)
def one_fault(size: float = 5.0, name: str = "ppp_rtk") -> tuple[list[Epoch], list[Outcome]]:
    """A satellite clock that jumps for two and a half minutes."""
    estimator, epochs = precise(name)
    shown = faulty(epochs, f"G07:* bias {size} m {AT * STEP}:{(AT + 5) * STEP}")
    return shown, pushed(estimator, shown, proof_s=1e4)


@pytest.mark.parametrize("name", ["ppp_rtk", "ppp"])
@pytest.mark.parametrize("size", [5.0, -40.0])
def test_from_the_first_faulty_epoch_on_the_filter_is_one_that_never_knew_it(size: float, name: str) -> None:
    epochs, outcomes = one_fault(size, name)
    assert excluded(outcomes) == [(AT, "G07")]
    first = outcomes[AT]
    assert first.update.switched == ("G07",)
    assert first.first[0].status == "alert"
    assert {o.status for o in outcomes} == {"ok"}
    assert all(e.switch for e in first.exclusions)
    assert not any(o.rewound for o in outcomes)
    assert not any(o.update.switched for o in outcomes if o is not first)
    others = never(precise(name)[0], epochs, ["G07"])
    for o, other in zip(outcomes[AT:], others[AT:], strict=True):
        position, sigma = apart(o.update.posterior, other.update.posterior)
        assert position < 0.02
        assert sigma < 1e-5


def test_levels_go_on_and_are_those_of_the_filter_that_never_knew_it() -> None:
    epochs, outcomes = one_fault()
    others = never(precise("ppp_rtk")[0], epochs, ["G07"])
    for k, (o, other) in enumerate(zip(outcomes, others, strict=True)):
        mine, theirs = o.verdicts[0].bound, other.verdicts[0].bound
        assert mine is not None
        assert theirs is not None
        assert mine.since_ns == epochs[0].t_ns
        assert np.isfinite(mine.hpl_m)
        if k >= AT:  # the satellite that is left out stays a mode until its past moves nothing any more
            assert mine.hpl_m == pytest.approx(theirs.hpl_m, rel=0.02)
            assert mine.vpl_m == pytest.approx(theirs.vpl_m, rel=0.02)
    before, after = (outcomes[k].verdicts[0].bound for k in (AT - 1, AT))
    assert before is not None
    assert after is not None
    assert after.hpl_m < 1.5 * before.hpl_m


def test_errors_stay_inside_the_levels_all_along() -> None:
    for size in (5.0, -40.0):
        _, outcomes = one_fault(size)
        for o in outcomes:
            bound, (x, _) = o.verdicts[0].bound, o.update.posterior.block("pos")
            assert bound is not None
            assert np.linalg.norm(x - PLACE) < np.hypot(bound.hpl_m, bound.vpl_m)


def test_nominal_biases_go_on_after_an_exclusion() -> None:
    epochs, _ = one_fault()
    biased = Separation(ism=Ism(b_code_m=0.5, b_carrier_m=0.01))
    estimator = precise("ppp_rtk")[0]
    mine = run(estimator, [biased], epochs, proof_s=1e4)
    theirs = run(estimator, [biased], [gone(e, ["G07"]) for e in epochs], exclude=False)
    assert excluded(mine) == [(AT, "G07")]
    levels = [(a.verdicts[0].bound, b.verdicts[0].bound) for a, b in zip(mine[AT:], theirs[AT:], strict=True)]
    assert all(a is not None and b is not None and a.hpl_m > 0.98 * b.hpl_m for a, b in levels)


def test_after_a_second_exclusion_no_subfilter_knows_what_the_filter_does_not() -> None:
    estimator, epochs = precise("ppp_rtk", 20)
    pipeline = Pipeline(estimator, [Separation()], Policy(proof_s=1e4))
    outcomes = [pipeline.push(e) for e in faulty(epochs, "G07:* bias 5 m 300:", "E19:* bias 4 m 510:")]
    assert excluded(outcomes) == [(10, "G07"), (17, "E19")]
    memory = pipeline.checkpoint.memories[0]
    at = memory.layout.block("pos")
    P = memory.bank.P[:, at[:, None], at]
    least = np.linalg.eigvalsh(P - P[:1]).min(axis=1) / np.trace(P[0])
    assert least[~memory.loose].min() > -1e-6
    # but for those that are known to be no part of it: of their separations a bound is taken
    assert memory.loose.any()


def test_of_three_faults_one_after_another_the_levels_hold_since_the_beginning() -> None:
    estimator, epochs = precise("ppp_rtk")
    faults = ("G07:* bias 5 m 300:", "E19:* bias 4 m 510:", "G10:* bias -6 m 690:")
    outcomes = pushed(estimator, faulty(epochs, *faults), proof_s=1e4)
    assert excluded(outcomes) == [(10, "G07"), (17, "E19"), (23, "G10")]
    assert {o.status for o in outcomes} == {"ok"}
    # WHEN two were left out, the filter is one that never knew them
    others = never(estimator, epochs, ["G07", "E19"])
    position, sigma = apart(outcomes[22].update.posterior, others[22].update.posterior)
    assert position < 0.02
    assert sigma < 1e-5
    # THEN levels cover faults since the beginning, and do not fall where an exclusion is made
    levels = [o.verdicts[0].bound for o in outcomes]
    assert {b.since_ns for b in levels} == {epochs[0].t_ns}
    for k in (10, 17, 23):
        assert levels[k].hpl_m > 0.9 * levels[k - 1].hpl_m
        assert levels[k].vpl_m > 0.9 * levels[k - 1].vpl_m


def test_a_second_exclusion_leaves_the_filter_that_never_knew_either() -> None:
    estimator, epochs = precise("ppp_rtk", 20)
    outcomes = pushed(estimator, faulty(epochs, "G07:* bias 5 m 300:", "E19:* bias 4 m 510:"), proof_s=1e4)
    assert excluded(outcomes) == [(10, "G07"), (17, "E19")]
    position, sigma = apart(
        outcomes[-1].update.posterior, never(estimator, epochs, ["G07", "E19"])[-1].update.posterior
    )
    assert position < 0.02
    assert sigma < 1e-5


def test_two_at_once_leave_the_filter_that_never_knew_both() -> None:
    estimator, epochs = precise("ppp_rtk")
    outcomes = pushed(estimator, faulty(epochs, "G07:* bias 5 m 450:", "E19:* bias -8 m 450:"), proof_s=1e4)
    assert sorted(g for _, g in excluded(outcomes)) == ["E19", "G07"]
    assert {k for k, _ in excluded(outcomes)} == {15}
    others = never(estimator, epochs, ["G07", "E19"])
    position, sigma = apart(outcomes[-1].update.posterior, others[-1].update.posterior)
    assert position < 0.02
    assert sigma < 1e-5


def test_a_product_is_left_out_since_ever_and_the_satellite_stays() -> None:
    estimator, epochs = precise("ppp_rtk")
    outcomes = pushed(estimator, faulty(epochs, "trop:* bias 3 m 450:"), proof_s=1e4)
    assert excluded(outcomes) == [(15, "trop")]
    others = run(estimator, [], [rtk_logs.without_products(e, "trop") for e in epochs])
    position, sigma = apart(outcomes[-1].update.posterior, others[-1].update.posterior)
    assert position < 0.02
    assert sigma < 1e-5


# --- coming back


def test_a_satellite_whose_clock_was_off_for_a_while_returns_after_its_proof() -> None:
    estimator, epochs = precise("ppp_rtk", 40)
    outcomes = pushed(estimator, faulty(epochs, "G07:* bias 5 m 300:390"), proof_s=120.0, proof_epochs=4)
    assert excluded(outcomes) == [(10, "G07")]
    assert [k for k, o in enumerate(outcomes) if "G07" in o.readmitted]


def test_a_satellite_whose_clock_stays_off_does_not_return() -> None:
    estimator, epochs = precise("ppp_rtk")
    outcomes = pushed(estimator, faulty(epochs, "G07:* bias 30 m 300:"))
    assert excluded(outcomes) == [(10, "G07")]
    assert not any(o.readmitted for o in outcomes)


def test_in_the_kalman_filter_a_second_offence_is_a_second_switch() -> None:
    estimator = SppKf(options(navigation()))
    epochs = log(140, "G07 bias 40 m 10:15", "G07 bias 40 m 60:65")
    outcomes = run(estimator, [Separation()], epochs, proof_s=10.0)
    assert [g for _, g in excluded(outcomes)] == ["G07", "G07"]
    assert [k for k, o in enumerate(outcomes) if o.update.switched] == [10, 60]
    assert len([k for k, o in enumerate(outcomes) if "G07" in o.readmitted]) == 2


# --- records, other monitors, repairs


def test_the_record_keeps_where_the_filter_went_over_and_gives_the_verdicts_again(tmp_path: Path) -> None:
    _, outcomes = one_fault()
    write_record(tmp_path / "updates.npz", entries(outcomes))
    again = list(read_record(tmp_path / "updates.npz"))
    updates = [u for u, _ in again]
    assert [u.switched for u in updates] == [o.update.switched for o in outcomes]
    replayed = list(monitored(again, [Separation()]))
    assert [tuple(v) for _, v in replayed] == [o.verdicts for o in outcomes]


@pytest.mark.parametrize("cut", [AT, AT + 1])
def test_resumed_at_the_switch_it_is_the_same_run(cut: int) -> None:
    epochs, outcomes = one_fault()
    policy = Policy(proof_s=1e4)
    pipeline = Pipeline(precise("ppp_rtk")[0], [Separation()], policy)
    for k, epoch in enumerate(epochs):
        if k == cut:
            kept = pickle.loads(pickle.dumps(pipeline.checkpoint))
            pipeline = Pipeline(precise("ppp_rtk")[0], [Separation()], policy, kept)
        assert fingerprint(pipeline.push(epoch)) == fingerprint(outcomes[k])


def test_other_monitors_begin_anew_at_a_switch_and_separation_goes_on() -> None:
    epochs, _ = one_fault()
    names = ("separation", "srctm", "aime", "glr")
    outcomes = run(precise("ppp_rtk")[0], [discover()[n]() for n in names], epochs, proof_s=1e4)
    at = next(k for k, o in enumerate(outcomes) if o.update.switched)
    assert at == AT
    of = {v.monitor: v for v in outcomes[at].verdicts}
    assert of["separation"].status == "ok"
    # what a windowed test says is what it says of the updates from there on
    alone = run_of(discover()["aime"](), [o.update for o in outcomes[at:]])
    assert [v for o in outcomes[at:] for v in o.verdicts if v.monitor == "aime"] == alone
    bound = of["separation"].bound
    assert bound is not None
    assert bound.since_ns == epochs[0].t_ns


def run_of(monitor: Any, updates: Sequence[Any]) -> list[Any]:
    memory, out = monitor.start(), []
    for u in updates:
        verdict, memory = monitor.step(memory, u)
        out.append(verdict)
    return out


def test_a_repair_of_the_past_begins_the_bank_anew_there() -> None:
    # GIVEN a slow ramp that a windowed monitor dates back
    epochs = log(90, "G07 ramp 0.1 m/s 30:")
    estimator = SppKf(options(navigation()))
    outcomes = run(estimator, [Separation(), discover()["glr"]()], epochs)
    repair = next(o for o in outcomes if o.rewound)
    bound = repair.verdicts[0].bound
    assert bound is not None
    # THEN levels cover faults from there on, and say so
    assert bound.since_ns == repair.updates[0].t_ns > epochs[0].t_ns
    assert np.isfinite(bound.hpl_m)
    later = outcomes[-1].verdicts[0].bound
    assert later is not None
    assert later.since_ns == bound.since_ns


# --- who is at fault

FAULTS = [(g, size) for g in ("G07", "G10", "E19", "E16", "G24", "E21") for size in (1.5, 3.0, -8.0)]


def test_the_re_test_names_the_right_one_more_often_than_the_largest_separation() -> None:
    # GIVEN each of six satellites with three sizes, on two logs
    right = {"exact": 0, "published": 0}
    alerts = 0
    for seed in (1, 2):
        epochs = list(rtk_logs.simulated(14, seed=seed).epochs)
        estimator, state = rtk_logs.rtk(), State.empty()
        monitors = {v: Separation(variant=v) for v in right}  # type: ignore[arg-type]
        memory = {v: m.start() for v, m in monitors.items()}
        for e in epochs[:-1]:
            update = estimator.correct(estimator.predict(state, e), e)
            state = update.posterior
            memory = {v: m.step(memory[v], update)[1] for v, m in monitors.items()}
        prior = estimator.predict(state, epochs[-1])
        clean = estimator.correct(prior, epochs[-1])
        for group, size in FAULTS:
            f = np.array([size * (k.startswith(group)) for k in clean.keys])
            update = replace(clean.altered(nu=clean.nu + f), posterior=moved(clean.posterior, clean.K @ f))
            verdicts = {v: m.step(memory[v], update)[0] for v, m in monitors.items()}
            if verdicts["exact"].status != "alert":
                continue
            alerts += 1
            for v in right:
                right[v] += verdicts[v].suspect_groups == (group,)
    # THEN the re-test is right in nearly all of them, and the published rule in fewer
    assert alerts >= 25
    assert right["exact"] >= 0.97 * alerts, (right, alerts)
    assert right["published"] < right["exact"], (right, alerts)


def moved(state: State, by: np.ndarray) -> State:
    return replace(state, mean=state.mean + by)


def test_an_epoch_without_the_satellite_that_was_left_out_changes_nothing() -> None:
    epochs, outcomes = one_fault()
    shown = [without(e, ["G07"]) if k > AT + 3 else e for k, e in enumerate(epochs)]
    again = pushed(precise("ppp_rtk")[0], shown, proof_s=1e4)
    position, _ = apart(again[-1].update.posterior, outcomes[-1].update.posterior)
    assert position < 1e-6
