"""The Sun, body axes and wind-up: a published Sun, RTKLIB's offsets and wind-up, and sidereon's."""

import gzip
from datetime import datetime

import numpy as np
import pyrtklib as rtk
import pytest
import sidereon
from precise_files import ESBC, SECOND, T0, filled, gps_time, unpacked, utc_time, vector

from pntegrity.physics.attitude import body_axes, sun_directions, wind_up_cycles
from pntegrity.physics.corrections import Site, sky_of
from pntegrity.physics.signals import SPEED_OF_LIGHT_MPS as C
from pntegrity.physics.signals import frequency_hz
from pntegrity.physics.time import from_iso, to_iso, to_j2000_s

#: Sun of the test case of the IERS Conventions' DEHANTTIDEINEL.F, 2009-04-13T00:00:00 UTC, from the equinox.
IERS_SUN_M = np.array([137859926952.015, 54228127881.4350, 23509422341.6960])


def test_the_sun_is_where_the_iers_test_case_has_it():
    ours = sun_directions(np.array([from_iso("2009-04-13T00:00:15")]))[0]
    assert np.linalg.norm(ours) == pytest.approx(1.0)
    days = (np.datetime64("2009-04-13") - np.datetime64("2000-01-01T12")) / np.timedelta64(1, "h") / 24.0
    turn = np.radians(280.46061837 + 360.98564736629 * days)
    theirs = IERS_SUN_M / np.linalg.norm(IERS_SUN_M)
    theirs[:2] = [[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]] @ theirs[:2]
    # measured 1.0e-4 rad; a thousandth turns an antenna's offset by 0.4 mm. RTKLIB's Sun is 5e-3 rad off, as
    # it takes coordinates of date for those of 2000
    assert np.linalg.norm(np.cross(ours, theirs)) < 3e-4


def test_body_axes_are_a_right_handed_frame_that_faces_the_earth_and_the_sun():
    rng = np.random.default_rng(1)
    position, sun = 2.6e7 * _units(rng, 40), _units(rng, 40)
    x, y, z = body_axes(position, sun)
    np.testing.assert_allclose(np.cross(x, y), z, atol=1e-12)
    np.testing.assert_allclose(z, -position / 2.6e7, atol=1e-12)
    np.testing.assert_allclose(np.einsum("ij,ij->i", y, sun), 0.0, atol=1e-12)
    assert (np.einsum("ij,ij->i", x, sun) > 0.0).all()


def _units(rng, n):
    v = rng.standard_normal((n, 3))
    return v / np.linalg.norm(v, axis=1)[:, None]


@pytest.mark.parametrize("system", ["G", "R"])  # RTKLIB combines other frequencies of Galileo
def test_satellite_antenna_offsets_agree_with_rtklib(orbits, satellite_antennas, rtklib, system):
    t = T0 + SECOND * np.arange(1800, 5 * 3600, 2700)
    offset, worst = rtk.Arr1Ddouble(3), 0.0
    for k in range(27):
        rtklib.nav.glo_fcn[k] = 8  # channel 0
    gamma = (frequency_hz(system, "1C", 0) / frequency_hz(system, "2C", 0)) ** 2
    for sat in [s for s in orbits.sats if s[0] == system]:
        position, _ = orbits.position_m(sat, t)
        axes = body_axes(position, np.array([rtklib_sun(x) for x in t]))
        antenna = satellite_antennas.satellite(sat, T0)
        for i, tn in enumerate(t):
            where = filled(rtk.Arr1Ddouble, position[i])
            rtk.satantoff(gps_time(tn), where, rtk.satid2no(sat), rtklib.nav, offset)
            one, two = (sum(a[i] * p for a, p in zip(axes, antenna.pco_m[b], strict=True)) for b in "12")
            worst = max(worst, np.linalg.norm(vector(offset) - (gamma * one - two) / (gamma - 1.0)))
    assert worst < 1e-9


def rtklib_sun(t_ns):
    sun, moon = rtk.Arr1Ddouble(3), rtk.Arr1Ddouble(3)
    rtk.sunmoonpos(utc_time(t_ns), filled(rtk.Arr1Ddouble, [0.0] * 5), sun, moon, rtk.Arr1Ddouble(1))
    return vector(sun) / np.linalg.norm(vector(sun))


def seen(orbits, sat, t_ns):
    """Return a satellite as seen from ESBC: the rows above 10 degrees, and which they are."""
    position, ok = orbits.position_m(sat, t_ns, np.full(len(t_ns), -0.078))
    rows = np.flatnonzero(ok)
    sky = sky_of(t_ns, rows, np.array([sat] * len(rows)), position[rows], Site(np.tile(ESBC, (len(t_ns), 1))))
    return sky, rows, sky.el_rad > np.deg2rad(10.0)


