"""Receivers whose noise nobody fitted: the pipeline runs to the end and says what it makes of them."""

from collections import Counter

import numpy as np
import pytest

from pntegrity.estimators.spp_kf import SppKf
from pntegrity.exclusion import Policy
from pntegrity.pipeline import Outcome, Pipeline
from pntegrity.scenarios._real_logs import CLAS, TST, WALK, Log, Site, monitors
from pntegrity.sensors.noise import NoiseModel


def run(where: Site, most: int) -> list[Outcome]:
    pipeline = Pipeline(SppKf(where.options()), monitors(1e-6, NoiseModel()), Policy())
    return [pipeline.push(e) for e in where.epochs[:most]]


def test_a_good_station_is_trusted(site):
    where = site(CLAS)
    outcomes = run(where, 400)
    errors = where.horizontal_m([o.update.posterior.mean[:3] for o in outcomes])
    assert Counter(o.status for o in outcomes)["ok"] >= 390
    assert errors.max() < 3.0


@pytest.mark.parametrize("log", [WALK, TST], ids=["walk", "city"])
def test_where_the_model_does_not_fit_nobody_is_trusted_and_nobody_thrown_out(site, log: Log):
    where = site(log)
    outcomes = run(where, 400)
    assert len(outcomes) == min(400, len(where.epochs))
    assert Counter(o.status for o in outcomes)["alert"] > 200
    shares = [
        len(o.update.excluded) / max(len(o.update.excluded) + len(o.update.groups()), 1) for o in outcomes
    ]
    assert max(shares) <= 0.5
    assert all(np.isfinite(o.update.posterior.mean).all() for o in outcomes)
