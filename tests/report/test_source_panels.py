"""Sources of a vehicle in the report: lanes, levels of verdicts, trials, the risk tree, tables."""

import json
from dataclasses import replace
from io import StringIO

import numpy as np
import polars as pl
import pytest
import simulated_vehicle as vehicle
from rich.console import Console

from pntegrity.bounds.risk_tree import tree_of
from pntegrity.records import Layout, Prior, State, Update
from pntegrity.report.columns import is_vehicle, member_of, members_in, unit_of_row
from pntegrity.report.figures import frame
from pntegrity.report.html import page
from pntegrity.report.inertial import outages
from pntegrity.report.risk import risk_numbers
from pntegrity.report.source_cards import words_of
from pntegrity.report.source_figures import LOOKS, STEPS, sources
from pntegrity.report.source_tables import proofs, sensors
from pntegrity.report.sources import Doing, coarse, doings, lanes, source_numbers, spans
from pntegrity.report.story import absences, story
from pntegrity.report.summary import headline, summary
from pntegrity.report.tables import exclusions, solution
from pntegrity.report.terminal import verdict_table
from pntegrity.report.units import measured
from pntegrity.report.write import write_results


@pytest.fixture(scope="module")
def run():
    return vehicle.outcomes()


@pytest.fixture(scope="module")
def facts():
    return vehicle.facts()


@pytest.fixture(scope="module")
def numbers(run, facts):
    return summary(run, facts)


def did(run, name: str) -> np.ndarray:
    shown = lanes(run)
    return doings(run, shown)[[x.name for x in shown].index(name)]


def make(run, facts) -> str:
    table = solution(run, facts)
    return page(run, facts, summary(run, facts, table), table)


def test_names_come_from_keys_alone():
    keys = ("nav:RX", "lbl:R.AP1", "lbl:D.AP1", "G05:C1C", "iono:R05", "fix:X")
    assert [member_of(k) for k in keys] == ["nav", "lbl.AP1", "lbl.AP1", "G05", "iono", "fix"]
    assert members_in(keys) == ("nav", "lbl.AP1", "G05", "iono", "fix")


def test_a_run_of_satellites_or_fixes_is_no_vehicle(run, faulty):
    def of(*keys):
        return [replace(run[0], updates=(run[0].update.altered(keys=keys, spare_keys=()),))]

    assert is_vehicle(run)
    assert not is_vehicle(faulty)
    assert not is_vehicle(of("fix:X", "fix:Y", "fix:DX"))
    assert not is_vehicle(of("G05:C1C", "iono:R05", "R05:C1C", "trop:ZWD"))
    assert is_vehicle(of("bow:RX"))
    assert is_vehicle(of("dvl:D.x"))


def test_each_source_has_a_lane_and_its_sensors_below_where_it_has_several(run):
    names = [x.name for x in lanes(run)]
    beacons = ["lbl.AP1", "lbl.AP2", "lbl.AP3"]
    assert names == ["nav", "lbl", *beacons, "slow", "late", "late.one", "late.two"]
    assert [x.name for x in lanes(run, ("nav", "mute"))] == [*names, "mute"]


def test_what_each_did(run):
    beacon, lbl = did(run, "lbl.AP1"), did(run, "lbl")
    assert (beacon[:10] == Doing.USED).all()
    assert [Doing(beacon[k]).name for k in (10, 13, 14, 15, 17, 20, 21)] == [
        "OUT", "OUT", "TRIED", "OUT", "TRIED", "OUT", "USED",
    ]  # fmt: skip
    assert (lbl[10:21] == Doing.PART).all()
    assert (did(run, "lbl.AP2")[:30] == Doing.USED).all()
    for name in ("nav", "lbl"):
        assert (did(run, name)[[30, 31]] == Doing.AMBIGUOUS).all()
    assert (did(run, "nav")[80:] == Doing.OUT).all()
    assert (did(run, "late")[60:75] == Doing.SILENT).all()


def test_who_is_named_alone_and_used_all_the_same_is_suspected(run):
    o = run[5]
    named = replace(o, first=(vehicle.alarm(5, "sources", vehicle.suspect(5, "lbl", sensors=("AP2",))),) * 2)
    shown = lanes(run)
    now = {x.name: Doing(v) for x, v in zip(shown, doings([named], shown)[:, 0], strict=True)}
    assert now["lbl"] == now["lbl.AP2"] == Doing.SUSPECTED
    assert now["lbl.AP1"] == now["nav"] == Doing.USED


