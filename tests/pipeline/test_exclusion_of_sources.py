"""Sources and their sensors: left out by name, run again without, proved, and back."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from pntegrity.bounds.ism import Ism
from pntegrity.config import make_monitor
from pntegrity.exclusion import Policy, decide
from pntegrity.kernels.source_test import left_out
from pntegrity.monitors.separation import Separation
from pntegrity.pipeline import Pipeline
from pntegrity.proving import is_due
from pntegrity.records import Layout, Prior, State, Suspect, Update, Verdict
from pntegrity.replay import monitored
from pntegrity.scenarios._vessel_logs import estimator, ship, ship_log
from pntegrity.simulate.vessel_log import with_faults
from pntegrity.states import group_of, is_left_out, sensor_of

SECONDS, BEGIN, END = 90, 40, 60
BEACON = ("lbl:R.AP1", 0.006, 0.0, BEGIN, END)


@lru_cache(maxsize=8)
def log(*faults):
    return with_faults(log(), faults) if faults else ship_log(ship(SECONDS, 1.0), 11)


def pipeline(of, **changes):
    model = estimator(of, ship(SECONDS, 1.0).spec)
    monitors = [make_monitor(n, 1e-6) for n in ("source_separation", "sensor_window")]
    return Pipeline(model, monitors, Policy(**(dict(model.policy) | changes)))


@lru_cache(maxsize=8)
def run(*faults, proof="trial"):
    driver = pipeline(log(*faults), proof=proof)
    return [driver.push(e) for e in log(*faults).epochs]


def second(t_ns):
    return round((t_ns - log().motion.span_ns[0]) * 1e-9, 3)


def times_of(outcomes, what):
    return [(second(o.t_ns), name) for o in outcomes for name in what(o)]


def test_without_a_fault_nobody_is_left_out():
    assert not times_of(run(), lambda o: [e.group for e in o.exclusions])
    assert {o.status for o in run()} == {"ok"}


def test_one_beacon_goes_at_once_and_its_source_goes_on():
    outcomes = run(BEACON)
    assert times_of(outcomes, lambda o: [e.group for e in o.exclusions]) == [(BEGIN, "lbl.AP1")]
    during = [o for o in outcomes if BEGIN <= second(o.t_ns) < END]
    for o in during:
        assert o.update.excluded == ("lbl.AP1",)
        assert o.update.spare_keys == ("lbl:R.AP1",)
        assert {sensor_of(k) for k in o.update.keys if group_of(k) == "lbl"} == {"AP2", "AP3", "AP4"}


def test_it_comes_back_after_a_trial_of_stated_risk_and_never_during_the_fault():
    outcomes = run(BEACON)
    back = times_of(outcomes, lambda o: o.readmitted)
    assert [name for _, name in back] == ["lbl.AP1"]
    assert END < back[0][0] <= END + 6
    (passed,) = [p for o in outcomes for p in o.proofs if p.passed]
    assert passed.t_ns == next(o.t_ns for o in outcomes if o.readmitted)
    assert passed.statistic <= passed.limit
    assert passed.readmission <= Policy().p_readmit


def test_a_fault_that_never_ends_never_returns():
    forever = (*BEACON[:4], SECONDS + 1)
    assert not times_of(run(forever), lambda o: o.readmitted)


def test_by_passes_it_returns_after_five_in_a_row():
    outcomes = run(BEACON, proof="passes")
    ((back_s, _),) = times_of(outcomes, lambda o: o.readmitted)
    counts = [p.epochs for o in outcomes for p in o.proofs if second(o.t_ns) <= back_s]
    assert counts[-5:] == [1, 2, 3, 4, 5]
    assert back_s >= END + 4


def test_a_ramp_is_followed_back_to_before_it_was_seen():
    outcomes = run(("lbl:R.AP1", 0.0, 8e-4, BEGIN, END))
    made = next(o for o in outcomes if o.exclusions)
    first = second(made.updates[0].t_ns)
    assert made.rewound > 0
    assert first <= BEGIN + 3 < second(made.t_ns)
    out = frozenset(["lbl.AP1"])
    model = estimator(log(), ship(SECONDS, 1.0).spec)
    state, again = made.updates[0].prior, None
    for e in [e for e in log(("lbl:R.AP1", 0.0, 8e-4, BEGIN, END)).epochs if first <= second(e.t_ns)]:
        prior = (
            model.predict(state, e)
            if again is not None
            else Prior(made.updates[0].prior, made.updates[0].F, made.updates[0].Q)
        )
        again = model.correct(prior, e, out)
        state = again.posterior
        if e.t_ns == made.t_ns:
            break
    assert again is not None
    np.testing.assert_allclose(again.posterior.P, made.update.posterior.P, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(again.posterior.mean, made.update.posterior.mean, atol=1e-8)


def test_the_position_is_as_good_as_without_the_fault():
    truth = log().truth.position_m

    def error(outcomes):
        return np.array([o.update.posterior.mean[:3] for o in outcomes]) - truth

    at = slice(BEGIN, END)
    healthy, isolated = error(run())[at], error(run(BEACON))[at]
    assert np.sqrt((isolated**2).sum(1).mean()) <= 1.2 * np.sqrt((healthy**2).sum(1).mean())


class Says:
    """A monitor that alarms where it gets a row while that is off, and tells what it is given."""

    name, variant = "source_separation", "exact"

    def __init__(self, told):
        self.told = told

    def start(self):
        return 0

    def step(self, memory, update):
        off = "lbl:R.AP1" in update.keys and BEGIN <= second(update.t_ns) < END
        suspects, ambiguous = self.told(second(update.t_ns))
        onset_ns = log().motion.span_ns[0] + BEGIN * 1_000_000_000
        kept = tuple(replace(s, onset_ns=onset_ns) for s in suspects) if off else ()
        facts = ("alert", 30.0, 20.0) if off else ("ok", 1.0, 20.0)
        return Verdict(self.name, self.variant, update.t_ns, *facts, 1e-6, 1, kept, ambiguous and off), 0


def doubted(then):
    """Run a log with a fault of which one says at first that two may have it, and later something else."""
    first = (of("lbl", sensors=("AP1",)), of("usbl", "gnss"))
    made = log(BEACON)
    model = estimator(made, ship(SECONDS, 1.0).spec)
    says = Says(lambda t: (then, False) if t >= BEGIN + 8 else (first, True))
    driver = Pipeline(model, [says], Policy(**model.policy))
    return [driver.push(e) for e in made.epochs]


def test_who_was_left_out_in_doubt_is_named_once_the_doubt_is_gone():
    outcomes = doubted((of("lbl", sensors=("AP1",)),))
    at = {second(o.t_ns): o for o in outcomes}
    assert at[BEGIN + 1].status == "alert"
    assert "others could be" in at[BEGIN + 2].reason
    assert {at[t].status for t in range(BEGIN + 10, END)} == {"ok"}
    assert times_of(outcomes, lambda o: [e.group for e in o.exclusions]) == [(BEGIN, "lbl.AP1")]


def test_a_better_explanation_takes_the_place_of_one_in_doubt():
    outcomes = doubted((of("lbl"),))
    made = times_of(outcomes, lambda o: [e.group for e in o.exclusions])
    back = times_of(outcomes, lambda o: o.readmitted)
    assert made[0] == (BEGIN, "lbl.AP1")
    assert made[1][1] == "lbl"
    assert (made[1][0], "lbl.AP1") in back
    swapped = next(o for o in outcomes if second(o.t_ns) == made[1][0])
    assert swapped.update.excluded == ("lbl",)
    assert swapped.rewound > 0


def test_levels_go_on_over_a_repair_and_the_record_gives_the_same_verdicts():
    made = log(("lbl:R.AP1", 0.0, 8e-4, BEGIN, END))
    model = estimator(made, ship(SECONDS, 1.0).spec)
    bank = Separation(1e-6, ism=Ism(p_other=1e-4), pairs=False, levels="observed")
    monitors = [make_monitor("source_separation", 1e-6), bank]
    driver = Pipeline(model, monitors, Policy(**model.policy))
    outcomes = [driver.push(e) for e in made.epochs]
    repaired = next(i for i, o in enumerate(outcomes) if o.rewound)
    bounds = [o.verdicts[1].bound for o in outcomes[repaired - 1 : repaired + 1]]
    assert bounds[1].since_ns == bounds[0].since_ns
    assert bounds[1].hpl_m > 0.9 * bounds[0].hpl_m
    entries = [(u, o.rewound if i == 0 else 0) for o in outcomes for i, u in enumerate(o.updates)]
    again = {update.t_ns: verdicts for update, verdicts in monitored(entries, monitors)}
    replaced = {u.t_ns for o in outcomes for u in o.updates[:-1]}
    assert replaced
    for o in (o for o in outcomes if o.t_ns not in replaced):
        assert again[o.t_ns][1].bound == o.verdicts[1].bound


# --- the decision -------------------------------------------------------------------------------------------

KEYS = ("a:R.1", "a:R.2", "b:R.1", "b:R.2")
IDENTIFYING = Policy(identifying=("source_separation", "sensor_window"), trust_prior=True, keep_rows=0)


def update(nu=(0.0, 0.0, 0.0, 0.0), R=None):
    prior = Prior(State(10, np.zeros(2), np.eye(2), Layout(("pos:x", "pos:y"))), np.eye(2), np.zeros((2, 2)))
    H = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 0.0], [0.0, 1.0]])
    return Update.of(prior, KEYS, np.array(nu), H, np.eye(4) if R is None else R)


def says(monitor, *suspects, ambiguous=False):
    return Verdict(monitor, "exact", 10, "alert", 30.0, 20.0, 1e-6, 1, suspects, ambiguous)


def names(verdicts):
    return [e.group for e in decide(update(), verdicts, IDENTIFYING, 5).exclusions]


def of(*groups, sensors=()):
    return Suspect(groups, "bias", 3.0, 8, 30.0, sensors)


def test_sensors_are_left_out_where_their_source_has_others():
    assert names([says("source_separation", of("a", sensors=("1",)))]) == ["a.1"]
    assert names([says("source_separation", of("a", sensors=("1", "2")))]) == ["a"]
    assert names([says("source_separation", of("a", "b"))]) == ["a", "b"]


def test_the_sensor_level_tells_which_part_of_a_source():
    both = [says("source_separation", of("a")), says("sensor_window", of("a", sensors=("2",)))]
    assert names(both) == ["a.2"]


def test_an_ambiguous_verdict_leaves_nobody_out_and_says_who_may_be_at_fault():
    found = decide(
        update((9.0, 9.0, 0.0, 0.0)),
        [says("source_separation", of("a"), of("b"), ambiguous=True)],
        IDENTIFYING,
        5,
    )
    assert not found.exclusions
    assert "a or b" in found.reason


def test_the_source_level_has_the_word_on_sources():
    unsure = says("source_separation", of("a"), of("b"), ambiguous=True)
    sure = says("sensor_window", of("b", sensors=("1",)))
    silent = replace(sure, monitor="source_separation", status="ok", suspects=())
    assert names([sure, unsure]) == []
    assert names([sure, silent]) == []
    assert names([sure]) == ["b.1"]  # it works alone
    assert "tells no source" in decide(update(), [sure, silent], IDENTIFYING, 5).reason


def test_where_all_others_need_more_sources_at_fault_the_first_goes_in_doubt():
    verdict = says("source_separation", of("a", sensors=("1",)), of("b", "c"), ambiguous=True)
    found = decide(update((9.0, 9.0, 0.0, 0.0)), [verdict], IDENTIFYING, 5)
    assert [(e.group, e.doubtful) for e in found.exclusions] == [("a.1", True)]
    assert found.alternatives == (("b", "c"),)


def test_other_monitors_leave_it_to_the_smallest_consistent_subset():
    found = decide(update((99.0, 0.0, 0.0, 0.0)), [says("rctm", of("b"), ambiguous=True)], IDENTIFYING, 5)
    assert [e.group for e in found.exclusions] == ["a"]


# --- pieces -------------------------------------------------------------------------------------------------


def test_names_of_sources_and_sensors_fit_their_rows_only():
    key = "lbl:R.AP1"
    assert is_left_out(key, frozenset(["lbl"]))
    assert is_left_out(key, frozenset(["lbl.AP1"]))
    assert not is_left_out(key, frozenset(["lbl.AP2", "usbl", "AP1"]))
    assert not is_left_out("depth:z", frozenset(["depth."]) - {"depth."})


def test_trials_become_rarer_and_a_second_offence_waits_twice_as_long():
    assert [n for n in range(1, 40) if is_due(n, 1)] == [4, 6, 9, 14, 20, 30]
    assert [n for n in range(1, 40) if is_due(n, 2)] == [9, 14, 20, 30]


def test_residuals_of_rows_that_share_errors_are_those_against_all_that_is_known():
    rng = np.random.default_rng(3)
    root = rng.normal(size=(4, 4))
    nu, whole = rng.normal(size=4), root @ root.T
    everything = update(nu, whole)
    out, kept = np.array([1, 3]), np.array([0, 2])
    part = Update.of(Prior(everything.prior, everything.F, everything.Q), ("a:R.1", "b:R.1"), nu[kept],
                     everything.H[kept], whole[np.ix_(kept, kept)])  # fmt: skip
    spared = part.with_spares(
        ("a:R.2", "b:R.2"), nu[out], everything.H[out], whole[np.ix_(out, out)], ("a.2", "b.2"),
        whole[np.ix_(out, kept)],
    )  # fmt: skip
    expected = left_out(nu, np.asarray(everything.S), out)
    np.testing.assert_allclose(spared.spare_nu, expected.residual, atol=1e-12)
    np.testing.assert_allclose(spared.spare_cov, expected.covariance, atol=1e-12)
    assert spared.excluded == ("a.2", "b.2")


def without_first(o):
    return o.select(np.arange(len(o.keys)) > 0)


@pytest.mark.parametrize("proof", ["trial", "passes"])
def test_who_is_gone_is_forgotten(proof):
    driver = pipeline(log(BEACON), proof=proof, forget_s=10.0)
    for e in log(BEACON).epochs:
        gone = tuple(without_first(o) if o.sensor == "lbl" else o for o in e.observations)
        outcome = driver.push(e if second(e.t_ns) < BEGIN + 5 else replace(e, observations=gone))
        if second(e.t_ns) == BEGIN + 14:
            assert outcome.update.excluded == ()
            assert "lbl.AP1" in driver.checkpoint.standing
    assert not driver.checkpoint.standing


def test_a_correction_puts_the_whole_track_right():
    made = log()
    model = estimator(made, ship(SECONDS, 1.0).spec)
    driver = Pipeline(model, [], Policy(**model.policy))
    for e in made.epochs[:20]:
        update = driver.push(e).update
    before, after = update.prior.aside.track, update.posterior.aside.track
    step = update.posterior.mean - update.prior.mean
    age_s = (update.t_ns - after.t_ns) * 1e-9
    np.testing.assert_allclose(
        after.position_m - before.position_m, step[:3] - age_s[:, None] * step[3:6], atol=1e-7
    )
    turned = after.C @ np.swapaxes(before.C, 1, 2)
    np.testing.assert_allclose(turned, np.broadcast_to(turned[-1], turned.shape), atol=1e-12)
    assert len(after.t_ns) > 10
