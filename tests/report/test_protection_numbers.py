"""Protection levels in tables, numbers, words and on the terminal."""

import json
import math
from dataclasses import replace
from io import StringIO

import numpy as np
import polars as pl
import pytest
from bounded import INF, PROMISE, bound, with_bounds
from rich.console import Console

from pntegrity.report.facts import RunFacts
from pntegrity.report.protection import protected
from pntegrity.report.story import story
from pntegrity.report.summary import headline, summary
from pntegrity.report.tables import exclusions, solution, suspect_text, verdicts
from pntegrity.report.terminal import verdict_table
from pntegrity.report.write import write_results

LEVELS = ["hpl_m", "vpl_m", "pl_east_m", "pl_north_m", "pl_up_m", "pl_along_m", "pl_cross_m"]


@pytest.fixture
def told(facts):
    return replace(facts, protection=PROMISE)


def numbers(outcomes, facts):
    return summary(outcomes, facts)["protection"]


def off(clean, k, up_m):
    """Return the clean run with the position at epoch k off by `up_m` along the vertical."""
    u = clean[k].update
    mean = u.posterior.mean.copy()
    mean[:3] *= 1.0 + up_m / np.linalg.norm(mean[:3])
    moved = replace(clean[k], updates=(u.altered(posterior=replace(u.posterior, mean=mean)),))
    return [*clean[:k], moved, *clean[k + 1 :]]


# --- tables -----------------------------------------------------------------------------------------------


def test_the_columns_are_there_without_any_bound(clean, facts):
    for table in (solution(clean, facts), verdicts(clean), solution([], RunFacts()), verdicts([])):
        assert all(table[name].dtype == pl.Float64 for name in LEVELS)
        assert all(table[name].null_count() == len(table) for name in [*LEVELS, "pl_mode"])
    assert solution(clean, facts)["pl_exceeded"].null_count() == len(clean)


def test_levels_of_an_epoch(clean, facts):
    def give(k):
        return None if k == 0 else bound(along_m=3.5, cross_m=2.5) if k < 5 else bound()

    table = solution(with_bounds(clean, give), facts)
    assert table.select(LEVELS).row(0) == (None,) * 7
    assert table.select(LEVELS).row(1) == pytest.approx((5.0, 8.0, 3.0, 4.0, 8.0, 3.5, 2.5))
    assert table.select(LEVELS).row(5)[5:] == (None, None)
    assert table["pl_mode"].to_list()[:2] == [None, "trop"]
    assert table["pl_exceeded"].to_list() == [None] + [False] * (len(clean) - 1)


def test_an_unbounded_level_is_inf_and_one_that_is_no_number_bounds_nothing(clean, facts, tmp_path):
    given = [bound(east=INF, reason="E unseen"), bound(up=math.nan)]
    made = with_bounds(clean[:2], lambda k: given[k])
    paths = write_results(tmp_path, made, facts)
    for name in ("solution", "verdicts"):
        table = pl.read_parquet(paths[name]).filter(pl.col("hpl_m").is_not_null())
        assert table["hpl_m"].to_list() == [INF, 5.0]
        assert table["vpl_m"].to_list() == [8.0, INF]
        assert table["pl_reason"].to_list() == ["E unseen", ""]
        assert all(table[n].is_nan().sum() == 0 for n in LEVELS)


def test_the_largest_level_of_several_monitors_counts(clean, facts):
    made = with_bounds(
        clean,
        lambda k: bound(east=3.0, north=4.0, up=6.0, dominant=("a", "b", "c")),
        lambda k: bound(east=6.0, north=1.0, up=2.0, dominant=("d", "e", "f")) if k else None,
    )
    table = solution(made, facts)
    assert table.select("hpl_m", "vpl_m", "pl_east_m", "pl_north_m").row(1) == (37.0**0.5, 6.0, 6.0, 4.0)
    assert table["pl_mode"].to_list()[:2] == ["c", "c"]
    modes = {m["mode"]: m for m in numbers(made, facts)["modes"]}
    n = len(clean)
    assert modes["d"]["east"] == n - 1
    assert modes["a"]["east"] == 1
    assert modes["b"]["north"] == modes["c"]["up"] == n


