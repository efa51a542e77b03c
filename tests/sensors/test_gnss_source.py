"""Satellites as a source: Jacobians, the clock that is no state, what is left out, where the receiver is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gnss_logs import PLACE, log, navigation
from pntegrity.kernels.rotations import from_angles, rotation
from pntegrity.physics.frames import enu_rotation
from pntegrity.satellite_source import merged
from pntegrity.sensors.gnss import OFFSET_M, OFFSET_MPS, Gnss
from pntegrity.sensors.source import Pose, Source, Track
from pntegrity.states import sensor_of

AXES = enu_rotation(PLACE)
ATTITUDE = AXES.T @ from_angles([0.1, -0.05, 0.7])
RATE = np.array([0.02, -0.03, 0.3])
ARM = (2.0, -1.5, -3.0)
SAID = merged(log(1, systems="GREC")[0], "gnss")


def source(**changes) -> Gnss:
    return Gnss(**({"klobuchar": navigation("GREC").klobuchar["G"], "mask_deg": 10.0} | changes))


def pose_at(move=(0.0, 0.0, 0.0), dv=(0.0, 0.0, 0.0), turn=(0.0, 0.0, 0.0), dbg=(0.0, 0.0, 0.0), arm=ARM):
    """Return a pose whose antenna is at `PLACE` and at rest but for errors of the state."""
    C = rotation(turn) @ ATTITUDE
    place, rate = PLACE - ATTITUDE @ arm + move, RATE - np.asarray(dbg)
    velocity = dv - ATTITUDE @ np.cross(RATE, arm)
    return Pose(SAID.t_ns, place, velocity, C, rate, Track(np.array([SAID.t_ns]), place[None], C[None]))


def apart(nu, R):
    """Return innovations less the mean of the rows that share an offset."""
    together = np.abs(R) > 1e3
    return nu - together @ nu / together.sum(axis=1)


def test_it_is_a_source_without_states():
    assert isinstance(source(), Source)
    assert source().nuisances() == ()


def test_rows_have_the_keys_of_a_source():
    rows = source(name="rover").rows(replace(SAID, keys=tuple("rover" + k[4:] for k in SAID.keys)), pose_at())
    kinds = {k.partition(".")[0] for k in rows.keys}
    assert kinds == {"rover:R", "rover:D"}
    assert len(set(rows.keys)) == len(rows.keys) > 40
    assert {sensor_of(k)[0] for k in rows.keys} == set("GREC")


@pytest.mark.parametrize(
    ("block", "field", "step", "close"),
    [
        ("pos", "move", 1.0, 1.5e-3),  # the troposphere thins with height, which a Jacobian has never held
        ("vel", "dv", 0.1, 2e-5),  # the turn of the Earth while the signal travels
        ("att", "turn", 1e-4, 5e-3),  # an arm of 4 m times that of the position
        ("bg", "dbg", 1e-3, 5e-5),
    ],
)
def test_the_jacobian_is_that_of_central_differences(block, field, step, close):
    gnss = source(mask_deg=-90.0, lever_arm_m=ARM)
    H = gnss.rows(SAID, pose_at()).H[block]
    for axis in range(3):
        error = step * np.eye(3)[axis]
        both = [gnss.rows(SAID, pose_at(**{field: s * error})) for s in (1.0, -1.0)]
        assert both[0].keys == both[1].keys
        measured = apart((both[1].nu - both[0].nu) / (2.0 * step), both[0].R)
        expected = apart(H[:, axis], both[0].R)
        assert np.abs(measured - expected).max() < close
        assert np.abs(expected).max() > 0.5


def test_a_lever_arm_moves_the_prediction_with_attitude_and_turn():
    gnss, bare = source(lever_arm_m=ARM), source()
    with_arm, at_antenna = gnss.rows(SAID, pose_at()), bare.rows(SAID, pose_at(arm=(0.0, 0.0, 0.0)))
    np.testing.assert_allclose(with_arm.nu, at_antenna.nu, atol=1e-6)
    assert np.abs(gnss.rows(SAID, pose_at()).H["att"]).max() > 1.0
    assert not bare.rows(SAID, pose_at()).H["att"].any()


def test_rows_of_a_constellation_share_an_offset_and_range_rates_share_another():
    rows = source().rows(SAID, pose_at())
    of = np.array([sensor_of(k)[0] if ":R." in k else "D" for k in rows.keys])
    together = of[:, None] == of
    c = np.where(of == "D", OFFSET_MPS, OFFSET_M)
    apart_ = rows.R - np.where(together, np.outer(c, c), 0.0)
    assert np.allclose(apart_, np.diag(np.diag(apart_)), atol=1e-6)
    assert (np.diag(apart_) > 0.0).all()
    for group in np.unique(of):
        assert np.median(rows.nu[of == group]) == pytest.approx(0.0, abs=1e-9)


def test_the_receiver_clock_does_not_count():
    jump = np.where([":R." in k for k in SAID.keys], 299792.458, 33.0)
    jumped = source().rows(replace(SAID, y=SAID.y + jump), pose_at())
    np.testing.assert_allclose(jumped.nu, source().rows(SAID, pose_at()).nu, atol=1e-6)


def test_errors_that_share_an_offset_weigh_as_with_clock_states():
    gnss, pose = source(lever_arm_m=ARM), pose_at(move=AXES.T @ [4.0, -3.0, 2.0])
    rows = gnss.rows(SAID, pose)
    rng = np.random.default_rng(3)
    H = np.hstack([rows.H[b] for b in ("pos", "vel", "att", "bg")])
    root = np.diag(np.repeat([5.0, 0.5, 0.02, 1e-3], 3)) @ (np.eye(12) + 0.2 * rng.normal(size=(12, 12)))
    P = root @ root.T
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + rows.R)
    # beside it: a clock a constellation and a drift as unknowns of which nothing is known, without squares
    of = np.array([sensor_of(k)[0] if ":R." in k else "D" for k in rows.keys])
    clocks = (of[:, None] == np.unique(of)).astype(float)
    c = np.where(of == "D", OFFSET_MPS, OFFSET_M)
    weight = 1.0 / np.sqrt(np.diag(rows.R) - c**2)
    A = np.vstack([
        np.hstack([np.linalg.inv(root), np.zeros((12, clocks.shape[1]))]),
        np.hstack([H, clocks]) * weight[:, None],
    ])  # fmt: skip
    raw = rows.nu + clocks @ (1e3 * rng.normal(size=clocks.shape[1]))  # as a clock of its own would leave it
    x = np.linalg.lstsq(A, np.concatenate([np.zeros(12), raw * weight]), rcond=None)[0]
    spread = np.linalg.inv(A.T @ A)[:12, :12]
    np.testing.assert_allclose((K @ rows.nu)[:6], x[:6], atol=1e-6)
    np.testing.assert_allclose((P - K @ H @ P)[:6, :6], spread[:6, :6], rtol=1e-5, atol=1e-7)
    assert np.linalg.norm(x[:3]) > 3.0


def test_low_satellites_are_left_out():
    low, high = source(mask_deg=5.0).rows(SAID, pose_at()), source(mask_deg=40.0).rows(SAID, pose_at())
    assert set(high.keys) < set(low.keys)
    assert high.keys
    none = source(mask_deg=89.9).rows(SAID, pose_at())
    assert not none.keys
    assert none.R.shape == (0, 0)
    assert "no satellite above the mask of 89.9 deg" in none.reason


def test_a_satellite_alone_in_its_constellation_has_its_range_rate_only():
    galileo = next(k for k in SAID.keys if sensor_of(k)[0] == "E")
    kept = np.array([sensor_of(k)[0] != "E" or sensor_of(k) == sensor_of(galileo) for k in SAID.keys])
    rows = source(mask_deg=-90.0).rows(SAID.select(kept), pose_at())
    assert galileo not in rows.keys
    assert galileo.replace(":R.", ":D.") in rows.keys
    assert f"{sensor_of(galileo)} is the only one of Galileo" in rows.reason


def test_without_range_rates():
    rows = source(doppler=False).rows(SAID, pose_at())
    assert rows.keys
    assert all(":R." in k for k in rows.keys)


def test_what_is_not_finite_is_not_there():
    y = SAID.y.copy()
    y[0] = np.nan
    rows = source(mask_deg=-90.0).rows(replace(SAID, y=y), pose_at())
    assert SAID.keys[0] not in rows.keys
    assert len(rows.keys) == len(SAID.keys) - 1
    assert np.isfinite(rows.nu).all()


def test_declared_standard_deviations_go_before_the_model():
    sigma = np.linspace(1.0, 2.0, len(SAID.keys))
    rows = source().rows(replace(SAID, sigma=sigma), pose_at())
    c = np.where([":R." in k for k in rows.keys], OFFSET_M, OFFSET_MPS)
    declared = dict(zip(SAID.keys, sigma, strict=True))
    np.testing.assert_allclose(np.sqrt(np.diag(rows.R) - c**2), [declared[k] for k in rows.keys], rtol=1e-6)


def test_a_position_and_its_covariance():
    places = []
    for epoch in log(60, systems="GE", seed=5):
        found = source().position(merged(epoch, "gnss"))
        assert found is not None
        position, velocity, cov = found
        places.append(position - PLACE)
        assert velocity is not None
        assert np.linalg.norm(velocity) < 0.5
        assert cov.shape == (6, 6)
    off = np.array(places).mean(axis=0)
    assert off @ np.linalg.solve(cov[:3, :3], off) < 16.3  # 0.1 % of a chi-square with three degrees
    assert np.sqrt(np.trace(cov[:3, :3])) < 10.0


def test_a_position_without_range_rates_and_none_of_three_satellites():
    bare = source(doppler=False).position(SAID)
    assert bare is not None
    assert bare[1] is None
    assert bare[2].shape == (3, 3)
    assert source().position(SAID.select(slice(0, 3))) is None
    assert source().position(SAID.select(slice(0, 0))) is None


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("sigma_m", 0.0), ("sigma_mps", -1.0), ("slow_sigma_m", -0.1), ("glonass_factor", 0),
        ("mask_deg", 95.0), ("mask_deg", "ten"), ("lever_arm_m", (1.0, 2.0)), ("doppler", "no"),
        ("cn0_ref_dbhz", float("nan")), ("elevation_power", -1),
    ],
)  # fmt: skip
def test_fields_out_of_range_are_refused_by_name(field, value):
    with pytest.raises(ValueError, match=field):
        Gnss(**{field: value})
