from dataclasses import replace

import numpy as np
import pytest
from simulated import START_NS, TRUTH

from pntegrity.report.facts import RunFacts
from pntegrity.report.tables import exclusions, solution, suspect_text, verdicts


def test_every_epoch_appears_once_in_the_solution(faulty, facts):
    table = solution(faulty, facts)
    assert table["t_ns"].to_list() == [o.t_ns for o in faulty]
    assert table["status"].to_list() == [o.status for o in faulty]
    assert table["time_gps"][0] == "2019-01-14T06:15:00"


def test_numbers_are_null_or_finite(faulty, facts):
    for known in (facts, replace(facts, truth_m=None)):
        for table in (solution(faulty, known), verdicts(faulty), exclusions(faulty)):
            for column in table.select(["^.*$"]).iter_columns():
                if column.dtype.is_float():
                    assert column.is_nan().sum() == 0


def test_position_and_error_agree_with_the_state(faulty, facts):
    table = solution(faulty, facts)
    xyz = table.select("x_m", "y_m", "z_m").to_numpy()
    assert np.array_equal(xyz, [o.update.posterior.mean[:3] for o in faulty])
    enu = table.select("error_e_m", "error_n_m", "error_u_m").to_numpy()
    assert np.linalg.norm(enu, axis=1) == pytest.approx(np.linalg.norm(xyz - TRUTH, axis=1))
    assert table["error_h_m"].to_numpy() == pytest.approx(np.hypot(enu[:, 0], enu[:, 1]))
    assert enu[20:, :2] == pytest.approx(0.0, abs=2.0)


def test_sigmas_keep_the_trace_of_the_covariance(faulty, facts):
    table = solution(faulty, facts)
    trace = [np.trace(o.update.posterior.P[:3, :3]) for o in faulty]
    total = table.select("sigma_e_m", "sigma_n_m", "sigma_u_m").to_numpy() ** 2
    assert total.sum(axis=1) == pytest.approx(trace)


def test_truth_may_be_shorter_than_the_run_and_have_holes(faulty, facts):
    truth = np.tile(TRUTH, (50, 1))
    truth[10] = np.nan
    error = solution(faulty, replace(facts, truth_m=truth))["error_e_m"]
    assert error[10] is None
    assert error[11] is not None
    assert error[50:].null_count() == len(faulty) - 50


def test_verdicts_have_one_final_row_an_epoch_and_monitor(faulty):
    table = verdicts(faulty)
    final = table.filter(table["final"])
    assert len(final) == sum(len(o.verdicts) for o in faulty)
    first = table.filter(~table["final"])
    changed = sum(a != b for o in faulty for a, b in zip(o.first, o.verdicts, strict=True))
    assert len(first) == changed > 0
    assert first["status"].eq("alert").any()


def test_untested_verdicts_have_a_reason_and_no_numbers(faulty):
    table = verdicts(faulty)
    untested = table.filter(table["status"] == "unavailable")
    assert len(untested)
    assert untested["statistic"].null_count() == len(untested)
    assert (untested["reason"].str.len_chars() > 0).all()


def test_exclusions_name_onset_size_and_return(faulty):
    table = exclusions(faulty)
    assert table["key"].to_list() == ["G05", "E12"]
    ramp, bias = table.to_dicts()
    assert ramp["estimated_rate"] == pytest.approx(0.2, abs=0.1)
    assert bias["estimated_rate"] is None
    assert bias["estimated_bias"] == pytest.approx(50.0, abs=2.0)
    assert all(row["readmitted_gps"] > row["time_gps"] for row in (ramp, bias))


def test_suspects_in_words(unresolved):
    suspect = next(s for o in unresolved for v in o.verdicts for s in v.suspects if s.kind == "ramp")
    text = suspect_text(suspect)
    assert text.startswith("+".join(suspect.groups))
    assert "/s since 06:15:" in text
    assert "explains" in text
    assert "ramp 0.00067/s since" in suspect_text(replace(suspect, size=0.02 / 30.0))


def test_an_empty_run_has_empty_tables():
    assert [len(t) for t in (solution([], RunFacts()), verdicts([]), exclusions([]))] == [0, 0, 0]


def test_truth_of_a_wrong_shape_is_refused():
    with pytest.raises(ValueError, match="truth_m"):
        RunFacts(truth_m=np.zeros((5, 2)))


def test_times_are_those_of_the_epochs(faulty, facts):
    assert solution(faulty, facts)["t_ns"][0] == START_NS
