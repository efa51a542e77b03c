"""Real CLAS corrections: they agree with final products, with the receiver's carriers, and with the truth."""

from __future__ import annotations

import gzip
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators.ppp_rtk import PppRtk
from pntegrity.formats.antex import read_antex
from pntegrity.formats.bias import read_biases
from pntegrity.formats.clas import read_clas
from pntegrity.formats.clas_l6 import read_l6
from pntegrity.formats.rinex_nav import read_navigation
from pntegrity.formats.rinex_obs import read_observations
from pntegrity.formats.sp3 import read_orbits
from pntegrity.physics.atmosphere import mapping_factors, zenith_delays_m
from pntegrity.physics.atmosphere_products import metres_per_tecu, with_products
from pntegrity.physics.attitude import body_axes, sun_directions
from pntegrity.physics.frames import elevation_azimuth, enu_rotation
from pntegrity.physics.precise_epochs import precise_epochs
from pntegrity.physics.signals import SPEED_OF_LIGHT_MPS, frequency_hz
from pntegrity.physics.ssr import SsrBiases, SsrClocks, SsrOrbits
from pntegrity.physics.ssr_corrections import ClasCorrections, in_force
from pntegrity.physics.ssr_log import CLAS_SIGNALS, ClasInputs, clas_inputs
from pntegrity.physics.tables import Navigation, SignalTable
from pntegrity.physics.time import SECOND_NS, from_week_tow
from pntegrity.records import State
from pntegrity.sensors.noise import PPP
from pntegrity.sensors.snapshot import track

FOLDER = "clas-sept-2021078"
TRUTH = np.array([-3962108.673, 3381309.574, 3668678.638])
PAIRS = {"G": ("1C", "2W"), "E": ("1C", "5Q"), "J": ("1C", "2L")}
TIMES = int(from_week_tow(2149, 475_230)) + 10 * SECOND_NS * np.arange(86)
TURN_RADPS = 7.2921151467e-5


@dataclass(frozen=True)
class Real:
    folder: Path
    corrections: ClasCorrections
    nav: Navigation
    table: SignalTable

    @property
    def inputs(self) -> ClasInputs:
        return clas_inputs(self.table, self.corrections, self.nav, TRUTH)


@pytest.fixture(scope="module")
def real(shared) -> Real:
    folder = shared / FOLDER
    if not folder.is_dir():
        pytest.skip(f"{FOLDER} not in the shared data")
    return Real(
        folder,
        read_clas(sorted(folder.glob("clas_*.csv.gz"))),
        read_navigation([folder / "SEPT078M.21P.gz", folder / "30340780.21q.gz"]),
        read_observations(folder / "SEPT078M.21O.gz"),
    )


def combined(sat: str, first, second):
    """Return the ionosphere-free combination of what is seen on a satellite's two bands."""
    one, two = (frequency_hz(sat, s) for s in PAIRS[sat[0]])
    gamma = (one / two) ** 2
    return (gamma * np.asarray(first) - np.asarray(second)) / (gamma - 1.0)


# --- against final products ---------------------------------------------------------------------------------


def ranges_of_final_products(real: Real, sats) -> dict[str, np.ndarray]:
    """Return code by CODE's orbits, clocks, antennas and absolute biases, m (without Earth rotation)."""
    orbits = read_orbits([real.folder / "COD0MGXFIN_20210780000_01D_05M_ORB.SP3.gz"])
    biases = read_biases([real.folder / "COD0MGXFIN_20210780000_01D_01D_OSB.BIA.gz"], int(TIMES[0])).osb_s
    antennas = read_antex([real.folder.parent / "antex/igs14_sats_only.atx.gz"])
    out = {}
    for sat in sats:
        center = orbits.position_m(sat, TIMES)[0]
        antenna, axes = antennas.satellite(sat, int(TIMES[0])), body_axes(center, sun_directions(TIMES))
        offsets = [antenna.pco_m[antenna.calibrated_band(s[0])[0]] for s in PAIRS[sat[0]]]
        phase_centre = center + sum(x * axis for x, axis in zip(combined(sat, *offsets), axes, strict=True))
        own = [biases.get((sat, s), biases.get((sat, s[0] + "X"), np.nan)) for s in PAIRS[sat[0]]]
        clock = orbits.clocks.clock_s(sat, TIMES)[0]
        out[sat] = np.linalg.norm(phase_centre - TRUTH, axis=1)
        out[sat] += SPEED_OF_LIGHT_MPS * (combined(sat, *own) - clock)
    return out