def test_stretches_are_run_lengths_and_a_slow_source_is_not_silent_between(run):
    t_ns = np.array([o.t_ns for o in run])
    slow, late, nav = (spans(t_ns, did(run, name)) for name in ("slow", "late", "nav"))
    assert len(slow) == 1
    assert slow.start_ns[0] == t_ns[0]
    assert late.start_ns.tolist() == t_ns[[20, 75]].tolist()
    assert late.end_ns.tolist() == [t_ns[59] + 10**9, t_ns[99] + 10**9]
    assert [Doing(v) for v in nav.doing] == [Doing.USED, Doing.AMBIGUOUS, Doing.USED, Doing.OUT]
    assert not len(spans(t_ns, np.zeros(len(t_ns), dtype=np.int8)))


def test_a_coarse_lane_keeps_what_matters_most(run):
    t_ns, done = np.array([o.t_ns for o in run]), did(run, "nav")
    t, what = coarse(t_ns, done[None], 10)
    assert what.shape == (1, 10)
    assert what[0, 3] == Doing.AMBIGUOUS
    assert what[0, 8] == Doing.OUT
    assert t[0] == t_ns[0]


def test_the_numbers_of_each_source(numbers):
    told = {s["source"]: s for s in numbers["sources"]["sources"]}
    assert told["lbl"]["sensors"] == ["AP1", "AP2", "AP3"]
    assert told["lbl"]["used"] == {"epochs": 100, "share": 1.0}
    assert (told["lbl"]["left_out"], told["lbl"]["names"], told["lbl"]["readmitted"]) == (1, ["lbl.AP1"], 1)
    assert told["nav"]["used"] == {"epochs": 80, "share": 0.8}
    assert (told["nav"]["left_out"], told["nav"]["readmitted"]) == (1, 0)
    assert told["slow"]["epochs"] == 34
    assert told["late"]["silent_s"] == 20.0
    assert (told["mute"]["epochs"], told["mute"]["silent_s"]) == (0, 99.0)


def test_verdicts_are_told_level_by_level(numbers):
    found = numbers["sources"]["verdicts"]
    assert [(v["level"], v["monitor"], v["epochs"]) for v in found] == [
        ("source", "sources", 1), ("sensor", "window", 1), ("source", "sources", 2), ("source", "sources", 1),
    ]  # fmt: skip
    assert [words_of(v) for v in found] == ["lbl", "lbl.AP1", "ambiguous: nav or lbl", "nav"]
    assert [v["left_out"] for v in found] == [["lbl.AP1"], ["lbl.AP1"], [], ["nav"]]
    both = {"named": [["nav", "lbl"]], "ambiguous": False}
    assert words_of(both) == "nav and lbl together"
    assert words_of({"named": [], "ambiguous": True}) == "nobody named"


def test_trials_until_the_return_are_one_entry(numbers):
    (proof,) = numbers["sources"]["proofs"]
    assert (proof["name"], proof["tests"], proof["passed"], proof["epochs"]) == ("lbl.AP1", 3, True, 10)
    assert (proof["statistic"], proof["limit"], proof["readmission"]) == (1.5, 3.0, 2e-4)
    assert proof["from"] < proof["to"]


def test_a_second_absence_begins_its_own_trials(run):
    again = [replace(o, t_ns=o.t_ns + len(run) * 10**9) for o in run]
    assert [p["tests"] for p in source_numbers([*run, *again], vehicle.facts())["proofs"]] == [3, 3]


def test_the_tree_is_that_of_who_is_used(run, facts):
    risk = risk_numbers(run, facts)
    last = tree_of(vehicle.ISM, ("late", "lbl", "slow"))
    assert risk["names"] == ["late", "lbl", "slow"]
    assert risk["at_once"] == list(last.at_once)
    assert [b["names"] for b in risk["branches"]] == [list(b.sources) for b in last.branches]
    assert [b["monitored"] for b in risk["branches"]] == [b.monitored for b in last.branches]
    assert {tuple(s["names"]): s["epochs"] for s in risk["sets"]} == {
        ("lbl", "nav", "slow"): 33, ("late", "lbl", "nav", "slow"): 47, ("late", "lbl", "slow"): 20,
    }  # fmt: skip
    assert all(s["unmonitored"] <= risk["allowed"] == pytest.approx(8e-8) for s in risk["sets"])
    assert risk_numbers(run, vehicle.facts(protection={})) is None


