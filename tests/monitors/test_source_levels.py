"""Source and sensor level on single runs of the ship: who is named, and what is said where nobody can be."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from pntegrity.monitors._explanations import Explanation, first_of_all, minimal
from pntegrity.monitors._sources import sensors_of
from pntegrity.monitors.sensor_window import SensorWindow
from pntegrity.monitors.source_separation import SourceSeparation
from pntegrity.records import Suspect, Verdict
from pntegrity.scenarios._vessel_runs import Case, Study
from pntegrity.simulate.linear import Disturbance, draw, shifts, whites


@pytest.fixture(scope="module")
def study():
    return Study("consistent", 1)


def run(study, faults, seed, first, last):
    """Return the updates of one run, from the filter's start to an epoch."""
    g, _ = shifts(study.updates, Disturbance(rows=faults))
    white = whites(study.updates, np.random.default_rng(seed), 1, g)[:, :, 0]
    return draw(study.updates, white)[first:last]


def first_alert(monitor, updates):
    memory = monitor.start()
    for update in updates:
        verdict, memory = monitor.step(memory, update)
        if verdict.status == "alert":
            return verdict
    return None


CASES = {"1": ("gnss", "G02"), "3": ("lbl", "AP1"), "6": ("usbl", "range")}


@pytest.mark.parametrize("name", CASES)
def test_a_ramp_is_named_with_source_and_sensor(study, name):
    case = next(c for c in study.cases() if c.name == name)
    begin = int(case.from_s * 2)
    updates = run(study, study.faults(case), 5, begin - 40, begin + 40)
    verdict = first_alert(SourceSeparation(p_fa=1e-5), updates)
    source, sensor = CASES[name]
    assert verdict.suspect_groups == (source,)
    assert verdict.suspects[0].sensors == (sensor,)
    assert abs(verdict.suspects[0].onset_ns * 1e-9 - case.from_s) <= 4.0


def test_two_sources_at_once_are_named_together(study):
    both = study.faults(
        Case("a", ("gnss:R.G03",), "bias", (40.0,), 80.0, 100.0),
        Case("b", ("lbl:R.AP2",), "bias", (30.0,), 80.0, 100.0),
    )
    verdict = first_alert(SourceSeparation(p_fa=1e-5), run(study, both, 3, 120, 180))
    assert set(verdict.suspect_groups) == {"gnss", "lbl"}
    assert not verdict.ambiguous


def test_the_two_sensors_of_a_double_fault_are_found_at_once(study):
    case = next(c for c in study.cases() if c.name == "2")
    updates = run(study, study.faults(case), 4, 130, 175)
    verdict = first_alert(SensorWindow(p_fa=1e-5), updates)
    assert verdict.suspects[0].sensors == ("G03", "G04")
    assert verdict.t_ns * 1e-9 == pytest.approx(80.0)


@pytest.mark.parametrize("growth", ["expanded", "restarted"])
def test_as_published_the_double_fault_is_found_later(study, growth):
    case = next(c for c in study.cases() if c.name == "2")
    monitor = SensorWindow(p_fa=1e-5, variant="published", growth=growth)
    memory, named = monitor.start(), []
    for update in run(study, study.faults(case), 4, 120, 195):
        verdict, memory = monitor.step(memory, update)
        named += [verdict.t_ns * 1e-9 - 80.0 for s in verdict.suspects if s.sensors == ("G03", "G04")]
    assert named
    assert named[0] > 0.0


def test_as_published_two_exceedances_in_a_row_isolate(study):
    case = next(c for c in study.cases() if c.name == "4")
    updates = run(study, study.faults(case), 4, 220, 250)
    verdict = first_alert(SourceSeparation(p_fa=1e-4, variant="published"), updates)
    assert verdict.suspect_groups == ("lbl",)
    assert verdict.t_ns * 1e-9 == pytest.approx(120.5)


def test_the_best_explanation_must_lead_by_a_margin():
    def one(names, worst, gained):
        return Explanation(tuple(names), worst, 20.0, gained)

    clear = [one("a", 5.0, 40.0), one("b", 30.0, 39.0), one("c", 10.0, 25.0)]
    assert [e.names for e in minimal(clear)] == [("a",)]
    close = [*clear[:2], one("c", 10.0, 35.0)]
    assert [e.names for e in minimal(close)] == [("a",), ("c",)]
    assert [e.names for e in minimal([one("a", 5.0, 40.0), one("ab", 5.0, 60.0)])] == [("a",)]
    assert minimal([one("a", 25.0, 40.0)]) == ()


def test_several_sources_must_be_beaten_by_more_and_count_as_less_likely():
    def one(names, gained):
        return Explanation(tuple(names), 5.0, 20.0, gained)

    found = minimal([one("c", 40.0), one("ab", 20.0)])
    assert [e.names for e in found] == [("c",), ("a", "b")]
    assert first_of_all(found).names == ("c",)
    assert [e.names for e in minimal([one("c", 40.0), one("ab", 14.0)])] == [("c",)]
    found = minimal([one("c", 40.0), one("ab", 60.0)])
    assert [e.names for e in found] == [("a", "b"), ("c",)]
    assert first_of_all(found) is None
    assert first_of_all(minimal([one("a", 40.0), one("b", 38.0)])) is None


def test_the_first_may_be_left_out_in_doubt_where_others_are_more():
    def verdict(*sets, ambiguous=True):
        suspects = tuple(Suspect(tuple(s), "bias", 1.0, 0, 1.0) for s in sets)
        return Verdict("m", "exact", 0, "alert", suspects=suspects, ambiguous=ambiguous)

    assert verdict("c", "ab").foremost.groups == ("c",)
    assert verdict("c", "a").foremost is None
    assert verdict("ab", "c").foremost is None
    assert verdict("c").foremost is None
    assert verdict("c", ambiguous=False).foremost.groups == ("c",)


def test_sensors_are_known_by_the_names_of_the_rows():
    assert sensors_of(("lbl:R.AP2", "lbl:R.AP1", "gnss:D.G05", "gnss:R.G05", "depth:R.z")) == {
        "depth": ("z",), "gnss": ("G05",), "lbl": ("AP1", "AP2")
    }  # fmt: skip


@pytest.mark.parametrize(
    ("monitor", "field", "value"),
    [(SourceSeparation(), "together", 4), (SourceSeparation(), "p_identify", 0.0),
     (SensorWindow(), "most", 0), (SensorWindow(), "growth", "none")],
)  # fmt: skip
def test_impossible_options_are_refused(monitor, field, value):
    with pytest.raises(ValueError, match=f"`{field}` must be"):
        dataclasses.replace(monitor, **{field: value})
