"""Runs with an INS and with fault detection before the filter: tables, numbers, words, the page."""

import json
import re
from dataclasses import replace
from io import StringIO

import numpy as np
import polars as pl
import pytest
import simulated_inertial as drive
from rich.console import Console

from pntegrity.estimators._ins_options import InsOptions
from pntegrity.estimators._ins_solution import solution_of
from pntegrity.records import group_of
from pntegrity.report.blind_spots import blind_spots
from pntegrity.report.facts import RunFacts
from pntegrity.report.html import page
from pntegrity.report.inertial import outages
from pntegrity.report.screening import araim_sets, dropped, screening
from pntegrity.report.story import story
from pntegrity.report.summary import headline, summary
from pntegrity.report.tables import solution
from pntegrity.report.terminal import verdict_table
from pntegrity.report.write import write_results
from pntegrity.sensors.noise import CITY


@pytest.fixture(scope="module")
def outcomes():
    return drive.outcomes()


@pytest.fixture(scope="module")
def table(outcomes):
    return solution(outcomes, drive.facts())


@pytest.fixture(scope="module")
def numbers(outcomes, table):
    return summary(outcomes, drive.facts(), table)


def make(outcomes, facts) -> str:
    found = solution(outcomes, facts)
    return page(outcomes, facts, summary(outcomes, facts, found), found)


def figures(text):
    data = json.loads(re.search(r"id=.data.>(.*?)</script>", text).group(1))
    return {f["name"]: f for f in data["figures"]}


# --- tables -----------------------------------------------------------------------------------------------


def test_positions_and_their_errors_are_those_of_the_antenna(outcomes, table):
    xyz = table.select("x_m", "y_m", "z_m").to_numpy()
    assert np.array_equal(xyz, [solution_of(o.update.posterior).position_m for o in outcomes])
    imu = np.array([o.update.posterior.mean[:3] for o in outcomes])
    arm = float(np.linalg.norm(drive.ARM_M))
    assert np.linalg.norm(xyz - imu, axis=1) == pytest.approx(arm)
    expected = [drive.error_m(k) for k in range(drive.N)]
    assert table["error_h_m"].to_numpy() == pytest.approx(expected, abs=2e-3)  # the Earth is round


def test_velocity_is_told_east_north_up_with_sigma_and_error(table):
    speed = np.hypot(*table.select("ve_mps", "vn_mps").to_numpy().T)
    assert speed == pytest.approx(drive.SPEED_MPS, abs=0.11)
    assert table["sigma_vn_mps"].to_numpy() == pytest.approx(0.05)
    assert table["error_ve_mps"].to_numpy() == pytest.approx(0.1, abs=1e-3)
    assert table["error_vn_mps"].to_numpy() == pytest.approx(0.0, abs=1e-2)


def test_attitude_goes_over_north_without_a_step_in_its_error(table):
    assert table["roll_deg"].to_numpy() == pytest.approx(2.0, abs=0.02)
    heading = table["heading_deg"].to_numpy()
    assert heading.min() >= 0.0
    assert heading.max() < 360.0
    assert np.ptp(heading) > 300.0
    assert table["error_heading_deg"].to_numpy() == pytest.approx(1.0, abs=0.02)
    assert table["sigma_heading_deg"].to_numpy() == pytest.approx(0.5, abs=0.01)


def test_other_runs_have_velocities_and_no_attitude(faulty, facts):
    found = solution(faulty, facts)
    assert found["ve_mps"].null_count() == 0
    assert not {"roll_deg", "section", "gnss_age_s", "error_ve_mps"} & set(found.columns)
    speed = np.linalg.norm(found.select("ve_mps", "vn_mps", "vu_mps").to_numpy(), axis=1)
    ecef = np.linalg.norm(found.select("vx_mps", "vy_mps", "vz_mps").to_numpy(), axis=1)
    assert speed == pytest.approx(ecef)


