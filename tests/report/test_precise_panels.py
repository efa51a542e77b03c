import json
import re
from dataclasses import replace
from io import StringIO

import numpy as np
import pytest
import simulated_precise as sim
from rich.console import Console

from pntegrity.evaluate.whiteness import judged
from pntegrity.report.facts import RunFacts
from pntegrity.report.figures import frame, satellites
from pntegrity.report.html import page
from pntegrity.report.panels import half_range, log_range, position
from pntegrity.report.precise import carrier_arcs
from pntegrity.report.sky import label_sides
from pntegrity.report.story import story
from pntegrity.report.summary import summary
from pntegrity.report.tables import exclusions, solution
from pntegrity.report.terminal import verdict_table


@pytest.fixture(scope="module")
def precise():
    return sim.run()


@pytest.fixture(scope="module")
def known():
    return RunFacts(estimator="ppp", noise_name="default", truth_m=np.tile(sim.TRUTH, (40, 1)))


def test_arcs_live_from_birth_to_end_with_their_cause(precise):
    lives = {(a.group, a.cause): (a.start, a.stop) for a in carrier_arcs([o.update for o in precise])}
    assert lives["G01", "start"] == (0, 40)
    assert lives["G02", "start"] == (0, sim.CUT_AT)
    assert lives["G02", "cut"] == (sim.CUT_AT, 40)
    assert lives["E07", "view"] == (sim.RISES_AT, 40)
    assert lives["E05", "start"] == (0, sim.GONE_AT)
    assert lives["E05", "left out"] == (sim.GONE_AT, 40)
    assert lives["G04", "start"] == (0, sim.SETS_AT)
    assert len(lives) == 9


def test_an_update_without_states_ends_all_arcs(precise):
    first = [o.update for o in precise[:4]]
    again = [*first, *(o.update for o in sim.run(3))]
    assert [(a.start, a.stop) for a in carrier_arcs(again) if a.group == "G01"] == [(0, 4), (4, 7)]


def test_the_solution_counts_arcs_and_tells_the_wet_delay(precise, known):
    table = solution(precise, known)
    born = {sim.RISES_AT: 1, sim.CUT_AT: 1, sim.GONE_AT: 1, 0: 6}
    assert table["n_arcs_born"].to_list() == [born.get(k, 0) for k in range(40)]
    assert [table["n_arcs"][k] for k in (0, sim.RISES_AT, sim.SETS_AT)] == [6, 7, 6]
    i = precise[12].update.posterior.layout.index["zwd"]
    assert table["zwd_m"][12] == precise[12].update.posterior.mean[i]
    assert table["sigma_zwd_m"][12] == pytest.approx(np.sqrt(precise[12].update.posterior.P[i, i]))
    assert {"grad_n_m", "sigma_grad_e_m"} <= set(table.columns)


def test_other_filters_have_no_wet_delay_and_no_arcs(clean, facts):
    table = solution(clean, facts)
    assert table["zwd_m"].null_count() == len(table)
    assert table["n_arcs"].sum() == 0
    assert "grad_n_m" not in table.columns


def test_a_position_that_is_not_earth_fixed_has_no_east(precise):
    o = precise[5]
    mean = o.update.posterior.mean.copy()
    mean[:3] = 1.0, 2.0, 3.0
    near = replace(o.update.posterior, mean=mean)
    row = solution([replace(o, updates=(o.update.altered(posterior=near),))], RunFacts()).to_dicts()[0]
    assert row["x_m"] == 1.0
    assert row["lat_deg"] is row["sigma_e_m"] is row["sigma_u_m"] is row["error_e_m"] is None


