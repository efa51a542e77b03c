"""What is added to predictions: antennas of both ends, antenna height, path delay, tides, troposphere."""

import numpy as np
import pyrtklib as rtk
import pytest
from precise_files import ESBC, SECOND, T0, filled, gps_time

from pntegrity.physics._choice import Chosen
from pntegrity.physics.atmosphere import mapping_factors, zenith_delays_m
from pntegrity.physics.corrections import Site, corrections_m, sky_of
from pntegrity.physics.frames import ecef_to_geodetic, enu_rotation, enu_rotations
from pntegrity.physics.precise_epochs import _biases
from pntegrity.physics.products import CodeBiases, ReceiverAntenna
from pntegrity.physics.signals import SPEED_OF_LIGHT_MPS as C
from pntegrity.physics.signals import frequency_hz
from pntegrity.physics.tides import displacements_m

T = T0 + SECOND * np.arange(3600, 5 * 3600, 600)
TRACK = np.tile(ESBC, (len(T), 1))


@pytest.fixture(scope="module")
def view(orbits):
    """Return what makes rows of some satellites above 5 degrees, with a site's facts."""

    def make(site, sats=("G05", "G13", "R01", "E24")):
        parts = []
        for sat in sorted(sats):
            position, ok = orbits.position_m(sat, T, np.full(len(T), -0.08))
            d = position - ESBC
            up = np.einsum("ij,ij->i", d / np.linalg.norm(d, axis=1)[:, None], TRACK) / np.linalg.norm(ESBC)
            rows = np.flatnonzero(ok & (up > 0.1))
            parts.append((rows, np.array([sat] * len(rows)), position[rows]))
        epoch, names, position = (np.concatenate(p) for p in zip(*parts, strict=True))
        return sky_of(T, epoch, names, position, site), position

    return make


def code(sky, site, antennas=None, band="1"):
    n = len(sky.t_ns)
    return corrections_m(sky, np.full(n, band), np.full(n, 0.19), site, antennas)


def test_a_higher_antenna_is_nearer_and_an_eastern_one_nearer_to_the_east(view):
    plain = Site(TRACK, tides=False)
    for hen, direction in (
        ([2.0, 0, 0], [0, 0, 1.0]),
        ([0, 2.0, 0], [1.0, 0, 0]),
        ([0, 0, 2.0], [0, 1.0, 0]),
    ):
        mounted = Site(TRACK, np.array(hen), tides=False)
        (sky, position), (other, _) = view(plain), view(mounted)
        change = code(other, mounted).code_m - code(sky, plain).code_m
        exact = np.linalg.norm(position - (ESBC + 2.0 * enu_rotation(ESBC).T @ direction), axis=1)
        exact -= np.linalg.norm(position - ESBC, axis=1)
        np.testing.assert_allclose(change, exact, atol=1e-6)  # 2 m squared over 2e7 m


def test_a_marker_that_the_tide_lifts_is_nearer(view):
    still, moving = Site(TRACK, tides=False), Site(TRACK)
    (sky, _), (other, _) = view(still), view(moving)
    change = code(other, moving).code_m - code(sky, still).code_m
    tide = displacements_m(T, TRACK)[sky.epoch]
    np.testing.assert_allclose(change, -np.einsum("ij,ij->i", tide, sky.los), atol=1e-9)
    assert np.abs(change).max() > 0.03


def test_the_path_delay_is_relativitys(view):
    # 1 to 2 cm less towards the zenith, by its formula in ranges (IERS 2010, 11.17)
    sky, position = view(Site(TRACK, tides=False))
    r, s, d = np.linalg.norm(position, axis=1), np.linalg.norm(ESBC), np.linalg.norm(position - ESBC, axis=1)
    np.testing.assert_allclose(sky.shapiro_m, 2 * 4.435e-3 * np.log((r + s + d) / (r + s - d)), rtol=1e-3)
    assert 0.010 < sky.shapiro_m.min() < sky.shapiro_m.max() < 0.021