def test_each_verdict_tells_its_own_levels(clean):
    made = with_bounds(clean, lambda k: bound(unmonitored=3e-9, since_ns=7), lambda k: bound(up=9.0))
    table = verdicts(made)
    ours = table.filter(pl.col("monitor").str.starts_with("separation"))
    assert ours["vpl_m"].to_list() == [8.0, 9.0] * len(clean)
    assert ours.select("pl_modes", "pl_unmonitored", "pl_since_ns").row(0) == (20, 3e-9, 7)
    assert table.filter(pl.col("monitor") == "glr")["hpl_m"].null_count() == len(clean)


def test_an_error_beyond_a_level_is_said(clean, facts):
    table = solution(with_bounds(off(clean, 20, 9.0), lambda k: bound()), facts)
    assert np.flatnonzero(table["pl_exceeded"].to_list()).tolist() == [20]
    unknown = solution(with_bounds(clean, lambda k: bound()), replace(facts, truth_m=None))
    assert unknown["pl_exceeded"].null_count() == len(clean)


# --- numbers ----------------------------------------------------------------------------------------------


def test_without_bounds_there_are_no_numbers(clean, facts):
    assert numbers(clean, facts) is None
    assert protected(solution([], RunFacts()), RunFacts()) is None


def test_the_numbers(clean, told):
    n = len(clean)
    s = numbers(with_bounds(clean, lambda k: bound(up=8.0 + 8.0 * (k < 6))), told)
    assert s["hpl_m"] == {"median": 5.0, "p95": 5.0}
    assert s["vpl_m"] == {"median": 8.0, "p95": 16.0}
    assert s["along_m"] is s["cross_m"] is None
    assert (s["hal_m"], s["val_m"]) == (10.0, 15.0)
    assert s["available"] == {"epochs": n - 6, "share": (n - 6) / n}
    assert s["over_sigma"] == pytest.approx({"h": 10.0, "v": 10.0})
    assert s["over_smallest"] == pytest.approx({"h": 2.0, "v": 1.0})
    assert s["risk_per_epoch"] == pytest.approx(2e-9, rel=1e-12)
    assert s["misleading"]["epochs"] == s["misleading"]["hazardous"] == 0
    assert s["misleading"]["compared"] == n
    assert s["misleading"]["vertical"]["unavailable"] == 6
    assert s["modes"][0] == {"mode": "G05", "east": n, "north": 0, "up": 0}
    assert {m["mode"] for m in s["modes"]} == {"G05", "fault-free", "trop"}


def test_unbounded_levels_are_null_and_counted_with_their_reasons(clean, told):
    def give(k):
        if k < 2:
            return None
        return bound(up=INF, reason="G unseen" if k % 2 else "E unseen") if k < 40 else bound()

    s = numbers(with_bounds(clean, give), told)
    assert s["vpl_m"] == {"median": None, "p95": None}
    assert s["hpl_m"]["p95"] == 5.0
    assert s["unbounded"] == {"epochs": 38, "reasons": {"E unseen": 19, "G unseen": 19}}
    assert s["without"]["epochs"] == 2
    assert s["available"]["epochs"] == len(clean) - 40
    assert s["over_sigma"]["v"] == pytest.approx(10.0)
    assert json.loads(json.dumps(s, allow_nan=False)) == s


def test_an_epoch_that_is_not_ok_is_not_available(clean, told):
    made = with_bounds(clean, lambda k: bound())
    for status in ("alert", "unavailable"):
        s = numbers([replace(o, status=status) if k < 3 else o for k, o in enumerate(made)], told)
        assert s["available"]["epochs"] == len(clean) - 3


def test_without_alert_limits_nothing_is_called_available(clean, facts):
    for promise in ({}, PROMISE | {"hal_m": INF, "val_m": INF}):
        s = numbers(with_bounds(clean, lambda k: bound()), replace(facts, protection=promise))
        assert s["available"] is s["hal_m"] is None
        assert json.loads(json.dumps(s, allow_nan=False)) == s


def test_misleading_epochs_unless_an_alert_was_given(clean, told):
    made = with_bounds(off(off(clean, 20, 9.0), 30, 16.0), lambda k: bound())
    m = numbers(made, told)["misleading"]
    assert (m["epochs"], m["hazardous"], m["vertical"]["misleading"]) == (2, 1, 1)
    assert m["horizontal"]["normal"] == len(clean)
    alerted = numbers([replace(o, status="alert") if k == 30 else o for k, o in enumerate(made)], told)
    assert (alerted["misleading"]["epochs"], alerted["misleading"]["hazardous"]) == (1, 0)
    assert alerted["misleading"]["compared"] == len(clean) - 1
    blind = numbers(made, replace(told, truth_m=None))
    assert blind["misleading"] is None