def test_births_say_nothing_in_the_panel_of_carriers(precise):
    figure = satellites(frame(precise))
    assert [label for label, _ in figure.views] == ["Code", "Carrier"]
    assert figure.views[1][1] == (2, 3)
    carrier = figure.data[2]
    import base64

    z = np.frombuffer(base64.b64decode(carrier["z"]["packed"]), dtype="<i2").reshape(len(carrier["y"]), -1)
    lane = carrier["y"].index("G02")
    nothing = np.iinfo(np.int16).min
    assert [k for k in range(40) if z[lane, k] == nothing] == [0, sim.CUT_AT]
    row = precise[15].update.keys.index("G02:L1C+L2W")
    assert z[lane, 15] * 0.01 == pytest.approx(judged(precise[15].update)[row], abs=0.006)


def test_centimetres_where_these_fit(precise, known, clean, facts):
    text = json.dumps(position(frame(precise), solution(precise, known)).layout, ensure_ascii=False)
    assert "<b>Up</b>, cm" in text
    assert "<b>Up</b>, m" in json.dumps(position(frame(clean), solution(clean, facts)).layout)


def test_the_page_of_a_precise_run(precise, known):
    table = solution(precise, known)
    text = page(precise, known, summary(precise, known, table), table)
    data = json.loads(re.search(r"id=.data.>(.*?)</script>", text).group(1))
    assert [f["name"] for f in data["figures"] if f["name"] in ("arcs", "troposphere")] == [
        "arcs",
        "troposphere",
    ]
    assert "id='fig-arcs'" in text
    assert "<th>15 min</th>" in text
    assert "<tr><th>Carrier</th>" in text
    styles = set(re.findall(r"(--[\w-]+):", text[: text.index("</style>")]))
    assert set(re.findall(r'"(--[\w-]+)"', json.dumps(data))) <= styles


def test_a_filter_without_carriers_has_no_such_panels(clean, facts):
    table = solution(clean, facts)
    text = page(clean, facts, summary(clean, facts, table), table)
    assert "fig-arcs" not in text
    assert "fig-troposphere" not in text
    assert "<tr><th>Carrier</th>" not in text


def test_small_sizes_keep_their_digits(precise, known):
    (told,) = [s.text for s in story(precise, known) if s.kind == "excluded"]
    assert "GLR: ramp 0.67 mm/s since" in told
    assert exclusions(precise)["estimated_rate"][0] == pytest.approx(0.02 / 30.0)
    out = StringIO()
    Console(file=out, width=120).print(verdict_table(precise, known))
    assert re.search(r"RMS \d+\.\d [cm]m horizontal", out.getvalue())


def test_names_in_the_sky_keep_off_their_tracks_and_off_each_other():
    up, down = np.array([20.0, 30.0]), np.array([30.0, 20.0])
    north = np.zeros(2)
    assert label_sides({"G01": (up, north)})["G01"] != "top center"  # the track lies there
    assert label_sides({"G01": (down, north)})["G01"] != "bottom center"
    close = label_sides({f"G0{i}": (np.array([40.0]), np.array([90.0 + i])) for i in range(3)})
    assert len(set(close.values())) == 3
    assert label_sides({}) == {}


def test_a_wide_start_does_not_set_the_scale_but_an_error_beyond_its_band_does():
    band_m = np.concatenate([np.full(4, 90.0), np.full(96, 0.1)])
    error = np.concatenate([np.full(4, 20.0), np.full(96, 0.02)])
    assert half_range(band_m, error) == pytest.approx(1.12 * 0.1)
    error[50] = 0.3
    assert half_range(band_m, error) == pytest.approx(1.12 * 0.3)
    error[2] = 100.0
    assert half_range(band_m, error) == pytest.approx(1.12 * 100.0)
    nothing = np.full(5, np.nan)
    assert half_range(nothing, nothing) == pytest.approx(1.12)


def test_a_blind_test_is_drawn_however_small_its_statistic():
    threshold = np.full(50, 30.0)
    low, high = log_range(np.concatenate([np.full(50, 1e-9), threshold]), threshold)
    assert low < 1e-9
    assert high == pytest.approx(90.0)