@pytest.mark.parametrize("sat", ["G05", "R01"])
def test_satellite_antennas_agree_with_rtklib_along_the_line_of_sight(view, satellite_antennas, rtklib, sat):
    site = Site(TRACK, tides=False)
    sky, _ = view(site, (sat,))
    found = code(sky, site, satellite_antennas.satellite).code_m - code(sky, site).code_m
    antenna, dant = satellite_antennas.satellite(sat, T0), rtk.Arr1Ddouble(3)
    for i, row in enumerate(found):
        nadir = float(np.arccos(-np.dot(sky.axes[2][i], sky.los[i])))
        rtk.antmodel_s(rtklib.nav.pcvs[rtk.satid2no(sat) - 1], nadir, dant)
        shift = sum(axis[i] * p for axis, p in zip(sky.axes, antenna.pco_m["1"], strict=True))
        # the phase centre is off the centre of mass by `shift`: the range grows by its part away from us
        assert row == pytest.approx(float(shift @ sky.los[i]) + dant[0], abs=1e-6)
    assert np.abs(found).max() > 0.3
    assert found.max() < 0.0  # a phase centre lies on the Earth's side of the centre of mass


def test_a_receiver_antenna_agrees_with_rtklib(view):
    # GIVEN a phase centre 10 cm up, 1 cm north, and variations that grow with the zenith angle
    zenith = np.radians(np.arange(0.0, 91.0, 5.0))
    pcv = 1e-3 * np.arange(19.0)
    antenna = ReceiverAntenna(
        "TEST", "NONE", {("G", "1"): np.array([0.01, -0.02, 0.10])}, {("G", "1"): (zenith, None, pcv)}, ()
    )
    site = Site(TRACK, antenna=antenna, tides=False)
    sky, _ = view(site, ("G05", "G13"))
    found = code(sky, site).code_m - code(sky, Site(TRACK, tides=False)).code_m
    theirs, dant, zero = rtk.pcv_t(), rtk.Arr1Ddouble(3), filled(rtk.Arr1Ddouble, [0, 0, 0])
    for k, value in enumerate([-0.02, 0.01, 0.10]):  # east, north, up
        theirs.off[0, k] = value
    for k, value in enumerate(pcv):
        theirs.var[0, k] = value
    for i, row in enumerate(found):
        rtk.antmodel(theirs, zero, filled(rtk.Arr1Ddouble, [sky.az_rad[i], sky.el_rad[i]]), 1, dant)
        assert row == pytest.approx(dant[0], abs=1e-6)


def test_what_has_no_antenna_is_told_once_and_left_alone(view):
    site = Site(TRACK, tides=False)
    sky, _ = view(site)
    found = code(sky, site, lambda sat, t: None)
    assert len(found.notes) == 4
    assert all(
        any(f"{s}: no satellite antenna" in n for n in found.notes) for s in ("G05", "G13", "R01", "E24")
    )
    np.testing.assert_array_equal(found.code_m, code(sky, site).code_m)


def test_only_the_carrier_winds_up(view):
    site = Site(TRACK, tides=False)
    sky, _ = view(site)
    found = code(sky, site)
    np.testing.assert_allclose(found.carrier_m - found.code_m, 0.19 * sky.wind_up_cycles)


# --- troposphere


@pytest.mark.parametrize("el_deg", [10.0, 20.0, 45.0, 80.0])
@pytest.mark.parametrize("day", [15, 100, 200, 300])
def test_mapping_agrees_with_rtklibs_niell(el_deg, day):
    t = T0 + (day - 177) * 86400 * SECOND
    llh = filled(rtk.Arr1Ddouble, ecef_to_geodetic(ESBC))
    wet = rtk.Arr1Ddouble(1)
    dry = rtk.tropmapf(gps_time(t), llh, filled(rtk.Arr1Ddouble, [0.3, np.radians(el_deg)]), wet)
    ours = mapping_factors(ESBC, np.array([np.radians(el_deg)]), t)
    assert ours[0][0] == pytest.approx(dry, rel=1e-6)  # measured 9e-9
    assert ours[1][0] == pytest.approx(wet[0], rel=1e-6)