def test_every_screened_epoch_has_a_row_and_every_dropped_row_its_iteration(outcomes):
    found, rows = screening(outcomes), dropped(outcomes)
    assert len(found) == drive.N
    street = found[drive.STREET.start].to_dicts()[0]
    assert (street["first"], street["last"], street["tests"], street["dropped"]) == (900.0, 12.0, 20, 2)
    assert (street["satellites_before"], street["satellites_after"]) == (10, 8)
    assert found["pdop_before"].is_infinite().sum() == len(drive.TUNNEL)
    assert found["first"].null_count() == len(drive.TUNNEL)
    assert not found["used"][drive.REFUSED]
    assert rows.group_by("key").agg(pl.col("iteration").unique()).sort("key").rows() == [
        ("G03:C1C", [1]), ("G07:C1C", [2])]  # fmt: skip
    assert rows["satellite"].to_list() == [group_of(k) for k in rows["key"]]
    for frame in (found, solution(outcomes, drive.facts())):
        assert not any(c.is_nan().any() for c in frame.iter_columns() if c.dtype.is_float())


def test_files_are_there_where_rows_were_screened_and_go_with_the_next_run(outcomes, clean, facts, tmp_path):
    paths = write_results(tmp_path, outcomes, drive.facts())
    assert len(pl.read_parquet(paths["screening"])) == drive.N
    assert len(pl.read_csv(paths["dropped"])) == 2 * len(drive.STREET)
    again = write_results(tmp_path, clean, facts)
    assert sorted(tmp_path.iterdir()) == sorted(again.values())


# --- sections ---------------------------------------------------------------------------------------------


def test_sections_are_told_from_what_the_receiver_saw(table):
    label = table["section"].to_list()
    assert all(label[k] == "denied" for k in (*drive.TUNNEL, drive.REFUSED))
    near = [k for k in range(drive.STREET.start - 5, drive.STREET.stop + 5) if k != drive.REFUSED]
    assert all(label[k] == "challenging" for k in near)
    assert all(label[k] == "open" for k in (0, 24, 65, 69, 100, 119))
    assert table["gnss_age_s"][drive.TUNNEL.start - 1 : drive.TUNNEL.start + 2].to_list() == [0.0, 1.0, 2.0]


def test_before_the_filter_runs_there_is_no_section(outcomes):
    from pntegrity.records import State

    u = outcomes[0].update
    waiting = replace(u, posterior=State.empty(u.t_ns), prior=State.empty(u.t_ns), keys=(), screening=None)
    found = solution([replace(outcomes[0], updates=(waiting,)), *outcomes[1:]], drive.facts())
    assert found["section"][0] is None
    assert found["gnss_age_s"][0] is None
    assert found["roll_deg"][0] is None


def test_given_sections_win_and_may_be_shorter(outcomes):
    facts = drive.facts(sections=("canyon",) * 50 + ("open",) * 20)
    found = summary(outcomes, facts)["sections"]
    assert found["source"] == "given"
    assert [(r["section"], r["epochs"]) for r in found["rows"]] == [
        ("open", 20), ("canyon", 50), ("all", drive.N)]  # fmt: skip


def test_errors_by_section_are_those_that_were_put_in(numbers):
    rows = {r["section"]: r for r in numbers["sections"]["rows"]}
    assert rows["open"]["horizontal_m"]["rms"] == pytest.approx(drive.ERROR_M, abs=2e-3)
    assert rows["challenging"]["horizontal_m"]["max"] == pytest.approx(drive.STREET_ERROR_M, abs=2e-3)
    worst = drive.error_m(drive.TUNNEL.stop - 1)
    assert rows["denied"]["spatial_m"]["max"] == pytest.approx(worst, abs=2e-3)
    assert rows["all"]["heading_deg"]["rms"] == pytest.approx(1.0, abs=0.02)
    assert rows["all"]["velocity_mps"]["mean"] == pytest.approx(0.1, abs=0.01)
    assert (rows["open"]["used"], rows["denied"]["used"]) == (1.0, 0.0)
    assert rows["open"]["hpl_m"] == pytest.approx(5.0)
    assert rows["denied"]["has_hpl"]
    assert rows["denied"]["hpl_m"] is None
    assert sum(rows[s]["share"] for s in ("open", "challenging", "denied")) == pytest.approx(1.0)


def test_a_dropped_range_rate_alone_does_not_make_a_street(outcomes):
    o = outcomes[65]
    rate = replace(o.update.screening, dropped=(("G01:D1C", 1),))
    changed = replace(o, updates=(o.update.altered(screening=rate),))
    found = summary([*outcomes[:65], changed, *outcomes[66:]], drive.facts())
    assert solution([changed], drive.facts())["section"].to_list() == ["open"]
    assert found["screening"]["dropped"]["rates"] == 1