def ranges_of_clas(real: Real, corrections: ClasCorrections) -> dict[str, np.ndarray]:
    orbits, out = SsrOrbits(corrections, real.nav), {}
    clocks, biases = SsrClocks(orbits), SsrBiases(corrections)
    for sat in orbits.sats:
        own = [
            biases.of_m("code", np.full(len(TIMES), sat), np.full(len(TIMES), s), TIMES)
            for s in PAIRS[sat[0]]
        ]
        out[sat] = np.linalg.norm(orbits.position_m(sat, TIMES)[0] - TRUTH, axis=1) + combined(sat, *own)
        out[sat] -= SPEED_OF_LIGHT_MPS * clocks.clock_s(sat, TIMES)[0]
    return out


def differences(real: Real, corrections: ClasCorrections, final) -> dict[str, np.ndarray]:
    """Return how the ranges differ from those of final products, less what a constellation shares."""
    ours, out = ranges_of_clas(real, corrections), {}
    for system in "GEJ":
        rows = {s: ours[s] - final[s] for s in ours if s[0] == system}
        shared = np.nanmedian(np.array(list(rows.values())), axis=0)
        out |= {s: row - shared for s, row in rows.items()}
    return out


@pytest.fixture(scope="module")
def final(real):
    return ranges_of_final_products(real, sorted(real.corrections.satellites))


def test_ranges_are_those_of_final_products(real, final):
    found = differences(real, real.corrections, final)
    assert len(found) == 18
    # measured: 11 to 45 mm in time, means up to 0.24 m (codes of other receivers, regional orbits)
    for sat, row in found.items():
        assert np.nanstd(row) < 0.06, (sat, np.nanstd(row))
        assert abs(np.nanmean(row)) < 0.3, (sat, np.nanmean(row))


@pytest.mark.parametrize("part", ["orbit_m", "clock_m", "code_bias_m"])
def test_the_other_sign_is_wrong(real, final, part):
    def turned(c):
        value = getattr(c, part)
        return {s: -v for s, v in value.items()} if isinstance(value, dict) else -value

    other = replace(
        real.corrections,
        satellites={s: replace(c, **{part: turned(c)}) for s, c in real.corrections.satellites.items()},
    )
    right, wrong = (
        np.sqrt(np.mean([np.nanmean(row**2) for row in differences(real, c, final).values()]))
        for c in (real.corrections, other)
    )
    assert right < 0.13
    assert wrong > 4.0 * right


# --- against the receiver -----------------------------------------------------------------------------------


def residuals_m(real: Real, sensor: str) -> dict[str, np.ndarray]:
    """Return combined observations less what they should be at the truth, by row and epoch."""
    inputs, locate = real.inputs, GnssOptions(noise=PPP)
    found = precise_epochs(
        inputs.table, inputs.products, lambda e: track(e, locate), systems="GEJ", signals=CLAS_SIGNALS
    )
    out: dict[str, np.ndarray] = {}
    dry, _ = zenith_delays_m(TRUTH)
    for k, epoch in enumerate(found.epochs):
        o = epoch.sensor(sensor)
        zenith = inputs.atmosphere.at(epoch.t_ns).troposphere_m
        if o is None or zenith is None:
            continue
        p = o.aux["sv_pos_m"]
        turn = TURN_RADPS * np.linalg.norm(p - TRUTH, axis=1) / SPEED_OF_LIGHT_MPS
        c, s = np.cos(turn), np.sin(turn)
        p = np.stack([p[:, 0] * c + p[:, 1] * s, p[:, 1] * c - p[:, 0] * s, p[:, 2]], axis=1)
        distance = np.linalg.norm(p - TRUTH, axis=1)
        el, _ = elevation_azimuth(TRUTH, (p - TRUTH) / distance[:, None])
        hydrostatic, wet = mapping_factors(TRUTH, el, epoch.t_ns)
        delay = hydrostatic * dry + wet * (zenith[0] - dry)
        left = o.y - (distance - o.aux["sv_clk_m"] + delay + o.aux["model_m"])
        for key, value in zip(o.keys, left.tolist(), strict=True):
            out.setdefault(key, np.full(len(found.epochs), np.nan))[k] = value
    return {key: row[20:] for key, row in out.items()}  # the corrections begin after 20 s


