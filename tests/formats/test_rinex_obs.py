"""Observation files: what is in them comes out, and what is broken is told."""

import gzip

import numpy as np
import pytest
import sidereon
from conftest_samples import obs3_epoch, obs3_header, rows_at

from pntegrity.errors import InputError
from pntegrity.formats.rinex_obs import read_observations
from pntegrity.physics.time import civil_to_ns

FIRST_NS = civil_to_ns(2024, 2, 3, 4, 5, 6.0)


def row(table, k, sat, signal):
    (i,) = np.flatnonzero((table.epoch == k) & (table.sat == sat) & (table.signal == signal))
    return i


def test_every_value_lands_in_its_row(obs3, save):
    t = read_observations(save(obs3))
    assert t.t_ns.tolist() == [FIRST_NS + k * 10**9 for k in range(4)]
    assert t.systems == "GR"
    i = row(t, 2, "G05", "2W")
    assert t.pseudorange_m[i] == pytest.approx(21e6 + 203)
    assert (t.carrier_cycles[i], t.doppler_hz[i], t.cn0_dbhz[i]) == (0.86e8 + 2, -390.0, 38.5)
    assert np.isnan(t.carrier_cycles[row(t, 0, "G12", "1C")])
    assert len(t) == 4 * 4  # G05 twice, G12 and R03 once: blank signals make no row
    assert t.notes == ()


def test_header_facts(obs3, save):
    t = read_observations(save(obs3))
    assert (t.version, t.marker, t.receiver, t.interval_s) == (3.04, "SAMP", "RECEIVER", 1.0)
    assert t.approx_position_m.tolist() == [4e6, 3e5, 4.9e6]
    assert t.antenna_delta_hen_m.tolist() == [1.5, 0.0, 0.0]


def test_rows_are_sorted_and_read_only(obs3, save):
    t = read_observations(save(obs3))
    key = [(e, s, g) for e, s, g in zip(t.epoch.tolist(), t.sat.tolist(), t.signal.tolist(), strict=True)]
    assert key == sorted(key)
    with pytest.raises(ValueError, match="read-only"):
        t.pseudorange_m[0] = 0.0


@pytest.mark.parametrize("pack", [gzip.compress, lambda b: b], ids=["gzip", "plain"])
def test_crinex_and_gzip_give_the_same_table(obs3, save, pack):
    plain = read_observations(save(obs3))
    packed = read_observations(save(pack(sidereon.encode_crinex(obs3).encode()), "sample.crx"))
    for name in ("t_ns", "sat", "signal", "pseudorange_m", "doppler_hz"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(packed, name))


def test_truncated_crinex_keeps_the_beginning(obs3, save):
    crinex = sidereon.encode_crinex(obs3)
    t = read_observations(save(crinex[:-40], "sample.crx"))
    assert 1 <= len(t.t_ns) < 4
    assert any("CRINEX is damaged" in n for n in t.notes)


def test_rinex_2_names_become_rinex_3_names(obs2, save):
    t = read_observations(save(obs2))
    assert t.version == 2.11
    assert set(zip(t.sat.tolist(), t.signal.tolist(), strict=True)) == {
        ("G05", "1C"), ("G05", "2W"), ("R03", "1C"), ("R03", "2P"),
    }  # fmt: skip
    assert t.carrier_cycles[row(t, 0, "G05", "2W")] == 0.86e8
    assert t.cn0_dbhz[row(t, 1, "R03", "1C")] == 47.0


@pytest.mark.parametrize(("scale", "shift_s"), [("GPS", 0), ("GLO", 18), ("GAL", 0), ("BDT", 14)])
def test_time_systems_become_gps_time(save, scale, shift_s):
    text = obs3_header(scale=scale) + obs3_epoch(6.0, rows_at(0))
    assert read_observations(save(text)).t_ns[0] == FIRST_NS + shift_s * 10**9


def test_repeated_and_backward_epochs_are_dropped_and_told(save):
    seconds = (6.0, 7.0, 7.0, 5.0, 8.0)
    t = read_observations(save(obs3_header() + "".join(obs3_epoch(s, rows_at(1)) for s in seconds)))
    assert ((t.t_ns - FIRST_NS) / 1e9).tolist() == [0, 1, 2]
    assert any("2 epochs dropped" in n and "2024-02-03T04:05:07" in n for n in t.notes)