def test_the_story_counts_sources_and_tells_sizes_in_their_unit(run, facts):
    said = [s.text for s in story(run, facts)]
    beacon = next(t for t in said if "AP1 excluded" in t)
    nav = next(t for t in said if "nav excluded" in t)
    assert "(WINDOW: bias)" in beacon
    assert beacon.endswith("readmitted.")
    assert "bias 1.2 cm since" in nav
    assert "filter run again over the last 3 epochs" in nav
    assert "2 sources left with 5 sensors; still excluded" in nav
    assert not any("satellite" in t or " m " in t for t in (beacon, nav))
    assert [(a.group, a.start, a.stop, a.back) for a in absences(run)] == [
        ("lbl.AP1", 10, 21, True), ("nav", 80, 100, False),
    ]  # fmt: skip


def test_silence_is_counted(run, facts):
    none = {"keys": (), "nu": np.zeros(0), "H": np.zeros((0, 3)), "R": np.zeros((0, 0))}
    quiet = [
        replace(o, updates=(o.update.altered(**none),)) if 40 <= k < 50 else o for k, o in enumerate(run)
    ]
    told = source_numbers(quiet, facts)["sources"]
    assert next(s for s in told if s["source"] == "nav")["silent_s"] == 11.0
    assert [(o.start_ns, o.seconds) for o in outages(quiet)] == [(vehicle.time_ns(39), 11.0)]


def test_the_figure_has_a_bar_for_each_stretch_and_nothing_else(run):
    drawn = sources(frame(run), ("mute",))
    bars = {t["name"]: t for t in drawn.data if t["type"] == "bar"}
    assert set(bars) == {
        LOOKS[d][0] for d in (Doing.USED, Doing.PART, Doing.OUT, Doing.TRIED, Doing.AMBIGUOUS)
    }
    tried = bars[LOOKS[Doing.TRIED][0]]
    assert tried["x"] == [1000.0, 1000.0]
    assert sum(len(t["y"]) for t in bars.values()) < 30
    assert "WINDOW: bias" in bars[LOOKS[Doing.OUT][0]]["customdata"][1]
    assert drawn.layout["yaxis"]["ticktext"][-1] == "<b>mute</b>"
    line, marks = drawn.data[-2:]
    assert line["x"][1] - line["x"][0] == 3000.0
    assert marks["customdata"] == ["<b>lbl.AP1</b> is back at 06:15:21"]


def test_the_figure_of_a_long_eventful_run_stays_small(run):
    many = [replace(o, t_ns=o.t_ns + i * len(run) * 10**9) for i in range(250) for o in run]
    bars = [t for t in sources(frame(many)).data if t["type"] == "bar"]
    assert sum(len(t["y"]) for t in bars) <= STEPS * len(lanes(run))


def test_the_page_tells_of_sources_and_of_no_satellite(run, facts):
    text = make(run, facts).partition("<script")[0]
    for said in (
        "Sources and their sensors", "Level by level", "Risk tree", "How it changed",
        "Innovations of each sensor",
        "Sensors used", "passed a trial of 10 epochs, after 2 in vain", "ambiguous: nav or lbl",
        "lbl.AP1 left out",
        "would pass with probability 0.0002", "nobody left out",
    ):  # fmt: skip
        assert said in text, said
    assert "atellite" not in text
    assert "<h2>Left out</h2>" not in text


def test_the_page_of_satellites_has_none_of_it(faulty, facts):
    text = make(faulty, replace(facts, sources=(), protection={})).partition("<script")[0]
    assert "Sources and their sensors" not in text
    assert "Risk tree" not in text
    assert "<h2>Left out</h2>" in text


def test_no_name_becomes_markup(run, facts):
    evil = "<b onclick=x>"
    o = run[14]
    spoilt = replace(o, proofs=(replace(o.proofs[0], reason=evil),))
    assert evil not in make([*run[:14], spoilt, *run[15:17]], facts).partition("<script")[0]


