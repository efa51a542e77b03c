"""The reproduction of SRAIME's Table 1: shape, honesty and the findings that must not change silently."""

import io
import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

from pntegrity.scenarios._spp_runs import Case, Experiment, Interval, alarms, nominal_threshold, real_p_fa
from pntegrity.scenarios.reproduce_sraime_spp import reproduce

PUBLISHED = Path(__file__).resolve().parents[3] / "shared/reference/published.toml"


@pytest.fixture(scope="module")
def result():
    return reproduce(4, tests=5000, grid=False)


@pytest.fixture(scope="module")
def rows(result):
    return {(r["quantity"], i): r for i, r in enumerate(result.rows)}


def pick(rows, *words):
    found = [r for (q, _), r in rows.items() if all(w in q for w in words)]
    assert len(found) == 1, (words, [r["quantity"] for r in found])
    return found[0]


def test_json_is_an_object_of_rows(result):
    read = json.loads(result.to_json())
    assert list(read) == ["rows"]
    assert all(set(r) == {"quantity", "published", "measured", "ok", "note"} for r in read["rows"])
    assert all(r["ok"] in (True, False, None) for r in read["rows"])


def test_the_published_figures_are_those_of_the_reference():
    if not PUBLISHED.is_file():
        pytest.skip("shared reference not here")
    reference = tomllib.loads(PUBLISHED.read_text(encoding="utf-8"))["sraime"]["spp"]["alarms_s"]
    assert Experiment.load().facts["published"] == reference


def test_table_1_comes_out_where_the_fault_is_added_to_the_filter(rows):
    for name in ("RCTM", "SRCTM", "AIME", "SRAIME"):
        assert pick(rows, f"of {name} (published), s", "filter's")["ok"] is True


def test_the_exact_variants_do_not_alarm_when_the_paper_says(rows):
    assert pick(rows, "of SRAIME (exact), s", "filter's")["measured"] == []
    assert pick(rows, "of AIME (exact), s", "receiver's")["measured"] == []


def test_the_claim_does_not_hold_at_matched_false_alarm_rates(rows):
    for reading in ("receiver's", "filter's"):
        assert pick(rows, "ahead of AIME at matched", reading)["ok"] is False


def test_no_honest_test_can_see_the_fault_at_216_s(rows):
    assert pick(rows, "earliest time", "filter's")["measured"] == 249
    assert pick(rows, "earliest time", "receiver's")["measured"] is None


def test_the_bound_is_the_power_of_the_matched_filter():
    case = Case.of(Experiment.load(), 0.03, 0.01)
    bound = case.bound_s("filter")
    mean = case.means["filter"][: bound + 1]
    noise = np.random.default_rng(0).standard_normal((4000, *mean.shape))
    statistic = np.einsum("ij,rij->r", mean, noise + mean) / np.sqrt((mean**2).sum())
    assert np.mean(statistic > 4.7534) == pytest.approx(0.5, abs=0.1)


def test_the_exact_distribution_agrees_with_drawn_alarms():
    experiment = Experiment.load()
    case = Case.of(experiment, 0.03, 0.01)
    forms = case.forms(experiment.monitors("published")["SRAIME"])
    white = np.random.default_rng(1).standard_normal((len(case.updates), 20, 300))
    rate = alarms(forms, white, [nominal_threshold(f, 1e-6) for f in forms])[200:].mean()
    assert rate == pytest.approx(real_p_fa(forms[-1], 1e-6), rel=0.15)


def test_an_interval_needs_half_of_the_runs():
    alarm = np.zeros((10, 4), dtype=bool)
    alarm[6:9, 0] = True
    assert Interval.of(alarm, 5).as_list == []
    alarm[7, 1] = True
    assert Interval.of(alarm, 5).as_list == [6, 8]
    assert Interval.of(alarm, 5).reproduces([6, 8], 1.0)
    assert not Interval.of(alarm, 5).reproduces([], 1.0)


def test_the_table_renders(result):
    from rich.console import Console

    console = Console(width=200, record=True, file=io.StringIO())
    console.print(result.table())
    assert "216-314" in console.export_text()


def test_impossible_numbers_of_runs_are_refused():
    with pytest.raises(ValueError, match="at least 1"):
        reproduce(0)