# --- numbers and words ------------------------------------------------------------------------------------


def test_screening_in_numbers(numbers):
    s = numbers["screening"]
    assert (s["method"], s["variant"], s["epochs"]) == ("factor-set", "published", drive.N)
    assert s["used"]["epochs"] == drive.N - len(drive.TUNNEL) - 1
    assert s["dropped"]["rows"] == 2 * len(drive.STREET)
    first, second = s["dropped"]["satellites"]
    assert (first["satellite"], first["iterations"]) == ("G03", [30, 0, 0])
    assert (second["satellite"], second["iterations"]) == ("G07", [0, 30, 0])
    assert first["share"] == pytest.approx(30 / 90)
    assert s["dropped"]["rates"] == first["rates"] == 0
    assert s["missed"] == {"checked": 90, "failed": 1}
    assert s["false_alarm"] == {"checked": 90, "failed": 0}
    assert s["tests"]["max"] == 20
    assert s["araim_tests"]["max"] == araim_sets(10) == 175
    assert json.dumps(numbers, allow_nan=False)


def test_a_stretch_without_gnss_grows_the_sigma_and_a_short_one_does_not_count(outcomes, numbers):
    (found,) = outages(outcomes)
    assert found.seconds == len(drive.TUNNEL) + 1
    assert found.sigma_m[0] == pytest.approx(np.sqrt(2.0) * 0.4)
    assert found.sigma_m[1] == pytest.approx(np.sqrt(2.0) * drive.sigma_m(drive.TUNNEL.stop - 1))
    assert numbers["inertial"]["outages"]["longest"]["ended"]
    (open_end,) = outages(outcomes[: drive.TUNNEL.stop])
    assert not open_end.ended
    assert open_end.seconds == len(drive.TUNNEL)
    assert outages(outcomes[:60]) == []


def test_the_story_tells_the_tunnel_the_return_and_what_was_left_out(outcomes, numbers):
    told = [s.text for s in story(outcomes, drive.facts())]
    assert "06:16:09-06:16:40: 31 s without GNSS, bridged by the INS: horizontal sigma grew from 0.57 m to " \
        "13.3 m." in told  # fmt: skip
    assert "06:16:40: re-acquired after 30 s." in told
    (left,) = [t for t in told if "fault detection before the filter" in t]
    assert "left out 60 rows at 30 of 120 epochs, of G03 (30) and G07 (30); 31 epochs were not used" in left
    assert "Before them, the estimator's own fault detection left out 60 rows" in headline(numbers)[1]


def test_many_events_that_differ_by_a_number_are_one_sentence(outcomes):
    def renamed(k, o):
        u = replace(o.update, events=(f"re-acquired after {k % 5 + 2}.5 s",) if k % 10 == 5 else ())
        return replace(o, updates=(u,))

    told = [s.text for s in story([renamed(k, o) for k, o in enumerate(outcomes)], drive.facts())]
    (one,) = [t for t in told if "re-acquired" in t]
    assert "re-acquired after 2.5 s (12 times" in one


def test_a_filter_of_fixes_starts_from_one(outcomes):
    u = outcomes[0].update
    keys = ("fix:X", "fix:Y", "fix:Z", *u.keys[3:])
    told = story([replace(outcomes[0], updates=(u.altered(keys=keys),)), *outcomes[1:]], drive.facts())
    assert told[0].text == "06:15:00: filter started from a fix."


def test_the_same_stretch_again_and_again_is_one_sentence(outcomes):
    def spoilt(k, o):
        return (
            replace(o, status="alert", reason="ambiguous {}") if k % 2 and k < 24 else replace(o, status="ok")
        )

    told = [s.text for s in story([spoilt(k, o) for k, o in enumerate(outcomes)], drive.facts())]
    alarm = (
        "06:15:01-06:15:23: unresolved alert (ambiguous {}) (12 times, 12 epochs). Do not use the position."
    )
    assert alarm in told
    few = [s.text for s in story([spoilt(k, o) for k, o in enumerate(outcomes[:20])], drive.facts())]
    assert sum("Do not use the position" in t for t in few) == 10


