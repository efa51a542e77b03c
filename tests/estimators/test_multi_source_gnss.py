"""`multi_source` with raw satellites: a simulated drive, beside the filter that has clock states."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from ins_logs import ARM, drive, filter_of, off_m, updates

from gnss_logs import navigation
from pntegrity.estimators.multi_source import MultiSource
from pntegrity.kernels.linear import symmetric
from pntegrity.satellite_source import merged
from pntegrity.sensors.gnss import OFFSET_M, OFFSET_MPS, Gnss
from pntegrity.states import sensor_of

LOG = drive(60)
EPOCHS = tuple(replace(e, observations=(merged(e, "gnss"),)) for e in LOG.epochs)


def estimator(**changes) -> MultiSource:
    gnss = Gnss(lever_arm_m=ARM, klobuchar=navigation("GE").klobuchar["G"], **changes)
    return MultiSource(replace(filter_of(LOG).options, sources=(gnss,)))


@pytest.fixture(scope="module")
def found():
    return updates(estimator(), EPOCHS)


def test_it_starts_at_once_and_stays_near_the_truth(found):
    off = off_m(LOG, found)
    assert np.isfinite(off).sum() >= 55
    assert np.nanmax(off[10:]) < 5.0
    assert off[-1] < 3.0


def test_it_is_as_good_as_the_filter_with_clock_states(found):
    beside = off_m(LOG, updates(filter_of(LOG), LOG.epochs))
    both = np.isfinite(beside) & np.isfinite(off_m(LOG, found))
    rms, other = (np.sqrt(np.mean(x[both] ** 2)) for x in (off_m(LOG, found), beside))
    assert rms < 1.5 * other + 0.2


def test_each_epoch_is_that_of_unknown_clocks(found):
    """Beside each update: least squares with clocks and a drift of which nothing is known."""
    compared = 0
    for u in found[10:]:
        of = np.array([sensor_of(k)[0] if ":R." in k else "D" for k in u.keys])
        clocks = (of[:, None] == np.unique(of)).astype(float)
        c = np.where(of == "D", OFFSET_MPS, OFFSET_M)
        weight = 1.0 / np.sqrt(np.diag(u.R) - c**2)
        scale = np.sqrt(np.diag(u.prior.P))
        correlation = symmetric(u.prior.P / np.outer(scale, scale))
        root = np.linalg.inv(np.linalg.cholesky(correlation)) / scale
        A = np.vstack([
            np.hstack([root, np.zeros((len(root), clocks.shape[1]))]),
            np.hstack([u.H, clocks]) * weight[:, None],
        ])  # fmt: skip
        moved = np.linalg.lstsq(A, np.concatenate([np.zeros(len(root)), u.nu * weight]), rcond=None)[0]
        np.testing.assert_allclose((u.posterior.mean - u.prior.mean)[:6], moved[:6], atol=1e-6)
        compared += 1
    assert compared == 50


def test_a_satellite_that_is_left_out_takes_both_its_rows(found):
    with_all = found[-1]
    key = next(k for k in with_all.keys if ":R." in k)
    name = f"gnss.{sensor_of(key)}"
    est, state = estimator(), found[-2].posterior
    without = est.correct(est.predict(state, EPOCHS[-1]), EPOCHS[-1], frozenset({name}))
    assert set(with_all.keys) - set(without.keys) == {key, key.replace(":R.", ":D.")}
    assert set(without.spare_keys) == {key, key.replace(":R.", ":D.")}
    assert np.linalg.norm((without.posterior.mean - with_all.posterior.mean)[:3]) < 1.0


def test_innovations_are_as_large_as_the_filter_believes():
    """Rows less one for each offset: that many squares of standard normals."""
    told = updates(estimator(sigma_m=0.3, slow_sigma_m=0.3, sigma_mps=0.02), EPOCHS)[15:]
    ratio = np.array([float(u.white @ u.white) / (len(u.keys) - 3) for u in told])
    assert 0.6 < ratio.mean() < 1.4