def apart(found: dict[str, np.ndarray], level: bool = False) -> dict[str, np.ndarray]:
    """Return residuals less what a constellation shares; `level`: first less their own median."""
    out = {}
    for system in "GEJ":
        rows = {k: v - (np.nanmedian(v) if level else 0.0) for k, v in found.items() if k[0] == system}
        whole = [v for v in rows.values() if np.isfinite(v).sum() > 800]
        out |= {k: v - np.nanmedian(np.array(whole), axis=0) for k, v in rows.items()}
    return out


def test_codes_fit_the_truth(real):
    found = apart(residuals_m(real, "code"))
    assert len(found) == 18
    means = {k: abs(np.nanmean(v)) for k, v in found.items()}
    # combined multipath over 15 min; E01 and E07 stand at 15 and 20 degrees
    assert max(m for k, m in means.items() if k[:3] not in ("E01", "E07")) < 0.5, means
    assert np.median(list(means.values())) < 0.2, means


def test_carriers_stay_with_the_truth(real):
    found = apart(residuals_m(real, "carrier"), level=True)
    whole = {k: np.nanstd(v) for k, v in found.items() if np.isfinite(v).sum() > 870}
    assert len(whole) == 15
    # measured: 4 to 22 mm over 15 min with phase biases, 6 to 61 mm without
    assert max(whole.values()) < 0.03, whole


def test_phase_biases_break_no_arc(real):
    inputs, locate = real.inputs, GnssOptions(noise=PPP)
    found = precise_epochs(
        inputs.table, inputs.products, lambda e: track(e, locate), systems="GEJ", signals=CLAS_SIGNALS
    )
    assert "carrier arcs begin: rises 18" in found.notes
    assert any(n.startswith("correction older than 60 s: E01") for n in found.notes)


def test_slant_delays_follow_the_carriers(real):
    biases, t = SsrBiases(real.corrections), real.table.t_ns
    for sat, c in real.corrections.satellites.items():
        metres = []
        for s in PAIRS[sat[0]]:
            rows = (real.table.sat == sat) & (real.table.signal == s)
            column = np.full(len(t), np.nan)
            wave = SPEED_OF_LIGHT_MPS / frequency_hz(sat, s)
            at = real.table.epoch[rows]
            own = biases.of_m("phase", real.table.sat[rows], real.table.signal[rows], t[at])
            column[at] = real.table.carrier_cycles[rows] * wave - own
            metres.append(column)
        one, two = (metres_per_tecu(frequency_hz(sat, s)) for s in PAIRS[sat[0]])
        held = in_force(c, t)
        content = np.where(held.ok, c.stec_tecu[held.row], np.nan)
        left = (metres[0] - metres[1]) / (two - one) - content
        spread = np.nanstd(left - np.nanmedian(left))
        # measured: 0.02 to 0.08 TECU, stated 0.26 to 0.7
        assert spread < 0.1, (sat, spread)
        assert spread < np.nanmean(c.stec_sigma_tecu), sat


def test_the_zenith_delay_is_that_of_the_height(real):
    atmosphere = real.inputs.atmosphere
    total = atmosphere.troposphere.value
    at_zero = real.corrections.zhd_m + real.corrections.zwd_m
    # 70 m above the ellipsoid: 1 % less air, 2 cm
    assert np.abs((at_zero - total) - 0.0215).max() < 5e-3
    assert atmosphere.troposphere_kind == "ZTD"
    assert not atmosphere.self_derived
    assert "network 7" in atmosphere.source


# --- the whole ----------------------------------------------------------------------------------------------