def test_events_are_skipped_and_told(obs3, save):
    event = "> 2024 02 03 04 05  6.5000000  4  1\n" + f"{'a remark':<60}COMMENT\n"
    lost_power = obs3_epoch(20.0, rows_at(3), flag=1)
    t = read_observations(save(obs3 + event + lost_power))
    assert len(t.t_ns) == 5
    assert any("header records" in n for n in t.notes)
    assert any("power failure" in n for n in t.notes)


def test_zeros_are_absent_values(save):
    rows = [("G05", (0.0, 1.1e8, -1.0, 45.0)), ("G12", (22e6, 0.0, 0.0, 0.0)), ("R03", (0.0, 0.0, 0.0, 0.0))]
    t = read_observations(save(obs3_header() + obs3_epoch(6.0, rows)))
    assert t.sat.tolist() == ["G05", "G12"]
    assert np.isnan(t.pseudorange_m[0])
    assert np.isnan(t.doppler_hz[1])
    assert np.isnan(t.cn0_dbhz[1])


def test_old_beidou_name_of_b1i(save):
    text = obs3_header(systems=("C    2 C1I L1I",)) + obs3_epoch(6.0, [("C11", (22e6, 1.1e8))])
    assert read_observations(save(text)).signal.tolist() == ["2I"]


def test_one_bad_value_costs_one_satellite(obs3, save):
    bad = obs3.replace("  23000050.000", "  2300x050.000")
    assert bad != obs3
    t = read_observations(save(bad))
    assert len(t.t_ns) == 4
    assert len(t) == 15
    assert any("satellite line dropped" in n for n in t.notes)


def test_one_bad_epoch_line_costs_one_epoch(obs3, save):
    t = read_observations(save(obs3.replace("> 2024 02 03 04 05  7.0", "> 2024 02 03 04 05  x.0")))
    assert ((t.t_ns - FIRST_NS) / 1e9).tolist() == [0, 2, 3]
    assert any("epoch dropped" in n for n in t.notes)


def test_a_cut_off_file_is_read_up_to_there(obs3, save):
    t = read_observations(save(obs3[: obs3.rindex("G12") + 9]))
    assert len(t.t_ns) in (3, 4)
    assert t.notes


def test_too_low_a_count_is_told(obs3, save):
    t = read_observations(save(obs3.replace("  7.0000000  0  3", "  7.0000000  0  2")))
    assert any("1 satellite lines skipped" in n for n in t.notes)


CASES = {
    "empty": (b"", "empty"),
    "blank": (b"\n\n  \n", "empty"),
    "binary": (bytes(range(256)) * 40, "binary"),
    "text": (b"hello\nworld\n", "not a RINEX file"),
    "zip": (b"PK\x03\x04rest", "zip"),
    "cut gzip": (gzip.compress(b"x" * 9000)[:-12], "cut off"),
    "bad gzip": (b"\x1f\x8bnonsense, not gzip at all", "damaged"),
    "header only": (obs3_header().encode(), "no epoch"),
    "no end of header": (obs3_header().encode()[:300], "END OF HEADER"),
    "all zero": ((obs3_header() + obs3_epoch(6.0, [("R03", (0.0,) * 4)])).encode(), "blank or zero"),
}


@pytest.mark.parametrize("case", CASES)
def test_unusable_files_raise_with_path_and_hint(save, case):
    content, words = CASES[case]
    path = save(content)
    with pytest.raises(InputError, match=words) as caught:
        read_observations(path)
    assert caught.value.path == path
    assert caught.value.hint
    assert str(path) in str(caught.value)


def test_missing_file_directory_and_navigation_file(tmp_path, nav3, save):
    with pytest.raises(InputError, match="no such file"):
        read_observations(tmp_path / "nothing.rnx")
    with pytest.raises(InputError, match="directory"):
        read_observations(tmp_path)
    with pytest.raises(InputError, match="not observations"):
        read_observations(save(nav3))


def test_shared_logs(shared):
    for name, systems, epochs in (
        ("brux-static-2019014/BRUX00BEL_S_20190140615_15M_01S_MO.rnx.gz", "GREC", 900),
        ("tst-urban-2019118/COM3_190428_124409.obs.gz", "GC", 1760),
        ("imu-walk-2025240/walk.obs.gz", "GECS", 536),
        ("clas-sept-2021078/SEPT078M.21O.gz", "GEJ", 900),
    ):
        t = read_observations(shared / name)
        assert (t.systems, len(t.t_ns)) == (systems, epochs)
        assert t.notes == ()