def test_each_row_of_each_epoch_is_in_the_table(run):
    table = sensors(run)
    assert len(table) == sum(len(vehicle.keys_at(k)) for k in range(vehicle.N))
    beacon = table.filter((pl.col("source") == "lbl") & (pl.col("sensor") == "AP1"))
    out = beacon.filter(~pl.col("used"))
    assert len(out) == len(vehicle.BEACON)
    assert (out["innovation"] == 5.0).all()
    assert (out["normalised"] == 10.0).all()
    assert sorted(set(out["doing"])) == ["out", "tried"]
    assert (beacon.filter(pl.col("used"))["normalised"] == 2.0).all()
    assert table.filter(pl.col("key") == "nav:DX")["rate"].all()
    assert table.filter(pl.col("key") == "nav:RX")["sensor"].to_list()[0] == ""


def test_each_trial_is_in_the_table(run):
    table = proofs(run)
    assert table["key"].to_list() == ["lbl.AP1"] * 3
    assert table["passed"].to_list() == [False, False, True]
    assert table["reason"].to_list()[0] == "too short to tell"
    assert len(proofs(run[:5])) == 0


def test_an_exclusion_of_unknown_size_has_none_and_comes_back_with_its_sensor(run):
    table = exclusions(run)
    assert table["key"].to_list() == ["lbl.AP1", "nav"]
    assert table["estimated_bias"].to_list() == [None, 0.012]
    assert table["readmitted_gps"].to_list()[0].endswith("06:15:20")


def test_the_files_are_there_for_vehicles_alone(run, faulty, facts, tmp_path):
    paths = write_results(tmp_path, run, facts)
    assert len(pl.read_parquet(paths["sensors"])) == len(sensors(run))
    assert len(pl.read_csv(paths["proofs"])) == 3
    assert json.loads(paths["summary"].read_text())["sources"]["risk"]["p_hmi"] == 1e-7
    write_results(tmp_path, faulty, replace(facts, sources=(), protection={}))
    assert not (tmp_path / "sensors.parquet").exists()
    assert not (tmp_path / "proofs.csv").exists()


@pytest.mark.parametrize("n", [0, 1, 12, 15])
def test_partial_runs_are_written(run, facts, tmp_path, n):
    paths = write_results(tmp_path, run[:n], replace(facts, interrupted=True))
    told = json.loads(paths["summary"].read_text())
    assert (told["epochs"], told["interrupted"]) == (n, True)


def test_the_terminal_has_a_line_for_each_source(run, facts):
    out = StringIO()
    Console(file=out, width=160).print(verdict_table(run, facts))
    lines = [line.strip() for line in out.getvalue().splitlines()]
    assert "source      nav   used at 80 % of 100 epochs, left out once, back 0" in lines
    assert "lbl   used at 100 % of 100 epochs, left out once (lbl.AP1), back 1" in lines
    assert "mute  never measured anything" in lines


def test_an_alert_of_the_level_alone_is_called_that(run, facts):
    o = run[3]
    above = replace(o.verdicts[0], beyond="horizontal protection level above the alert limit of 3 m")
    alone = replace(o, status="alert", verdicts=(above, o.verdicts[1]), first=(above, o.first[1]))
    told = summary([*run[:3], alone, *run[4:10]], facts)
    assert told["limit_alerts"] == 1
    title, detail, tone = headline(told)
    assert (title, tone) == ("Do not trust 1 of 10 epochs", "alert")
    assert detail.startswith("The protection level is above its alert limit there.")
    assert summary(run, facts)["limit_alerts"] == 0


@pytest.mark.parametrize(
    ("size", "unit", "per", "told"),
    [
        (0.012, "m", "", "1.2 cm"), (9.8e-4, "s", "/s", "0.98 ms/s"), (-0.02, "rad", "", "-1.15°"),
        (0.5, "", "/s", "0.5 a second in the unit of its row"),
    ],
)  # fmt: skip
def test_sizes_are_told_in_words_of_their_unit(size, unit, per, told):
    assert measured(size, unit, per) == told


def test_units_are_known_by_what_a_metre_does():
    prior = Prior(
        State(10, np.zeros(3), np.eye(3), Layout(("pos:x", "pos:y", "pos:z"))), np.eye(3), np.eye(3)
    )
    H = np.array([[1.0, 0.0, 0.0], [6.7e-4, 0.0, 0.0], [3e-3, 0.0, 0.0]])
    update = Update.of(prior, ("a:R.1", "a:R.2", "a:A.3"), np.zeros(3), H, np.eye(3))
    assert [unit_of_row(update, i) for i in range(3)] == ["m", "s", "rad"]
