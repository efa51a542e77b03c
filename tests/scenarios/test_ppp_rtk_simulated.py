"""PPP-RTK integrity under nominal constellations: levels in four cases, the clock fault, misleading
information where errors last.
"""

from __future__ import annotations

import json

import numpy as np
import pytest

from pntegrity.scenarios import evidence_rtk_cases, evidence_rtk_risk, reproduce_ppp_rtk
from pntegrity.scenarios._rtk_risk_runs import campaign
from pntegrity.scenarios._rtk_simulated import facts, isms, model, sky
from pntegrity.scenarios.evidence_rtk_cases import in_order, span_of, submetre_s
from pntegrity.scenarios.results import CAMPAIGNS, run_campaign


@pytest.fixture(scope="module")
def where():
    return sky(None)


@pytest.fixture(scope="module")
def spans(where):
    return {n: span_of(where, n, "even", 31) for n in ("white, 30 s", "correlated, 30 s", "default, 30 s")}


def test_levels_rise_from_case_to_case(spans):
    for span in spans.values():
        assert in_order(span) == 0
        assert (span.level_m[3] > 1.05 * span.level_m[0]).all()


def test_an_order_that_is_wrong_is_seen(spans):
    from dataclasses import replace

    span = spans["white, 30 s"]
    assert in_order(replace(span, level_m=span.level_m[::-1])) == span.level_m.shape[1]


def test_products_that_last_make_levels_larger(spans):
    white, slow = (spans[n].level_m[:, -1] for n in ("white, 30 s", "correlated, 30 s"))
    assert (slow > 1.2 * white).all()


def test_levels_are_close_to_the_least_possible(spans):
    for span in spans.values():
        over = span.level_m / span.smallest_m
        assert over.min() >= 1.0 - 1e-9
        assert np.median(over[3]) < 1.12
        assert over[0] == pytest.approx(1.0, abs=1e-6)


def test_when_a_level_stays_below_a_limit():
    assert submetre_s(np.array([2.0, 0.5, 1.5, 0.9, 0.8]), 30.0, 1.0) == 90.0
    assert submetre_s(np.array([0.5, 0.4]), 30.0, 1.0) == 0.0
    assert submetre_s(np.array([0.5, np.inf]), 30.0, 1.0) is None


def test_the_split_of_araim_makes_hpl_larger_and_vpl_smaller(where, spans):
    other = span_of(where, "white, 30 s", "araim", 3)
    own = spans["white, 30 s"]
    assert (other.hpl_m[:, 2] > own.hpl_m[:, 2]).all()
    assert (other.vpl_m[:, 2] < own.vpl_m[:, 2]).all()


def test_the_cases_are_those_of_the_paper():
    cases = isms("even")
    assert [(i.p_sat, i.p_trop, i.p_iono) for i in cases.values()] == [
        (0, 0, 0), (1e-5, 0, 0), (1e-5, 1e-5, 0), (1e-5, 1e-5, 1e-5)
    ]  # fmt: skip
    assert facts()["published"]["p_hmi_per_h"] == cases["case1"].p_hmi == 1e-7
    assert model("white").product_tau_s == 0.0 < model("default").product_tau_s


@pytest.fixture(scope="module")
def lasting(where):
    return campaign(where, "default, 30 s", 25, 200, ("assumed", "harsher"), look=6)


def test_the_default_filter_says_how_good_it_is(lasting):
    ratio = np.array(lasting.figures["assumed"].ratio)[5:]
    assert ratio.min() > 0.9
    assert ratio.max() < 1.1
    assert np.array(lasting.figures["harsher"].ratio)[5:].mean() > ratio.mean()


def test_hidden_errors_stay_below_the_risk(lasting):
    found = lasting.figures["assumed"]
    assert found.trials.sum() > 10_000
    assert found.hits.sum() <= 1
    assert 0.0 < max(found.risk) < lasting.allowed
    assert np.mean(found.union) < 1e-6


def test_the_published_filter_is_too_sure(where):
    found = campaign(where, "white, 1 Hz", 60, 100, ("assumed",), look=60).figures["assumed"]
    assert np.array(found.ratio)[-1].max() > 3.0
    assert found.counted > 0.05 * found.tests


def test_a_clock_fault_is_seen_and_left_out_at_once(where):
    found = reproduce_ppp_rtk.clock_faults(where, "white", gps_in_view(where)[:1])
    assert len(found) == 1
    assert found[0].alarm_s == 0
    assert found[0].right
    assert found[0].inside
    assert 0.0 < found[0].worst < 1.0


def gps_in_view(where) -> tuple[str, ...]:
    epoch = where.epochs(model("white"), 1.0, 1, np.random.default_rng(0))[0]
    return tuple(dict.fromkeys(k[:3] for k in epoch.observations[0].keys if k[0] == "G"))


def test_the_re_test_names_the_right_satellite_more_often(where, monkeypatch):
    monkeypatch.setattr(reproduce_ppp_rtk, "SIZES_M", (0.2, 5.0))
    found = reproduce_ppp_rtk.named(where, "white", 1)
    assert found.alerts >= 10
    assert found.sure == 0
    assert found.exact >= 0.9 * found.alerts
    assert found.published <= found.exact


def test_reproduce_prints_rows(monkeypatch):
    from click.testing import CliRunner

    from pntegrity.cli.reproduce import command

    for name, value in {
        "ACCURACY": 62,
        "LEVELS": 3,
        "FAULT": 106,
        "SIZES_M": (5.0,),
        "MODELS": ("white",),
    }.items():
        monkeypatch.setattr(reproduce_ppp_rtk, name, value)
    monkeypatch.setattr(reproduce_ppp_rtk, "clock_faults", lambda *a: _one(*a))
    done = CliRunner().invoke(command, ["ppp-rtk", "--json", "--seeds", "1"], standalone_mode=False)
    rows = json.loads(done.output)["rows"]
    assert all({"quantity", "published", "measured", "ok", "note"} <= set(r) for r in rows)
    assert any("as printed" in r["quantity"] and r["ok"] is False for r in rows)
    assert sum("case" in r["quantity"] for r in rows) == 4


def _one(where, name):
    return [reproduce_ppp_rtk.ClockFault("G01", 0, True, True, 0.5, 10, ())]


def test_campaigns_without_data_say_so():
    for name in ("rtk-cases", "rtk-risk", "ppp-rtk"):
        assert CAMPAIGNS[name].real
        assert run_campaign(name, None)[0]["quantity"] == "not run"


def test_campaigns_skip_where_the_orbits_are_missing(tmp_path):
    for run in (evidence_rtk_cases.cases, evidence_rtk_risk.risk):
        assert run(tmp_path)[0]["quantity"] == "not run"
