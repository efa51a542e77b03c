import json
import re
from dataclasses import replace

import pytest
from simulated import START_NS

from pntegrity.report.facts import RunFacts
from pntegrity.report.story import absences, clock_time, names, story
from pntegrity.report.summary import committed, headline, summary


def test_the_numbers_add_up(faulty, facts):
    s = summary(faulty, facts)
    assert s["epochs"] == len(faulty)
    assert sum(a["epochs"] for a in s["availability"].values()) == len(faulty)
    assert sum(a["share"] for a in s["availability"].values()) == pytest.approx(1.0)
    assert [e["key"] for e in s["exclusions"]] == ["G05", "E12"]
    assert s["readmissions"] == 2
    assert {m["monitor"]: m["final"]["alarms"] for m in s["monitors"]} == dict.fromkeys(
        ("rctm", "srctm", "aime", "glr"), 0
    )
    assert s["satellites"]["systems"]["G"]["min"] == 8
    assert json.loads(json.dumps(s, allow_nan=False)) == s


def test_alarms_are_counted_as_the_verdicts_say(unresolved, facts):
    for m in summary(unresolved, facts)["monitors"]:
        mine = [v for o in unresolved for v in o.verdicts if v.monitor == m["monitor"]]
        assert m["final"]["alarms"] == sum(v.status == "alert" for v in mine)
        assert m["final"]["tests"] == sum(v.status != "unavailable" for v in mine)
        assert m["final"]["worst_ratio"] > 1.0


def test_without_truth_there_is_no_position(faulty, facts):
    assert summary(faulty, facts)["position"]["h"]["p95_m"] < 2.0
    assert summary(faulty, replace(facts, truth_m=None))["position"] is None


def test_the_keys_are_the_same_for_an_empty_run(faulty, facts):
    assert summary([], RunFacts()).keys() == summary(faulty, facts).keys()


def test_committed_updates_are_in_time_order_and_one_an_epoch(faulty):
    assert any(o.rewound for o in faulty)
    assert [u.t_ns for u in committed(faulty)] == [o.t_ns for o in faulty]


def test_the_story_tells_each_thing_once(faulty, facts):
    told = story(faulty, facts)
    assert [s.kind for s in told] == ["start", "excluded", "excluded", "gap"]
    assert "06:15:00: filter started from 14 satellites" in told[0].text
    assert re.search(r"G05 excluded \(GLR: ramp 0\.[23]\d m/s since 06:15:1\d\)", told[1].text)
    assert "run again over the last" in told[1].text
    assert (
        "E12 excluded (epoch test: bias 50.0 m); position kept, 12 satellites left" in told[2].text
    )  # G05 is not back yet
    assert "3 epochs missing" in told[3].text


def test_an_unresolved_alert_is_said_with_its_monitors(unresolved, facts):
    alert = [s for s in story(unresolved, facts) if s.kind == "alert"]
    assert len(alert) == 1
    assert "GLR" in alert[0].text
    assert "Do not use the position" in alert[0].text
    assert headline(summary(unresolved, facts))[2] == "alert"


def test_an_interrupted_run_says_so(clean, facts):
    cut = replace(facts, interrupted=True)
    assert "interrupted" in story(clean[:30], cut)[-1].text
    assert "interrupted" in headline(summary(clean[:30], cut))[1]


def test_untested_epochs_are_never_called_ok(clean, facts):
    untested = [replace(o, status="unavailable", reason="3 satellites") for o in clean]
    title, _, tone = headline(summary(untested, facts))
    assert tone == "unavailable"
    assert "No integrity test" in title
    assert "no test possible (3 satellites)" in " ".join(s.text for s in story(untested, facts))


def test_a_clean_run(clean, facts):
    assert headline(summary(clean, facts))[0] == f"No alarm in {len(clean)} epochs"
    assert "nothing excluded" in story(clean, facts)[-1].text


def test_absences_end_where_the_group_is_used_again(faulty):
    for a in absences(faulty):
        used = [any(k.startswith(a.group) for k in o.update.keys) for o in faulty]
        assert not any(used[a.start : a.stop])
        assert used[a.stop]


def test_many_exclusions_of_one_group_become_one_sentence(faulty, facts):
    one = faulty[:30]
    repeated = [replace(o, t_ns=o.t_ns + 10**11 * i) for i in range(5) for o in one]
    often = [s for s in story(repeated, facts) if s.kind == "excluded" and "times" in s.text]
    assert len(often) == 1


@pytest.mark.parametrize(
    ("groups", "text"),
    [
        ((), "none"),
        (("G05",), "G05"),
        (("G05", "E11"), "G05 and E11"),
        (tuple("abcdefgh"), "a, b, c, d, e and 3 more"),
    ],
)
def test_names(groups, text):
    assert names(groups) == text


def test_times_of_day_are_rounded_to_a_tenth():
    assert clock_time(START_NS) == "06:15:00"
    assert clock_time(START_NS + 249_999_999) == "06:15:00.2"
    assert clock_time(START_NS, date=True) == "2019-01-14 06:15:00"