def test_the_terminal_has_a_line_each(outcomes):
    out = StringIO()
    Console(file=out, width=140).print(verdict_table(outcomes, drive.facts()))
    text = out.getvalue()
    assert "sections    open RMS 0.50 m (42 %), challenging RMS 2.60 m (32 %), denied RMS 3.97 m" in text
    assert "attitude    sigma roll 0.50°, pitch 0.50°, heading 0.50°; heading RMS 1.0°" in text
    assert "screened    factor-set, published: 60 rows dropped, 89 of 120 epochs used" in text


# --- the page ---------------------------------------------------------------------------------------------


def test_the_page_has_map_sections_detection_and_attitude(outcomes):
    text = make(outcomes, drive.facts())
    found = figures(text)
    assert {"track", "screening", "attitude", "attitude-error"} <= set(found)
    assert all(f"id='fig-{n}'" in text for n in found)
    for title in ("Map", "Errors by section", "Fault detection before the filter", "Attitude"):
        assert f"<h2>{title}</h2>" in text
    assert [v["label"] for v in found["track"]["views"]] == ["Section", "Status"]
    assert {t["name"] for t in found["track"]["data"] if "name" in t} == {
        "truth", "open", "challenging", "denied", "ok", "unavailable"}  # fmt: skip
    assert found["track"]["layout"]["yaxis"]["scaleanchor"] == "x"
    assert any("HPL 5.00 m" in t for t in found["track"]["data"][1]["text"])
    assert any("HPL unbounded" in t for t in found["track"]["data"][1]["text"])
    styles = set(re.findall(r"(--[\w-]+):", text[: text.index("</style>")]))
    assert set(re.findall(r'"(--[\w-]+)"', json.dumps(found))) <= styles


def test_a_run_with_hardly_any_position_from_satellites_has_a_page(outcomes):
    mostly = [*outcomes[:3], *outcomes[drive.TUNNEL.start : drive.TUNNEL.stop]]
    blind = replace(outcomes[3].update.screening, pdop=(2.0, np.inf), first_limit=np.inf, last_limit=np.inf)
    more = replace(outcomes[3], updates=(outcomes[3].update.altered(screening=blind),))
    found = figures(make([*mostly[:3], more, *mostly[3:]], drive.facts()))
    assert "screening" in found
    layout = found["screening"]["layout"]
    assert all(np.isfinite(a.get("range", 0.0)).all() for k, a in layout.items() if k.startswith("yaxis"))


def test_without_truth_the_page_tells_sigmas_instead_of_errors(outcomes):
    text = make(outcomes, RunFacts(estimator="gnss_ins"))
    assert "attitude-error" not in figures(text)
    assert "<h2>By section</h2>" in text
    assert "Horizontal sigma, median" in text
    assert "Heading sigma" in text
    assert "No truth was given, so errors are not known" in text


def test_an_ins_without_detection_has_a_map_and_no_panel_of_detection(outcomes):
    bare = [replace(o, updates=(o.update.altered(screening=None),)) for o in outcomes]
    found = figures(make(bare, drive.facts()))
    assert {"track", "attitude"} <= set(found)
    assert "screening" not in found
    assert not len(screening(bare))


def test_a_receiver_that_stands_still_has_no_map(clean, facts):
    assert not {"track", "screening", "attitude"} & set(figures(make(clean, facts)))


def test_an_empty_run_of_an_ins_is_told():
    assert "No epoch was processed" in make([], drive.facts())


def test_truth_of_a_wrong_shape_is_named():
    with pytest.raises(ValueError, match="truth_attitude_rad"):
        RunFacts(truth_attitude_rad=np.zeros((5, 2)))


# --- blind spots ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (InsOptions(), "Each satellite has an error of its own"),
        (InsOptions(coupling="loose", fde="factor-set"), "Sets of pseudoranges are tested"),
        (InsOptions(coupling="loose", fde="lsr"), "one satellite at a time"),
        (InsOptions(coupling="loose", fde="none"), "are not tested"),
    ],
)
def test_what_an_ins_hides_depends_on_its_coupling(options, words):
    text = " ".join(blind_spots("gnss_ins", CITY, ins=options))
    assert words in text
    assert "Where GNSS is missing" in text
    assert "An error that most satellites share moves the position" in text
    absorbed = (
        f"{CITY.code_multipath_m:g} m at {CITY.cn0_ref_dbhz:g} dB-Hz and above, more below, "
        f"over {CITY.code_multipath_tau_s:g} s"
    )
    assert (absorbed in text) is (options.coupling == "tight")