def test_float_ppp_rtk_is_there_at_once(real):
    # GIVEN uncombined code and carrier, and CLAS's delays of the atmosphere
    inputs, locate = real.inputs, GnssOptions(noise=PPP)
    found = precise_epochs(
        inputs.table, inputs.products, lambda e: track(e, locate), systems="GEJ", signals=CLAS_SIGNALS,
        combined=False,
    )  # fmt: skip
    epochs, notes = with_products(found.epochs, inputs.atmosphere)
    assert "no ionosphere product: E01 15, E26 60 of 880 epochs" in notes
    # WHEN a receiver that may move at will starts
    estimator, state, places = PppRtk(), State.empty(), []
    for epoch in epochs[:300]:
        state = estimator.correct(estimator.predict(state, epoch), epoch).posterior
        places.append(state.mean[:3] if len(state) else np.full(3, np.nan))
    # THEN it is right to 2 dm from the first epoch with corrections on (measured: 0.10 H, 0.18 V at first)
    error = (np.array(places) - TRUTH) @ enu_rotation(TRUTH).T
    assert np.isnan(error[:20]).all()
    horizontal, up = np.hypot(error[20:, 0], error[20:, 1]), error[20:, 2]
    assert horizontal.max() < 0.25, horizontal.max()
    assert np.sqrt(np.mean(horizontal**2)) < 0.12
    # the antenna is not calibrated, which cssrlib's fixed solution has at +0.10 m
    assert np.abs(up).max() < 0.4, np.abs(up).max()


# --- raw messages -------------------------------------------------------------------------------------------


def test_raw_messages_give_the_decoded_file(real, tmp_path):
    pytest.importorskip("cssrlib", reason="cssrlib is not installed (extra `clas`)")
    cut = tmp_path / "cut.l6"
    cut.write_bytes(gzip.decompress((real.folder / "2021078M.l6.gz").read_bytes())[: 250 * 200])
    raw = read_l6(cut, real.folder / "clas_grid.def", 2149, TRUTH)
    assert raw.network == real.corrections.network
    assert raw.coverage_ns[0] == real.corrections.coverage_ns[0]
    for sat, r in raw.satellites.items():
        c = real.corrections.satellites[sat]
        _, i, j = np.intersect1d(c.t_ns, r.t_ns, return_indices=True)
        assert len(j) == len(r.t_ns)
        assert (c.iode[i] == r.iode[j]).all()
        for name in ("orbit_m", "clock_m", "ura_m", "stec_sigma_tecu"):
            assert np.array_equal(np.isnan(getattr(c, name)[i]), np.isnan(getattr(r, name)[j]))
            np.testing.assert_allclose(getattr(r, name)[j], getattr(c, name)[i], atol=1e-9)
        np.testing.assert_allclose(r.stec_tecu[j], c.stec_tecu[i], atol=5.1e-5)
        for kind in ("code_bias_m", "phase_bias_m"):
            for signal, values in getattr(r, kind).items():
                np.testing.assert_allclose(values[j], getattr(c, kind)[signal][i], atol=5.1e-5)
    _, i, j = np.intersect1d(real.corrections.t_ns, raw.t_ns, return_indices=True)
    np.testing.assert_allclose(raw.zwd_m[j], real.corrections.zwd_m[i], atol=5.1e-5)
    np.testing.assert_allclose(raw.zhd_m[j], real.corrections.zhd_m[i], atol=5.1e-5)


def test_raw_messages_far_away_or_cut_short(real, tmp_path):
    pytest.importorskip("cssrlib", reason="cssrlib is not installed (extra `clas`)")
    from pntegrity.errors import InputError

    cut = tmp_path / "cut.l6"
    cut.write_bytes(gzip.decompress((real.folder / "2021078M.l6.gz").read_bytes())[: 250 * 10])
    with pytest.raises(InputError, match="next grid point"):
        read_l6(cut, real.folder / "clas_grid.def", 2149, [4027881.6280, 306998.5370, 4919498.9840])
    with pytest.raises(InputError, match="no corrections could be decoded"):
        read_l6(cut, real.folder / "clas_grid.def", 2149, TRUTH)
