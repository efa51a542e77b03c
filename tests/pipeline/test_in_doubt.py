"""Who is out in doubt, and what follows: a drift that two sources share, its end, and the way back."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from pntegrity.bounds.ism import Ism
from pntegrity.config import make_monitor
from pntegrity.exclusion import Policy, decide
from pntegrity.monitors.separation import Separation
from pntegrity.pipeline import Pipeline
from pntegrity.policy import Standing
from pntegrity.proving import Proof
from pntegrity.readmission import mostly_out, review
from pntegrity.records import Layout, Prior, State, Suspect, Update, Verdict
from pntegrity.scenarios._vessel_logs import estimator, ship, ship_log
from pntegrity.simulate.vessel_log import led_astray
from pntegrity.states import group_of

SECONDS, BEGIN, END = 125, 45, 75
TRIAL = Policy(proof="trial")
PRIORS = {"gnss": 1e-4, "lbl": 1e-4, "usbl": 1e-4}


@lru_cache(maxsize=4)
def log(*names, towards=(0.0, 0.3, 0.0)):
    clean = ship_log(ship(SECONDS, 1.0), 21)
    return led_astray(clean, names, towards, BEGIN, END) if names else clean


def seconds(of, outcomes):
    return np.array([(o.t_ns - of.motion.span_ns[0]) * 1e-9 for o in outcomes])


def run(of, monitors, **changes):
    model = estimator(of, ship(SECONDS, 1.0).spec)
    driver = Pipeline(model, monitors, Policy(**(dict(model.policy) | changes)))
    return [driver.push(e) for e in of.epochs]


@lru_cache(maxsize=4)
def whole(*names, towards=(0.0, 0.3, 0.0)):
    levels = Separation(1e-6, ism=Ism.from_table({"sources": PRIORS}), pairs=False, levels="observed")
    monitors = [make_monitor(n, 1e-6) for n in ("source_separation", "sensor_window")]
    return run(log(*names, towards=towards), [*monitors, levels])


def misled(of, outcomes):
    """Tell at which epochs the error is beyond a level, and none is said."""
    bound = [next(v.bound for v in o.verdicts if v.bound is not None) for o in outcomes]
    hpl = np.array([b.hpl_m for b in bound])
    off = np.array([o.update.posterior.mean[:3] for o in outcomes]) - of.truth.position_m[: len(outcomes)]
    return (np.linalg.norm(off, axis=1) > np.hypot(hpl, [b.vpl_m for b in bound])) & np.array(
        [o.status == "ok" for o in outcomes]
    )


@pytest.mark.parametrize("towards", [(0.0, 0.3, 0.0), (0.3, 0.0, 0.0)])
def test_a_drift_that_two_sources_share_never_blames_the_third_for_certain(towards):
    outcomes = whole("gnss", "lbl", towards=towards)
    made = [e for o in outcomes for e in o.exclusions]
    assert made
    assert all(e.doubtful for e in made if e.group.startswith("usbl"))


@pytest.mark.parametrize("towards", [(0.0, 0.3, 0.0), (0.3, 0.0, 0.0)])
def test_from_the_first_alarm_on_nobody_is_misled_by_it_or_by_its_end(towards):
    of, outcomes = log("gnss", "lbl", towards=towards), whole("gnss", "lbl", towards=towards)
    t_s = seconds(of, outcomes)
    first = min(t for t, o in zip(t_s, outcomes, strict=True) if t >= BEGIN and o.status == "alert")
    assert first < END
    assert not misled(of, outcomes)[t_s >= first].any()


def test_one_source_that_is_led_astray_is_left_out_and_comes_back():
    of, outcomes = log("gnss"), whole("gnss")
    t_s = seconds(of, outcomes)
    made = {e.group for o in outcomes for e in o.exclusions}
    assert made == {"gnss"}
    assert {o.status for t, o in zip(t_s, outcomes, strict=True) if t > END + 10} == {"ok"}
    assert not misled(of, outcomes).any()


def test_the_source_that_drifts_measures_as_from_elsewhere_with_its_own_errors():
    clean, moved = log(), log("lbl")
    for a, b in zip(clean.epochs, moved.epochs, strict=True):
        t_s = (a.t_ns - clean.motion.span_ns[0]) * 1e-9
        for o, p in zip(a.observations, b.observations, strict=True):
            off = np.abs(p.y - o.y)
            if o.sensor != "lbl" or not BEGIN < t_s < END:
                assert off.max() == 0.0
            else:  # a travel time, both ways at 1500 m/s, from a place 0.3 m/s farther north each second
                assert 0.0 < off.max() < 2.0 * 0.3 * (t_s - BEGIN + 2.0) / 1400.0


class Blames:
    """A monitor that names healthy sensors of USBL at one epoch, in doubt, and is content ever after."""

    name, variant = "source_separation", "exact"

    def __init__(self, of, sensors=("elevation",), size=0.02):
        self.first, self.sensors, self.size = of.motion.span_ns[0], sensors, size

    def start(self):
        return 0

    def suspects(self, t_s, update):
        if t_s != BEGIN or f"usbl:A.{self.sensors[0]}" not in update.keys:
            return ()
        mine = Suspect(("usbl",), "bias", self.size, update.t_ns, 40.0, self.sensors)
        return mine, Suspect(("gnss", "lbl"), "bias", 1.0, update.t_ns, 39.0)

    def step(self, memory, update):
        told = self.suspects(round((update.t_ns - self.first) * 1e-9), update)
        facts = ("alert", 30.0, 20.0) if told else ("ok", 1.0, 20.0)
        return Verdict(self.name, self.variant, update.t_ns, *facts, 1e-6, 1, told, len(told) > 1), 0


@pytest.mark.parametrize("size", [0.02, 0.012])
def test_a_healthy_sensor_that_has_no_end_of_a_fault_to_show_comes_back_all_the_same(size):
    of = log()
    outcomes = run(of, [Blames(of, size=size)])
    t_s = seconds(of, outcomes)
    assert [(t, e.group) for t, o in zip(t_s, outcomes, strict=True) for e in o.exclusions] == [
        (BEGIN, "usbl.elevation")
    ]
    (back_s,) = [t for t, o in zip(t_s, outcomes, strict=True) if "usbl.elevation" in o.readmitted]
    assert back_s < BEGIN + 60
    assert {o.status for t, o in zip(t_s, outcomes, strict=True) if t > back_s} == {"ok"}


class Later(Blames):
    """A monitor that after its doubt is certain of somebody else."""

    def suspects(self, t_s, update):
        if t_s == BEGIN + 3 and "lbl:R.AP1" in update.keys:
            return (Suspect(("lbl",), "bias", 0.01, update.t_ns, 50.0, ("AP1",)),)
        return super().suspects(t_s, update)


def test_who_is_left_out_soon_after_a_doubt_is_in_doubt_as_well():
    of = log()
    outcomes = run(of, [Later(of)])
    (second,) = [e for o in outcomes for e in o.exclusions if e.group == "lbl.AP1"]
    assert second.doubtful
    at = {round(t): o for t, o in zip(seconds(of, outcomes), outcomes, strict=True)}
    assert at[BEGIN + 4].status == "alert"
    assert at[SECONDS - 1].status == "ok"


class Everybody(Blames):
    """A monitor that after its doubt about most of a source is certain of all others."""

    def suspects(self, t_s, update):
        if t_s == BEGIN + 2 and {"gnss", "lbl"} <= set(update.groups()):
            return (Suspect(("gnss", "lbl"), "bias", 9.0, update.t_ns, 50.0),)
        return super().suspects(t_s, update)


def test_nobody_goes_where_nothing_but_a_part_of_a_source_would_be_left():
    of = log()
    outcomes = run(of, [Everybody(of, sensors=("bearing", "time"))])
    at = {round(t): o for t, o in zip(seconds(of, outcomes), outcomes, strict=True)}
    assert at[BEGIN].update.excluded == ("usbl.bearing", "usbl.time")
    assert "3 of 3 would be left out" in at[BEGIN + 2].reason
    assert at[BEGIN + 2].status == "alert"
    assert at[BEGIN + 2].update.excluded == ()


KEYS = ("gnss:R.G01", "gnss:R.G02", "gnss:D.G01", "lbl:R.AP1", "lbl:R.AP2", "lbl:R.AP3", "depth:R.z")


@pytest.mark.parametrize(
    ("excluded", "gone"),
    [
        ((), ()),
        (("lbl.AP1",), ()),
        (("lbl.AP1", "lbl.AP2"), ("lbl",)),
        (("gnss.G01",), ()),
        (("gnss", "depth.z"), ("gnss", "depth")),
    ],
)
def test_a_source_most_of_whose_level_rows_are_out_is_out(excluded, gone):
    assert mostly_out(KEYS, frozenset(excluded)) == frozenset(gone)


def test_most_sources_against_a_prior_that_is_not_trusted_let_go_of_the_prior():
    of = log("gnss", "lbl")
    model = estimator(of, ship(SECONDS, 1.0).spec)
    update = Pipeline(model, ()).push(of.epochs[0]).update
    sources = {group_of(k) for k in update.keys}
    assert sources == {"gnss", "lbl", "usbl"}
    most, one = (Suspect(g, "bias", 1.0, update.t_ns, 40.0) for g in (("gnss", "lbl"), ("gnss",)))
    policy = Policy(**model.policy)
    distrusting = Policy(**(dict(model.policy) | {"trust_prior": False}))
    verdict = {
        len(s.groups): Verdict("source_separation", "exact", update.t_ns, "alert", 60.0, 20.0, 1e-6, 1, (s,))
        for s in (most, one)
    }
    assert decide(update, [verdict[2]], distrusting, 0).relax
    assert not decide(update, [verdict[1]], distrusting, 0).relax
    assert {e.group for e in decide(update, [verdict[2]], policy, 0).exclusions} == {"gnss", "lbl"}


def quiet_update():
    """Return an update without ``a.1``, whose row is small."""
    prior = Prior(State(10, np.zeros(2), np.eye(2), Layout(("pos:x", "pos:y"))), np.eye(2), np.zeros((2, 2)))
    used = Update.of(prior, ("a:R.2", "b:R.1"), np.zeros(2), np.eye(2), np.eye(2))
    return used.with_spares(("a:R.1",), np.zeros(1), np.eye(2)[:1], np.eye(1), ("a.1",), np.zeros((1, 2)))


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        ({"of_end": True}, (0, 4)),  # no end was seen: the next may begin later, and it has been quiet
        ({"reason": "too short"}, (4, 4)),
        ({}, (0, 0)),  # it is off
    ],
)
def test_a_trial_that_shows_no_end_leaves_what_else_is_known_as_it_is(found, expected):
    s = Standing(0, 9, clean_ns=6, count=3, quiet_ns=6, quiet=3, size=1.0)
    told = Proof("a.1", 10, 4, False, **found)
    after, proofs = review({"a.1": s}, quiet_update(), frozenset(["a.1"]), TRIAL, 1.0, lambda name, _: told)
    assert proofs == (told,)
    assert (after["a.1"].count, after["a.1"].quiet) == expected


@pytest.mark.parametrize(("count", "quiet", "asked"), [(1, 5, 1), (3, 10, 1), (1, 6, 0)])
def test_a_trial_is_due_by_either_count(count, quiet, asked):
    s = Standing(0, 9, clean_ns=6, count=count, quiet_ns=1, quiet=quiet, size=1.0)
    made = []

    def trial(name, standing):
        made.append(name)
        return Proof(name, 10, 4, False, reason="too short")

    review({"a.1": s}, quiet_update(), frozenset(["a.1"]), TRIAL, 1.0, trial)
    assert len(made) == asked
