"""The PPP experiment of the SRAIME paper: what its statistic's false-alarm rate is, and who sees the ramp
when.
"""

from __future__ import annotations

import json

import numpy as np
import pytest

from pntegrity.scenarios import reproduce_sraime_ppp
from pntegrity.scenarios._ppp_logs import CARD, ESBC
from pntegrity.scenarios._ppp_runs import Case, Experiment, monitors_of, simulated_drive
from pntegrity.scenarios._spp_runs import Interval


@pytest.fixture(scope="module")
def case() -> Case:
    """GINav's noise and motion, under nominal constellations."""
    e = Experiment.load()
    e.facts["span"]["first_s"], e.facts["span"]["quiet_s"] = 1400, 1570
    return Case.of(e, simulated_drive(e["last_s"] + 1, e["systems"]), "literature", "velocity")


@pytest.fixture(scope="module")
def white(case):
    """Each satellite at fault in turn, three noises each."""
    rng = np.random.default_rng(3)
    noise = case.noise(3 * len(case.carriers), rng)
    means = zip(*(case.means(k) for k in case.carriers), strict=True)
    return [n + np.repeat(np.stack(m, axis=1), 3, axis=1) for n, m in zip(noise, means, strict=True)]


def first_s(case, alarm) -> int:
    found = Interval.of(alarm, case.experiment["onset_s"] - case.experiment["quiet_s"])
    assert found.first_s is not None
    return found.first_s + case.experiment["quiet_s"]


@pytest.mark.parametrize("name", ["RCTM", "SRAIME (exact), position", "SRAIME (exact), both", "AIME (exact)"])
def test_exact_tests_keep_their_false_alarm_rate(case, name):
    assert case.real_p_fa(monitors_of(case.experiment)[name]) == pytest.approx(1e-6, rel=0.05)


def test_the_published_test_alarms_thousands_of_times_too_often(case):
    each = monitors_of(case.experiment)
    assert 0.005 < case.real_p_fa(each["SRAIME (published), position"]) < 0.2
    assert case.real_p_fa(each["SRAIME (published), ambiguities"]) > 0.5


def test_at_an_honest_threshold_the_position_does_not_see_the_ramp(case, white):
    monitor = monitors_of(case.experiment)["SRAIME (published), position"]
    assert case.alarms(monitor, white).any(axis=0).mean() > 0.8
    assert case.alarms(monitor, white, honest=True).any(axis=0).mean() < 0.2


def test_nobody_is_faster_than_the_best_test_and_the_bank_is_next(case, white):
    each = monitors_of(case.experiment)
    bank = first_s(case, case.glr_alarms(white))
    aime = first_s(case, case.alarms(each["AIME (exact)"], white))
    ambiguities = first_s(case, case.alarms(each["SRAIME (exact), ambiguities"], white))
    best = np.median([case.bound_s(k) for k in case.carriers])
    assert 1600 < best <= bank <= aime <= ambiguities < 1650


def test_settings_closest_to_the_printed_times_are_found():
    e = Experiment.load()
    rows = [
        {"quantity": f"alarms: {name}", "measured": {"SRAIME": times}}
        for name, times in (("a", [1605, 1674]), ("b", [1618, 1661]), ("c", []))
    ]
    found = reproduce_sraime_ppp._closest(e, rows, "SRAIME")
    assert (found["measured"], found["note"], found["ok"]) == ([1618, 1661], "b", True)
    assert json.loads(json.dumps(found))["published"] == [1617, 1660]


def test_logs_that_are_not_there_are_told(tmp_path):
    assert "is not here" in ESBC.missing(tmp_path)
    assert "is not here" in CARD.missing(tmp_path)
