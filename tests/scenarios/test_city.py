"""Evidence of fusion in the city: what the tables say of a run, and the methods on a part of the drive."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from pntegrity.errors import InputError
from pntegrity.scenarios import evidence_city, evidence_city_tst, reproduce_factor_set
from pntegrity.scenarios._city_runs import (
    EKF,
    EXACT,
    LSR,
    METHODS,
    OURS,
    PUBLISHED,
    WEIGHTED,
    Tracked,
    estimator_for,
    track,
    trained,
)
from pntegrity.scenarios._city_tables import (
    CHALLENGING,
    HEADING,
    HORIZONTAL,
    SPACE,
    WHOLE,
    error_rows,
    gain,
    gain_row,
    rmse,
    subset_rows,
    use_row,
    wrong_row,
)
from pntegrity.scenarios._urban_logs import missing, nagoya_log, open_log
from pntegrity.scenarios.evidence_city_nees import CASES, interval_of, nees_of
from pntegrity.scenarios.reproduce_factor_set import TABLES, figures, published, rows_of
from pntegrity.sensors.imu import STIM300


def made(size: float, n: int = 9) -> Tracked:
    """Return a run whose errors are `size` times 3, 4, 12 m, in three sections in turn."""
    position = size * np.tile([3.0, 4.0, 12.0], (n, 1))
    attitude = np.deg2rad(size) * np.tile([0.0, 0.0, -1.0], (n, 1))
    used = np.arange(n) % 3 != 2
    return Tracked(
        position, 0.1 * position, attitude, np.ones(n), used, np.where(used, 7, 0), np.full((n, 2), 16),
        np.ones((n, 2)), np.where(used, 20.0 * size, np.nan),
        np.array(["open", "challenging", "denied"] * (n // 3)),
    )  # fmt: skip


@pytest.fixture
def found():
    """Two seeds of every method; the EKF is 10 times as wrong as ours."""
    sizes = {EKF: 1.0, WEIGHTED: 0.5, LSR: 0.85, PUBLISHED: 0.4, EXACT: 0.3, OURS: 0.1}
    return {n: [made(s), made(1.2 * s)] for n, s in sizes.items()}


def test_errors_are_those_of_the_section(found):
    run = found[EKF][0]
    run = replace(run, position_m=np.where(run.kind[:, None] == "denied", 2.0, 1.0) * run.position_m)
    assert rmse([run], HORIZONTAL, "open") == pytest.approx([5.0])
    assert rmse([run], SPACE, "denied") == pytest.approx([26.0])
    assert rmse([run], HORIZONTAL) == pytest.approx([np.sqrt((6 * 25 + 3 * 100) / 9)])
    assert rmse([run], HEADING, CHALLENGING) == pytest.approx([1.0])


def test_epochs_before_the_start_are_left_out(found):
    run = found[EKF][0]
    late = replace(run, position_m=np.where(np.arange(9)[:, None] < 4, np.nan, run.position_m))
    assert rmse([late], HORIZONTAL) == pytest.approx([5.0])
    assert use_row("x", {EKF: [late]}, "y")["measured"] == {EKF: "55.6 / 66.7"}


def test_the_interval_of_a_gain_holds_the_gain_and_shrinks_with_seeds():
    rng = np.random.default_rng(1)
    reference = 10.0 + rng.standard_normal(40)
    method = 0.5 * reference + 0.5 * rng.standard_normal(40)
    value, (low, high) = gain(method, reference)
    few, (low_few, high_few) = gain(method[:8], reference[:8])
    assert low < value < high
    assert low_few < few < high_few
    assert value == pytest.approx(50.0, abs=3.0)
    assert high - low < high_few - low_few


@pytest.mark.parametrize(
    ("least", "most", "ok"), [(75.0, np.inf, True), (95.0, np.inf, False), (10.0, 25.0, False)]
)
def test_a_gain_is_judged_by_both_ends(found, least, most, ok):
    judged = gain_row("x", found, "y", OURS, HORIZONTAL, least, most)
    assert judged["ok"] is ok
    assert judged["measured"] == "90.0"


def test_errors_of_all_methods_in_all_sections_are_told(found):
    rows = error_rows("x", found, "label")
    assert len(rows) == 12
    assert rows[0]["measured"][OURS] == "0.55 / 1.43"
    only = {n: [replace(t, kind=np.full(9, CHALLENGING)) for t in r] for n, r in found.items()}
    assert [WHOLE in r["quantity"] for r in error_rows("x", only, "label")] == [True] * 3


def test_subsets_stand_beside_those_of_araim(found):
    (told,) = subset_rows("x", found, "y", [PUBLISHED])
    assert told["measured"] == "7 / 7"
    assert "ARAIM for three faults: 696 / 696" in told["note"]


def test_wrong_fixes_that_were_used_are_counted(found):
    told = wrong_row("x", found, "y")["measured"]
    assert told[EKF] == "100.0 of 6"
    assert told[PUBLISHED] == "50.0 of 6"
    assert told[OURS] == "0.0 of 6"


def test_a_section_where_another_method_is_better_is_named(found):
    assert evidence_city._everywhere_row("x", found, "y")["ok"]
    worse = [
        replace(t, position_m=t.position_m * (1 + 9 * (t.kind[:, None] == "denied"))) for t in found[OURS]
    ]
    told = evidence_city._everywhere_row("x", {**found, OURS: worse}, "y")
    assert told["ok"] is False
    assert f"denied, horizontal: {EXACT}" in told["note"]


def test_the_real_log_is_judged_by_share_and_size(found):
    share, size = evidence_city_tst._rows(found, "STIM300")[:2]
    assert (share["measured"], share["ok"]) == ("10.0", True)
    assert (size["measured"], size["ok"]) == ("0.55", True)
    wrong = evidence_city_tst._rows({**found, OURS: found[EKF]}, "STIM300")
    assert [r["ok"] for r in wrong[:2]] == [False, False]


def test_campaigns_without_data_say_so(tmp_path):
    for campaign in (
        evidence_city.moderate,
        evidence_city.full,
        evidence_city.open_sky,
        evidence_city_tst.tst,
    ):
        (only,) = campaign(tmp_path)
        assert only["ok"] is None
        assert "is not here" in only["note"]


# --- the paper's tables -------------------------------------------------------------------------------------


def test_the_papers_improvements_follow_from_its_tables():
    whole = published()["position"][WHOLE]
    ours = [round(100.0 * (1.0 - m / e), 1) for m, e in zip(whole["factor_set"], whole["EKF"], strict=True)]
    assert ours == [41.5, 59.5, 60.6, 52.2, 56.9]
    motion = published()["motion"][WHOLE]
    assert round(100.0 * (1.0 - motion["factor_set"][5] / motion["EKF"][5]), 1) == 52.1


def test_figures_have_the_papers_axes_and_order(found):
    run = replace(found[EKF][0], attitude_rad=np.deg2rad(np.tile([1.0, 2.0, -3.0], (9, 1))))
    position, motion, horizontal, heading = TABLES
    assert figures(position, [run], WHOLE) == pytest.approx([4.0, 3.0, 12.0, 5.0, 13.0])
    assert figures(motion, [run], "open") == pytest.approx([0.4, 0.3, 1.2, 1.0, 2.0, 3.0])
    assert figures(horizontal, [run], "denied") == pytest.approx([5.0, 5.0, 0.0])
    assert figures(heading, [run], "denied") == pytest.approx([3.0, 3.0, 0.0])


def test_every_table_of_the_paper_has_a_row_a_method(found):
    rows = list(rows_of(found, published()))
    assert len(rows) == (4 + 4 + 3 + 3) * 5
    assert {r["quantity"].partition(",")[0] for r in rows} == {f"table {n}" for n in range(5, 15)}
    assert sum(r["published"] is None for r in rows) == 14 * 2
    assert json.loads(json.dumps(rows))[0]["published"] == "4.157 / 5.504 / 8.014 / 6.898 / 10.574"


def test_reproducing_needs_data_and_seeds_that_there_are(tmp_path):
    with pytest.raises(InputError, match="no folder was given"):
        reproduce_factor_set.reproduce()
    with pytest.raises(InputError, match="is not here"):
        reproduce_factor_set.reproduce(data=tmp_path)
    with pytest.raises(InputError, match="1 to 20 seeds"):
        reproduce_factor_set.reproduce(21, data=tmp_path)


# --- on real data -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def street(shared):
    """A minute under the open sky and two in a street, of a drive at moderate load."""
    if lost := missing(shared):
        pytest.skip(lost)
    return part_of(nagoya_log(shared, "moderate", 1000, STIM300), 400, 560)


def part_of(log, first: int, last: int):
    cut = slice(first, last)
    arrays = {
        n: getattr(log, n)[cut] for n in ("position_m", "velocity_mps", "axes", "antenna_m", "imu_errors")
    }
    return replace(log, epochs=log.epochs[cut], kind=log.kind[cut], **arrays)


def test_every_method_navigates_and_ours_is_best(street):
    runs = {n: track(street, m) for n, m in METHODS.items()}
    errors = {n: float(rmse([r], HORIZONTAL)[0]) for n, r in runs.items()}
    assert min(errors, key=lambda n: errors[n]) == OURS
    assert errors[OURS] < 0.5 * errors[EKF]
    assert all(np.isfinite(r.position_m).all() for r in runs.values())
    assert runs[EKF].used.all()
    assert np.isfinite(runs[EKF].fix_m).all()
    assert np.nanmedian(runs[EKF].fix_m[:40]) < 5.0
    assert np.isnan(runs[OURS].fix_m).all()
    assert runs[PUBLISHED].tests.max() > runs[LSR].tests.max() > 1
    assert (runs[OURS].satellites[:, 1] <= runs[OURS].satellites[:, 0]).all()
    assert np.nanmedian(runs[OURS].sigma_m) < 3.0


def test_a_run_is_the_same_again(street):
    again = [track(part_of(street, 0, 30), METHODS[OURS]).position_m for _ in range(2)]
    np.testing.assert_array_equal(*again)


def test_thresholds_are_what_the_open_sky_teaches(street):
    sky = part_of(street, 0, 45)
    for variant in ("published", "exact"):
        training = trained(sky, variant)
        assert training.accepted == 45
        assert 1.0 < training.factors.missed_limit_m < 18.0
        assert training.factors.false_alarm_limit_m < 30.0


def test_the_estimator_of_a_method_has_its_options(street):
    options = estimator_for(street, OURS).options
    assert (options.ins.coupling, options.ins.fde) == ("tight", "ours")
    assert options.ins.lever_arm_m == street.lever_arm_m


def test_nees_of_a_filter_with_the_right_model_is_that_of_its_states(shared):
    if lost := missing(shared):
        pytest.skip(lost)
    case = CASES["tight, no tests"]
    low, high = interval_of(9, 4)
    logs = [open_log(shared, case.noise, s, STIM300, 200.0, 230.0) for s in range(4)]
    last = [nees_of(log, case, np.random.default_rng(s))[:, -1] for s, log in enumerate(logs)]
    assert low < np.mean(last, axis=0)[0] < high
    too_sure = replace(case, noise=replace(case.noise, doppler_mps=0.01))
    wrong = [nees_of(log, too_sure, np.random.default_rng(s))[0, -1] for s, log in enumerate(logs[:1])]
    assert np.mean(wrong) > high
