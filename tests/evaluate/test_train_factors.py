"""Thresholds from fault-free history."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest

from pntegrity.config import to_toml
from pntegrity.errors import InputError
from pntegrity.evaluate.train_factors import LEAST, train_factors, training_tables, without_limits
from pntegrity.kernels.factor_set import FactorMemory, FactorSet, screen_factor_set
from pntegrity.scenarios.evidence_factor_set_rate import sky, with_noise
from pntegrity.verdicts import Screening


def consistent(missed, false_alarm):
    return Screening("factor-set", missed_m=missed, false_alarm_m=false_alarm)


def test_thresholds_are_mean_plus_alpha_sigma_of_the_accepted_epochs():
    missed, distance = np.arange(40.0) + 1.0, 0.5 * np.arange(40.0)
    others = [
        consistent(float("nan"), 500.0),  # stayed inconsistent
        consistent(float("inf"), 1.0),
        Screening("factor-set", used=False, reason="too few"),
    ]
    history = [*map(consistent, missed, distance), *others]
    trained = train_factors(history, FactorSet("published", sigma_m=2.0), alpha=3.0, gamma=4.0)
    spread = np.sqrt(40 * 41 / 12.0)  # of 1, 2, ..., 40
    assert (trained.accepted, trained.epochs) == (40, 43)
    assert trained.factors.missed_limit_m == pytest.approx(20.5 + 3.0 * spread)
    assert trained.factors.false_alarm_limit_m == pytest.approx(0.5 * 19.5 + 4.0 * 0.5 * spread)
    assert (trained.factors.variant, trained.factors.sigma_m) == ("published", 2.0)


def test_training_on_a_clean_sky_accepts_the_next_clean_day():
    options, rng = FactorSet(), np.random.default_rng(3)
    skies = [sky(int(rng.integers(9, 15)), rng) for _ in range(120)]

    def day(options):
        memory, found = FactorMemory(), []
        for rows in skies:
            screening, _, _, memory = screen_factor_set(options, memory, with_noise(rows, rng))
            found.append(screening)
        return found

    trained = train_factors(day(without_limits(options)), options)
    assert trained.accepted == 120
    used = [s.used for s in day(trained.factors)]
    assert np.mean(used) > 0.95
    tight = train_factors(day(without_limits(options)), options, alpha=0.0)
    assert 0.3 < np.mean([s.used for s in day(tight.factors)]) < 0.8  # half lie below their mean


def test_limits_of_before_do_not_cut_the_history_off():
    free = without_limits(FactorSet(missed_limit_m=0.1, false_alarm_limit_m=0.1))
    screening = screen_factor_set(free, FactorMemory(), sky(10, np.random.default_rng(1)))[0]
    assert screening.used


def test_too_little_history_is_refused():
    history = [consistent(1.0, 1.0)] * (LEAST - 1) + [consistent(float("nan"), 1.0)] * 100
    with pytest.raises(InputError, match=f"only {LEAST - 1} of {LEAST + 99} epochs"):
        train_factors(history, FactorSet())
    with pytest.raises(InputError, match="only 0 of 0"):
        train_factors([], FactorSet())


def test_run_reads_what_was_written(tmp_path):
    from pntegrity.inertial import read_factors

    rng = np.random.default_rng(5)
    history = [consistent(*rng.uniform(1.0, 5.0, 2)) for _ in range(50)]
    trained = train_factors(history, FactorSet())
    path = tmp_path / "factors.toml"
    path.write_text(to_toml(training_tables(trained, ["monday.toml"])), encoding="utf-8")
    assert read_factors(path) == trained.factors
    told = tomllib.loads(path.read_text(encoding="utf-8"))["trained"]
    assert told["logs"] == ["monday.toml"]
    assert told["accepted"] == 50
    assert trained.factors.missed_limit_m == pytest.approx(
        told["mu_missed_m"] + told["alpha"] * told["sigma_missed_m"]
    )


def test_the_command_refuses_what_cannot_be_trained_on(tmp_path):
    from pntegrity.cli.train_factors import training_config

    missing = tmp_path / "no.toml"
    with pytest.raises(InputError, match=r"no\.toml"):
        training_config(missing, None)
    faulty = tmp_path / "faulty.toml"
    faulty.write_text('obs = "a.rnx"\nfaults = ["G05 bias 5 m 1:2"]\n', encoding="utf-8")
    with pytest.raises(InputError, match="without any"):
        training_config(faulty, None)
    log = tmp_path / "log.toml"
    log.write_text('obs = "a.rnx"\nnav = ["b.nav"]\nimu = "imu.csv"\nfde = "ours"\n', encoding="utf-8")
    config = training_config(log, "published")
    assert (config.estimator, config.fde, config.used_coupling()) == ("gnss_ins", "factor-set", "loose")
    assert config.variant == "published"
