"""Protection levels on the report page."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from bounded import INF, PROMISE, bound, with_bounds

from pntegrity.bounds.ism import Ism
from pntegrity.report.figures import frame
from pntegrity.report.html import page
from pntegrity.report.protection import protected
from pntegrity.report.protection_figures import diagram, levels, ticks
from pntegrity.report.summary import summary
from pntegrity.report.tables import solution


def make(outcomes, facts) -> str:
    table = solution(outcomes, facts)
    return page(outcomes, facts, summary(outcomes, facts, table), table)


def figures(text):
    return {
        f["name"]: f for f in json.loads(re.search(r"id=.data.>(.*?)</script>", text).group(1))["figures"]
    }


@pytest.fixture(scope="module")
def bounded(unresolved):
    """No level at first, then unbounded ones, alerts, two errors beyond their level."""

    def give(k):
        if k < 2:
            return None
        return bound(up=INF, reason="E unseen") if k < 8 else bound(up=1e-9) if k in (10, 11) else bound()

    return with_bounds(unresolved, give)


@pytest.fixture
def told(facts):
    return replace(facts, protection=PROMISE, products=("ionosphere: self-derived <now>",))


def test_the_page_shows_levels_diagrams_and_promise(bounded, told):
    text = make(bounded, told)
    found = figures(text)
    assert {"levels", "stanford-horizontal", "stanford-vertical"} <= set(found)
    assert all(f"id='fig-{n}'" in text for n in found)
    assert "Misleading at 2 of" in text
    for words in (
        "Protection levels against errors",
        "What the levels promise",
        "Which fault sets the level",
    ):
        assert f"<h2>{words}</h2>" in text
    assert "1e-07 in 1 h, which counts as 50 independent epochs: 2e-09 at each" in text
    assert "self-derived &lt;now&gt;" in text
    assert "Protection level, 95\u00a0%" in text


def test_every_colour_that_a_figure_names_exists(bounded, told):
    text = make(bounded, told)
    styles = set(re.findall(r"(--[\w-]+):", text[: text.index("</style>")]))
    named = set(re.findall(r'"(--[\w-]+)"', json.dumps(figures(text))))
    assert named <= styles


def test_other_reports_look_as_before(clean, facts):
    text = make(clean, facts)
    assert not {"levels", "stanford-horizontal"} & set(figures(text))
    assert "rotection level" not in text[text.index("<main>") : text.index("<script")]
    assert make([], facts)


def test_without_truth_there_is_a_sentence_in_place_of_the_diagram(bounded, told):
    text = make(bounded, replace(told, truth_m=None))
    assert "levels" in figures(text)
    assert "stanford-horizontal" not in figures(text)
    assert "no truth was given (option --truth)" in text
    assert [t["name"] for t in figures(text)["levels"]["data"]].count("error") == 0


def test_the_real_message_is_told_field_by_field(bounded, told):
    ism = Ism(
        satellites=(("G05", 1e-3),), constellations=(("E", 2e-5, 3e-4),), b_code_m=0.5, noise=(("a", 2.0),)
    )
    text = make(bounded, replace(told, protection=ism.to_table()))
    rows = dict(
        re.findall(r"<tr><th>([^<]*)</th><td>([^<]*)</td>", text[text.index("What the levels promise") :])
    )
    rows = {k: v.replace("\u2212", "-") for k, v in rows.items()}
    assert rows["G05 alone"] == "0.001"
    assert rows["Constellation E"] == "2e-05, 0.0003"
    assert rows["Nominal bias of code"] == "0.50 m"
    assert rows["Horizontal alert limit"] == "none"
    assert rows["Integrity risk"] == "1e-07"
    assert rows["noise.a"] == "2.0"
    assert "at most 1e-07 an epoch" in text
    assert "No alert limits were given" in text
    told_names = {
        "p_sat",
        "p_iono",
        "max_modes",
        "split",
        "fa_split",
        "exposure_s",
        "p_emt",
        "unmonitored_share",
    }
    assert not told_names & set(rows)


def test_no_message_is_said(bounded, facts):
    assert "probabilities behind the levels were not stated" in make(bounded, facts)


def test_the_curves_mark_what_matters(bounded, told):
    p = protected(solution(bounded, told), told)
    f = levels(frame(bounded), p)
    marked = [(t["name"], t["yaxis"]) for t in f.data if t["mode"] == "markers"]
    assert marked == [("no finite level", "y2"), ("error beyond, no alert", "y2")]
    names = [t["name"] for t in f.data if t["showlegend"]]
    assert len(names) == len(set(names)) == 5
    tones = [s["fillcolor"] for s in f.layout["shapes"]]
    assert {"--alert-soft", "--na-fill"} == set(tones)
    for axis in ("yaxis", "yaxis2"):
        low, high = f.layout[axis]["range"]
        assert np.isfinite([low, high]).all()
        assert len(f.layout[axis]["tickvals"]) >= 2


def test_the_diagram_holds_every_epoch_that_can_stand_in_it(bounded, told):
    p = protected(solution(bounded, told), told)
    f = diagram(p.vertical)
    heat, marks = f.data
    cells = np.array(heat["customdata"])
    edges = np.array(heat["x"])
    assert cells.sum() == p.vertical.counts.judged - 2  # two epochs have no level
    assert cells[-1].sum() == 6  # no finite level
    assert len(edges) == cells.shape[0] + 1 == cells.shape[1] + 1
    assert np.allclose(np.diff(np.log10(edges)), np.log10(edges[1] / edges[0]))
    assert marks["marker"]["symbol"] == "x"
    assert {a["text"] for a in f.layout["annotations"]} == {
        "normal operation", "misleading", "unavailable", "hazardous",
    }  # fmt: skip
    assert not f.timed


def test_a_diagram_without_an_alert_limit_has_no_such_regions(bounded, facts):
    p = protected(solution(bounded, facts), facts)
    f = diagram(p.horizontal)
    assert {a["text"] for a in f.layout["annotations"]} == {"normal operation", "misleading"}
    assert len(f.data) == 1


def test_a_run_whose_levels_are_all_unbounded_is_drawn(clean, facts):
    for truth in (facts.truth_m, None):
        text = make(with_bounds(clean, lambda k: bound(INF, INF, INF)), replace(facts, truth_m=truth))
        assert "unbounded" in text


@pytest.mark.parametrize(("low", "high"), [(0.011, 0.09), (0.1, 10.0), (1e-3, 1e5), (0.6, 2.1), (2.1, 6.8)])
def test_ticks_lie_within_the_axis_and_say_their_value(low, high):
    t = ticks(low, high)
    assert 1 <= len(t["tickvals"]) <= 9
    assert all(low <= v <= high for v in t["tickvals"])
    assert [float(x) for x in t["ticktext"]] == pytest.approx(t["tickvals"])


def test_sectors_and_groups_are_told_where_there_are_any(bounded, told):
    without = make(bounded, replace(told, protection=PROMISE | {"sectors": 0, "p_sector": 0.0}))
    assert "sector" not in without[without.index("What the levels promise") : without.index("<script")]
    groups = {"name": "canyon", "groups": ["G05", "E12"], "probability": 1e-3}
    more = {"sectors": 4, "sector_width_deg": 90.0, "p_sector": 2e-4, "together": [groups]}
    text = make(bounded, replace(told, protection=PROMISE | more))
    assert "<th>An azimuth sector</th><td>0.0002</td>" in text
    assert "<th>Azimuth sectors</th><td>4</td>" in text
    assert "<th>canyon</th><td>0.001</td><td>G05 and E12 at once</td>" in text


def test_a_column_of_which_nothing_is_known_is_not_there(bounded, told):
    whole = make(bounded, told)
    assert all(f"<th>{title}</th>" in whole for title in ("Alert limit", "Times the smallest possible"))
    free = {k: v for k, v in PROMISE.items() if k not in ("hal_m", "val_m")}
    less = make(bounded, replace(told, protection=free))
    assert "<th>Alert limit</th>" not in less
    assert "<th>Times the smallest possible</th>" in less