@pytest.mark.parametrize("height_m", [0.0, 300.0, 2500.0])
def test_zenith_delays_are_rtklibs_saastamoinen(height_m):
    place = ESBC * (1.0 + (height_m - 50.0) / np.linalg.norm(ESBC))
    llh, up = ecef_to_geodetic(place), filled(rtk.Arr1Ddouble, [0.0, np.pi / 2])
    dry = rtk.tropmodel(gps_time(T0), filled(rtk.Arr1Ddouble, llh), up, 0.0)
    both = rtk.tropmodel(gps_time(T0), filled(rtk.Arr1Ddouble, llh), up, 0.5)
    ours = zenith_delays_m(place)
    assert ours[0] == pytest.approx(dry, abs=1e-6)  # measured 0
    assert ours[1] == pytest.approx(both - dry, abs=2e-4)  # measured 0.05 mm


def test_below_three_degrees_and_in_no_place_nothing_breaks():
    el = np.array([-0.5, 0.0, 0.05, np.pi / 2])
    dry, wet = mapping_factors(ESBC, el, T0)
    assert dry[0] == dry[1] == dry[2] > 12.0
    assert dry[3] == pytest.approx(1.0)
    assert wet[3] == pytest.approx(1.0)
    assert not np.any(mapping_factors(np.zeros(3), el, T0))
    assert zenith_delays_m(np.zeros(3)) == (0.0, 0.0)


def test_many_rotations_are_each_that_of_one():
    rng = np.random.default_rng(3)
    places = ESBC + 1e5 * rng.standard_normal((20, 3))
    for turn, place in zip(enu_rotations(places), places, strict=True):
        np.testing.assert_allclose(turn, enu_rotation(place), atol=1e-12)


# --- code biases


class Names:
    """As much of a signal table as code biases need."""

    def __init__(self, signals):
        self.signal = np.array(signals)


def combined(sat, pair, osb_ns):
    """Return what `_biases` adds to the combination of a pair, m, and notes."""
    one = np.array([0])
    chosen = Chosen(one, np.array([sat]), one, one + 1, np.array([""]), one, one + 1)
    biases = CodeBiases({(sat, s): v * 1e-9 for s, v in osb_ns.items()}, {}, T0)
    notes: list[str] = []
    a, b = _biases(Names(pair), biases, chosen, one, notes)
    return float(free(sat[0], pair, a[0], b[0])), notes


def free(system, pair, a, b):
    gamma = (frequency_hz(system, pair[0], 0) / frequency_hz(system, pair[1], 0)) ** 2
    return (gamma * a - b) / (gamma - 1.0)


@pytest.mark.parametrize(
    ("sat", "pair", "own"),
    [
        ("G05", ("1C", "2L"), ("1W", "2W")),
        ("E24", ("1C", "7Q"), ("1C", "5Q")),
        ("C23", ("2I", "7I"), ("2I", "6I")),
        ("R01", ("1C", "2C"), ("1P", "2P")),
    ],
)
def test_another_pair_is_brought_to_the_codes_of_the_clock(sat, pair, own):
    # THEN the observed pair is longer than that of the clocks by the difference of their combined biases,
    # also where the second code is of another band
    osb = {"1C": 3.1, "2L": -4.0, "1W": 1.2, "2W": 2.2, "5Q": 5.4, "7Q": -3.3, "2I": 8.0, "6I": -2.0,
           "7I": 1.5, "1P": -1.0, "2P": 4.0, "2C": 2.5}  # fmt: skip
    found, notes = combined(sat, pair, osb)
    used = free(sat[0], pair, *(C * 1e-9 * osb[s] for s in pair))
    clock = free(sat[0], own, *(C * 1e-9 * osb[s] for s in own))
    assert found == pytest.approx(used - clock, abs=1e-9)
    assert abs(found) > 0.1
    assert not notes


def test_a_bias_that_is_not_known_is_told():
    found, notes = combined("E24", ("1C", "7Q"), {})
    assert found == 0.0
    assert notes == ["no code bias of Galileo C7Q against C5Q (1 satellites): taken as 0"]


def test_the_clocks_own_codes_need_none():
    assert combined("G05", ("1W", "2W"), {}) == (0.0, [])
