"""A drive through a town: streets, tunnels, and errors drawn in blocks from a library."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from gnss_logs import NOISE, PLACE, SECOND, START, fingerprint, log, navigation, options
from pntegrity.estimators._gnss import GnssOptions
from pntegrity.scenarios._urban_logs import missing, nagoya_log, scenario, tst_library, tst_with_imu
from pntegrity.sensors.imu import LOW_COST, STIM300
from pntegrity.sensors.ranges import C_MPS
from pntegrity.simulate.error_library import ErrorLibrary, library_of, mode_of
from pntegrity.simulate.motion import motion_of_drive
from pntegrity.simulate.trajectory import straight
from pntegrity.simulate.urban import Urban, urban_epochs
from pntegrity.simulate.urban_scenario import Section, UrbanScenario, mask_rad

N = 200
SPEED_MPS, COURSE_RAD = 8.0, 0.7
SECTIONS = (
    Section("open", 0.0, 40.0), Section("challenging", 40.0, 140.0, 50.0, 30.0),
    Section("denied", 140.0, 160.0), Section("open", 160.0, 200.0),
)  # fmt: skip
TOWN = UrbanScenario(
    SECTIONS, {"full": 0.0, "moderate": 0.5, "none": 1.0}, reflected=1.0, block_s=20.0, stagger_s=4.0,
    noise=NOISE, systems="GE", lever_arm_m=(1.0, 0.5, -1.5), mask_deg=10.0,
)  # fmt: skip


AHEAD_MPS = (SPEED_MPS * np.sin(COURSE_RAD), SPEED_MPS * np.cos(COURSE_RAD), 0.0)
DRIVE = motion_of_drive(straight(PLACE, AHEAD_MPS), START, float(N))


def library(n: int = 120, m: int = 24, speed: float = SPEED_MPS) -> ErrorLibrary:
    """Errors that say where they come from: satellite s at second k has 1000 s + k metres."""
    k, s = np.arange(n, dtype=np.float64)[:, None], np.arange(m, dtype=np.float64)
    code = 1000.0 * (s + 1.0) + k
    flat = np.zeros((n, m))
    return ErrorLibrary(
        START + SECOND * np.arange(n), tuple(f"G{i + 1:02d}" for i in range(m)), code, flat + 0.5,
        flat + 21.0, flat + 0.8, np.full(n, speed), np.zeros(n), np.zeros(n), {"G": 0.0},
    )  # fmt: skip


def made(load: str, seed: int = 1, town: UrbanScenario = TOWN, errors: ErrorLibrary | None = None) -> Urban:
    t_ns = START + SECOND * np.arange(N, dtype=np.int64)
    rng = np.random.default_rng(seed)
    return urban_epochs(town, load, DRIVE, t_ns, navigation("GE"), errors or library(), rng)


drive = lru_cache(maxsize=8)(made)


def code_of(urban: Urban) -> np.ndarray:
    out = np.full((N, len(urban.sats)), np.nan)
    for k, epoch in enumerate(urban.epochs):
        o = epoch.sensor("code")
        if o is not None:
            out[k, [urban.sats.index(key[:3]) for key in o.keys]] = o.y
    return out


def added(load: str, seed: int = 1) -> np.ndarray:
    """What the library added to code: the same sky without it has the same noise."""
    return code_of(drive(load, seed)) - code_of(drive("none", seed))


def test_the_same_seed_gives_the_same_log_and_another_one_another():
    again = made("full")
    assert fingerprint(again) == fingerprint(drive("full"))
    assert fingerprint(drive("full", 2).epochs) != fingerprint(again.epochs)


def test_a_tunnel_has_no_rows_and_the_open_sky_no_errors_of_the_library():
    urban = drive("full")
    kind = np.array(urban.kind)
    assert all(not e.observations for e, k in zip(urban.epochs, kind, strict=True) if k == "denied")
    assert (kind == "denied").sum() == 20
    assert np.nanmax(np.abs(added("full")[kind == "open"])) < 1e-6
    assert (urban.fate[kind == "open"] == -1).all()


def test_full_load_gives_every_satellite_errors_and_moderate_load_half_of_them():
    street = np.array(drive("full").kind) == "challenging"
    full, moderate = (added(load)[street] for load in ("full", "moderate"))
    assert (full[np.isfinite(full)] > 900.0).all()
    share = np.mean(np.abs(moderate[np.isfinite(moderate)]) < 1e-6)
    assert share == pytest.approx(0.5, abs=0.04)  # blocks of an odd number of satellites


def test_errors_keep_the_order_in_time_of_the_library():
    urban, error = drive("full"), added("full")
    street = np.array(urban.kind) == "challenging"
    same = (urban.fate[1:] == urban.fate[:-1]) & (urban.fate[1:] >= 0) & street[1:, None] & street[:-1, None]
    steps = np.diff(error, axis=0)[same]
    assert len(steps) > 500
    jumps = np.abs(steps - 1.0) > 1e-6  # a satellite may have the same one of the library in the next block
    assert jumps.mean() < 0.01
    column, second = np.divmod(error[street], 1000.0)
    there = np.isfinite(column)
    assert np.array_equal(column[there] - 1.0, urban.fate[street][there])
    assert (second[there] < 120.0).all()


def test_satellites_of_a_block_have_their_errors_from_the_same_seconds():
    urban, error = drive("full"), added("full")
    second = np.mod(error, 1000.0)
    middle = 50  # of the first block: staggered ends are 4 s away at most
    seconds = second[middle][urban.fate[middle] >= 0]
    assert len(seconds) > 8
    assert np.ptp(seconds) < 1e-6


def test_doppler_and_signal_strength_come_with_the_code():
    k = 60
    loud, quiet = drive("none").epochs[k].sensor("doppler"), drive("full").epochs[k].sensor("doppler")
    both = [loud.keys.index(key) for key in quiet.keys]
    assert np.allclose(quiet.y - loud.y[both], 0.5)
    assert (quiet.aux["cn0_dbhz"] == 21.0).all()


def test_no_more_satellites_are_received_than_the_library_tracked():
    urban = made("full", town=replace(TOWN, stagger_s=0.0), errors=library(m=4))
    street = np.array(urban.kind) == "challenging"
    assert (urban.fate[street] >= 0).sum(axis=1).max() == 4


def test_without_reflections_only_satellites_above_the_roofs_are_received():
    urban = made("none", town=replace(TOWN, reflected=0.0, stagger_s=0.0))
    hidden = (urban.fate == -2)[np.array(urban.kind) == "challenging"]
    assert 0.1 < hidden.mean() < 0.9
    assert not (drive("none").fate == -2)[np.array(urban.kind) == "challenging"].any()


@pytest.mark.parametrize(
    ("relative", "roof"), [(0.0, 0.0), (np.pi, 0.0), (np.pi / 2, 30.0), (-np.pi / 2, 50.0)]
)
def test_roofs_are_highest_across_the_street(relative, roof):
    street = Section("challenging", 0.0, 1.0, left_deg=50.0, right_deg=30.0)
    assert np.rad2deg(mask_rad(street, relative)) == pytest.approx(roof, abs=1e-9)


def test_a_step_of_the_clock_moves_time_tags_and_code_alike():
    stepping = made("none", town=replace(TOWN, clock_steps=((100.0, 3), (170.0, -4))))
    moved = code_of(stepping) - code_of(drive("none"))
    tags = np.array([e.t_ns for e in stepping.epochs]) - START - SECOND * np.arange(N)
    assert np.array_equal(np.unique(tags), [-1_000_000, 0, 3_000_000])
    expected = np.broadcast_to(tags[:, None] * 1e-9 * C_MPS, moved.shape)
    known = np.isfinite(moved)
    assert np.allclose(moved[known], expected[known], atol=1e-6)


def test_the_antenna_is_a_lever_arm_away_from_the_imu():
    urban = drive("none")
    offset = np.einsum("nji,nj->ni", urban.axes, urban.antenna_m - urban.position_m)
    assert np.allclose(offset, TOWN.lever_arm_m, atol=1e-6)


def test_a_library_gives_back_the_errors_that_a_log_has_and_not_the_clock():
    faults = ("G07 bias 40 m 0:60", "E19 bias 25 m 0:60", "G10 ramp 1 m/s 20:60")
    epochs = log(60, *faults)
    found = library_of(epochs, np.tile(PLACE, (60, 1)), np.zeros((60, 3)), options(navigation("GE")))
    error = dict(zip(found.sats, found.code_m.T, strict=True))
    assert np.median(error["G07"]) == pytest.approx(40.0, abs=1.5)
    assert np.median(error["E19"]) == pytest.approx(25.0, abs=1.5)
    assert error["G10"][-1] == pytest.approx(39.0, abs=2.0)
    others = [v for s, v in error.items() if s not in ("G07", "E19", "G10")]
    assert np.abs(np.nanmedian(others)) < 0.5
    assert {s.sat for s in found.series() if not s.clean} == {"G07", "E19", "G10"}


def test_a_clock_is_the_mode_also_where_most_satellites_are_late():
    line_of_sight, late = np.array([0.1, -0.3, 0.2, 0.0]), np.array([12.0, 25.0, 31.0, 44.0, 52.0, 70.0])
    values = np.concatenate([line_of_sight, late, [np.nan]])
    assert mode_of(values, np.ones(11), 2.0) == pytest.approx(0.0, abs=0.3)
    assert np.median(late) > 30.0
    assert np.isnan(mode_of(values[-1:], np.ones(1), 2.0))


def test_the_seeds_that_are_quoted_are_not_those_of_tuning():
    town = scenario()
    assert town.quoted == tuple(range(1, 21))
    assert not set(town.tuning) & set(town.quoted)
    with pytest.raises(ValueError, match="must differ"):
        replace(town, tuning=(3,))


def test_the_scenario_is_two_fifths_open_and_a_few_hundredths_denied():
    length = dict.fromkeys(("open", "challenging", "denied"), 0.0)
    for section in scenario().sections:
        length[section.kind] += (section.end_s - section.start_s) / 1231.0
    assert 0.35 < length["open"] < 0.5
    assert 0.4 < length["challenging"] < 0.55
    assert 0.02 < length["denied"] < 0.05


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"sections": SECTIONS[1:3] + SECTIONS[:1]}, "without gaps"),
        ({"loads": {"full": 1.5}}, "loads.full"),
        ({"reflected": -0.1}, "reflected"),
        ({"stagger_s": 15.0}, "stagger_s"),
    ],
)
def test_a_scenario_that_cannot_be_is_refused(change, says):
    with pytest.raises(ValueError, match=says):
        replace(TOWN, **change)


def test_an_unknown_load_and_a_short_library_are_refused():
    with pytest.raises(ValueError, match="none of full"):
        made("heavy")
    with pytest.raises(ValueError, match="error library has 20 epochs"):
        made("full", errors=library(20))
    with pytest.raises(ValueError, match="kind"):
        Section("foggy", 0.0, 1.0)


@pytest.fixture
def data(shared):
    if lost := missing(shared):
        pytest.skip(lost)
    return shared


def test_errors_of_the_real_log_are_those_of_a_deep_city(data):
    errors = tst_library(data)
    late = np.abs(errors.code_m) > 10.0
    assert np.mean(late.sum(axis=1) >= 3) == pytest.approx(0.6, abs=0.02)
    assert errors.isb_m["C"] == pytest.approx(-3.1, abs=0.5)
    seen = np.isfinite(errors.code_m)
    assert np.percentile(errors.code_m[seen], 90) > 30.0
    assert np.percentile(errors.code_m[seen], 5) > -8.0  # reflections come late, never early
    calm = errors.cn0_dbhz > 40.0
    assert abs(np.median(errors.code_m[calm])) < 1.0
    assert abs(np.median(errors.rate_mps[calm])) < 0.05


def test_the_simulated_drive_has_errors_like_the_real_log(data):
    real, shares, counts = tst_library(data), [], []
    for seed in scenario().tuning[:2]:
        made = nagoya_log(data, "full", seed, STIM300)
        street = [i for i, k in enumerate(made.kind) if k == "challenging"]
        epochs = [made.epochs[i] for i in street]
        found = library_of(
            epochs, made.antenna_m[street], made.velocity_mps[street], GnssOptions(klobuchar=made.klobuchar)
        )
        shares.append(np.mean((np.abs(found.code_m) > 10.0).sum(axis=1) >= 3))
        counts.append(np.isfinite(found.code_m).sum(axis=1).mean())
    assert np.mean(shares) == pytest.approx(
        0.6, abs=0.25
    )  # a drive has ten blocks: 0.25 to 0.82 in ten seeds
    assert np.mean(counts) == pytest.approx(np.isfinite(real.code_m).sum(axis=1).mean(), abs=2.5)


def test_a_drive_with_an_imu_is_the_same_each_time_and_the_imu_at_any_load(data):
    full, again = (nagoya_log(data, "full", 1000, LOW_COST) for _ in range(2))
    assert fingerprint(full) == fingerprint(again)
    moderate = nagoya_log(data, "moderate", 1000, LOW_COST)
    assert fingerprint(moderate.epochs[300].imu) == fingerprint(full.epochs[300].imu)
    assert fingerprint(moderate.epochs[150].observations) != fingerprint(full.epochs[150].observations)
    assert all(len(e.imu.t_ns) == 125 and not e.imu.reason for e in full.epochs)
    assert full.spec.rate_hz == 125.0


def test_a_drive_under_the_open_sky_alone(data):
    made = nagoya_log(data, "full", 1000, STIM300, "open")
    assert set(made.kind) == {"open"}
    assert min(len(e.sensor("code").keys) for e in made.epochs) > 15
    with pytest.raises(ValueError, match="must be None or 'open'"):
        nagoya_log(data, "full", 1000, STIM300, "denied")


def test_the_real_log_has_a_simulated_imu_from_epoch_to_epoch(data):
    made = tst_with_imu(data, 1, STIM300)
    assert len(made.epochs) == 484
    steps = np.diff([e.t_ns for e in made.epochs]) * 1e-9
    assert np.allclose([e.imu.dt_s.sum() for e in made.epochs[1:]], steps, atol=1e-9)