@pytest.mark.parametrize("limit", [0.0, -1.0, math.nan])
def test_an_alert_limit_that_is_not_positive_is_refused(limit):
    with pytest.raises(ValueError, match="val_m"):
        RunFacts(protection={"val_m": limit})


# --- words ------------------------------------------------------------------------------------------------


def texts(outcomes, facts):
    return [(s.kind, s.text) for s in story(outcomes, facts)]


def test_the_story_tells_whether_the_levels_held(clean, told):
    kind, text = texts(with_bounds(clean, lambda k: bound()), told)[-2]
    assert kind == "end"
    assert "5.00 m horizontal and 8.00 m vertical (median); the error never left them" in text
    said = texts(with_bounds(clean, lambda k: bound()), replace(told, truth_m=None))
    assert "no truth was given" in said[-2][1]


def test_the_story_tells_an_error_beyond_its_level(clean, told):
    made = with_bounds(off(clean, 20, 9.0), lambda k: bound())
    found = [t for kind, t in texts(made, told) if kind == "alert"]
    assert "06:15:20: error beyond its protection level without an alert (worst vertical " in found[0]
    assert "against 8.00 m)" in found[0]
    assert f"at 1 of {len(clean)} epochs" in found[1]
    title, detail, tone = headline(summary(made, told))
    assert (title, tone) == (f"Misleading at 1 of {len(clean)} epochs", "alert")
    assert "no alert was given" in detail


def test_the_story_tells_where_levels_are_of_no_use(clean, told):
    def give(k):
        return bound(up=INF, reason="E unseen") if 10 <= k < 15 else bound(up=16.0) if k == 20 else bound()

    found = [t for kind, t in texts(with_bounds(clean, give), told) if kind == "unavailable"]
    assert found == [
        "06:15:10-06:15:14: no finite protection level (E unseen).",
        "06:15:20: protection level beyond the alert limit (vertical up to 16.0 m against 15.0 m).",
    ]
    often = with_bounds(clean, lambda k: bound(up=INF if k % 4 == 0 else 8.0))
    (one,) = [t for kind, t in texts(often, told) if kind == "unavailable"]
    assert one.endswith("(15 epochs).")
    never = with_bounds(clean, lambda k: bound(INF, INF, INF, reason="nothing is left"))
    said = [t for _, t in texts(never, told)]
    assert [t for t in said if "protection level" in t] == [
        "06:15:00-06:15:59: no finite protection level (nothing is left)."
    ]


def shown(outcomes, facts) -> str:
    out = StringIO()
    Console(file=out, width=200).print(verdict_table(outcomes, facts))
    return next((x for x in out.getvalue().splitlines() if x.startswith("protection")), "").rstrip()


def test_the_terminal_has_one_line(clean, told):
    made = with_bounds(off(clean, 20, 9.0), lambda k: bound(up=INF) if k < 3 else bound())
    assert shown(made, told) == (
        "protection  HPL median 5.00 m (95 % 5.00 m), VPL median 8.00 m (95 % unbounded), "
        "within alert limits 95.0 %, unbounded 3, misleading 1 of 60"
    )
    assert shown(clean, told) == ""


# --- exclusions by comparing solutions --------------------------------------------------------------------


def test_what_a_separation_suspects_in_words(faulty, facts):
    e = next(e for o in faulty for e in o.exclusions)
    apart = replace(e, monitor="separation", kind="separation", size=2.1, statistic=0.85)
    k = next(k for k, o in enumerate(faulty) if e in o.exclusions)
    made = [*faulty[:k], replace(faulty[k], exclusions=(apart,)), *faulty[k + 1 :]]
    assert exclusions(made)["estimated_bias"][0] is None
    assert f"{e.group} excluded (SEPARATION: positions apart by 2.10 m" in " ".join(
        t for _, t in texts(made, facts)
    )
    suspect = next(s for o in faulty for v in o.first for s in v.suspects)
    text = suspect_text(replace(suspect, kind="separation", size=2.1, statistic=0.85))
    assert text == f"{'+'.join(suspect.groups)} separation 2.10 m (rest at 0.85 of what is allowed)"