def test_wind_up_agrees_with_sidereon(orbits, esbc):
    t = T0 + SECOND * np.arange(3600, 4 * 3600, 600)
    names = [s for s in orbits.sats if s[0] in "GE"]
    pair = {s: (frequency_hz(s, "1C"), frequency_hz(s, "2W" if s[0] == "G" else "5Q")) for s in names}
    rows = [sidereon.PppCorrectionObservation(s, *pair[s]) for s in names]
    epochs = []
    for tn in t.tolist():
        d = datetime.fromisoformat(to_iso(tn)[:19])
        j2000 = float(to_j2000_s(np.array([tn]))[0])
        epochs.append(
            sidereon.PppCorrectionEpoch(
                d.year, d.month, d.day, d.hour, d.minute, float(d.second), j2000, rows
            )
        )
    sp3 = sidereon.load_sp3(gzip.decompress(sorted(esbc.glob("*SP3.gz"))[1].read_bytes()))
    made = sidereon.ppp_corrections(sp3, epochs, ESBC, phase_windup=True)
    theirs = {(s, i): v for s, i, v in made.windup_m}
    compared, worst = 0, 0.0
    for sat in names:
        sky, epoch, up = seen(orbits, sat, t)
        cycles = np.array([theirs[sat, i] for i in epoch[up].tolist()]) * sum(pair[sat]) / C
        apart = sky.wind_up_cycles[up] - cycles - 0.5  # their x axis points the other way
        worst = max(worst, np.abs(apart - np.rint(apart)).max(initial=0.0))
        compared += int(up.sum())
    assert compared > 200
    assert worst < 1e-3, worst  # measured 5e-4 cycles


def test_wind_up_agrees_with_rtklibs_precise_positioning(orbits, rtklib, esbc):
    options, obs = rtk.prcopt_default, rtk.obs_t()
    options.mode, options.nf, options.navsys = rtk.PMODE_PPP_KINEMA, 2, rtk.SYS_GPS
    options.ionoopt, options.tropopt = rtk.IONOOPT_IFLC, rtk.TROPOPT_EST
    options.sateph, options.elmin, options.posopt[2] = rtk.EPHOPT_PREC, 0.17, 1
    path = unpacked(next(esbc.glob("*_MO.rnx.gz")), rtklib.folder, "esbc.obs")
    assert rtk.readrnx(path, 1, "", obs, rtk.nav_t(), rtk.sta_t()) == 1
    rtk.sortobs(obs)
    state = rtk.rtk_t()
    rtk.rtkinit(state, options)
    found: dict[str, dict[int, float]] = {}
    i = epoch = 0
    while epoch < 240:
        j = i
        while obs.data[j].time.time == obs.data[i].time.time:
            j += 1
        rtk.rtkpos(state, obs.data[i], j - i, rtklib.nav)
        for k in range(32):
            if state.ssat[k].vs:
                found.setdefault(f"G{k + 1:02d}", {})[epoch] = state.ssat[k].phw
        i, epoch = j, epoch + 1
    t = T0 + SECOND * np.arange(0, 240 * 30, 30)
    compared, worst = 0, 0.0
    for sat, values in found.items():
        sky, rows, _ = seen(orbits, sat, t)
        ours = dict(zip(rows.tolist(), sky.wind_up_cycles.tolist(), strict=True))
        both = [k for k in values if k in ours]
        apart = np.array([values[k] - ours[k] for k in both])
        apart -= np.rint(apart[0] - 0.5) + 0.5
        worst = max(worst, np.abs(apart).max())
        compared += len(both)
    assert compared > 1500
    assert worst < 4e-3, worst  # measured 1.5e-3 cycles: their Sun is 5e-3 rad (8e-4 of a turn) off


def test_wind_up_goes_on_over_a_turn_and_starts_at_each_satellite():
    # GIVEN a satellite in the zenith that turns twice about its axis, and a second one that does so too
    n, turns = 101, 2.0
    angle = np.linspace(0.0, 2.0 * np.pi * turns, n)
    x = np.stack([np.cos(angle), np.sin(angle), np.zeros(n)], axis=1)
    z = np.tile([0.0, 0.0, -1.0], (n, 1))
    axes = tuple(np.concatenate([a, a]) for a in (x, np.cross(z, x), z))
    los, north, west = (np.tile(v, (2 * n, 1)) for v in ([0, 0, 1.0], [0, 1.0, 0], [-1.0, 0, 0]))
    found = wind_up_cycles(np.repeat([0, 1], n), axes, los, north, west)
    # THEN the phase changes by a cycle a turn, and there is no jump; each satellite begins within half a
    # cycle
    for part in (found[:n], found[n:]):
        assert abs(part[-1] - part[0]) == pytest.approx(turns, abs=1e-9)
        assert np.abs(np.diff(part)).max() < 0.03
        assert abs(part[0]) <= 0.5
