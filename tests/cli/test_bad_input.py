"""Everything that can be wrong with what a user gives: one line that says what to do, or a run that says
what it left out.
"""

from __future__ import annotations

import gzip
import os

import pytest
from polars.testing import assert_frame_equal

from gnss_logs import START, simulated
from pntegrity.formats.rinex_write import write_navigation, write_observations
from pntegrity.sensors.ranges import C_MPS
from pntegrity.simulate.constellation import nominal_navigation
from pntegrity.simulate.receiver import keep_only

SECOND = 10**9

# --- files that are not what they should be
# ------------------------------------------------------------------

UNUSABLE = {
    "missing": (None, "no such file"),
    "empty": (b"", "empty"),
    "binary": (bytes(range(256)) * 20, "binary"),
    "zeros": (bytes(4000), "binary"),
    "text": (b"hello\nworld\n", "not a RINEX file"),
    "html": (b"<!DOCTYPE html><html><body>404 Not Found</body></html>\n", "not a RINEX file"),
    "cut gzip": (gzip.compress(os.urandom(20000))[:5000], "gzip"),
}


@pytest.mark.parametrize("kind", UNUSABLE)
@pytest.mark.parametrize("which", ["obs", "nav"])
def test_an_unusable_file_is_named_with_what_is_wrong(files, tmp_path, pnt, which, kind):
    content, word = UNUSABLE[kind]
    bad = tmp_path / "bad.rnx"
    if content is not None:
        bad.write_bytes(content)
    given = {"obs": files.obs, "nav": files.nav} | {which: bad}
    called = pnt("run", "--obs", given["obs"], "--nav", given["nav"], "--out", tmp_path / "r")
    assert called.refused(str(bad), word)


def test_a_folder_or_the_wrong_kind_of_file(files, tmp_path, pnt):
    assert pnt("run", "--obs", tmp_path, "--nav", files.nav, "--out", tmp_path / "r").refused("directory")
    assert pnt("run", "--obs", files.nav, "--nav", files.nav, "--out", tmp_path / "r").refused(
        "not observations"
    )
    assert pnt("run", "--obs", files.obs, "--nav", files.obs, "--out", tmp_path / "r").refused(
        "not navigation messages"
    )


def test_a_header_alone_holds_nothing(run):
    assert run(epochs=[]).called.refused("changed.rnx")


def test_a_truncated_log_is_used_up_to_there(run, files):
    cut = "".join(files.epochs[:20])
    done = run(epochs=[cut[: len(cut) - 300]])
    assert done.called.code == 0
    assert done.summary["epochs"] in (19, 20)
    assert done.notes


def test_a_damaged_line_costs_its_epoch_or_satellite_and_is_told(run, files):
    epochs = list(files.epochs)
    epochs[5] = epochs[5].replace("\nG0", "\n\x07!", 1)
    epochs[9] = epochs[9].replace(" 2024 ", " 2o24 ", 1)
    done = run(epochs=epochs)
    assert done.called.code == 0
    assert 57 <= done.summary["epochs"] <= 60
    assert done.notes


# --- logs that do not fit each other
# -------------------------------------------------------------------------


def test_navigation_of_another_day(run, tmp_path):
    other = tmp_path / "other.rnx"
    day = 86_400 * SECOND
    write_navigation(other, nominal_navigation(START - 3 * day, START - 3 * day + 3600 * SECOND, "GE"))
    assert run(nav=other).called.refused("no ephemeris fits", "2024-05-29", "same day")


def test_a_constellation_without_ephemerides_is_left_out_and_told(run, tmp_path):
    gps = tmp_path / "gps.rnx"
    write_navigation(gps, nominal_navigation(START, START + 600 * SECOND, "G"))
    done = run("--end", "15", nav=gps)
    assert done.called.code == 0
    assert "Galileo: no ephemerides" in done.notes
    assert set(done.summary["satellites"]["systems"]) == {"G"}


def test_systems_that_are_not_in_the_file(run):
    assert run("--systems", "R").called.refused("no satellite of the systems R", "It holds GE")


# --- time
# ----------------------------------------------------------------------------------------------------


def test_a_gap_is_passed_over(run, files, plain):
    done = run(epochs=[*files.epochs[:5], *files.epochs[17:]])
    assert done.called.code == 0
    assert done.summary["epochs"] == 48
    assert done.excluded == ["G07"]


def test_repeated_and_backward_epochs_are_dropped_and_told(run, files, plain):
    e = files.epochs
    done = run(epochs=[*e[:10], e[9], e[3], *e[10:], e[0]])
    assert done.called.code == 0
    assert "3 epochs dropped: their time repeats, goes back" in done.notes
    assert_frame_equal(done.verdicts, plain.verdicts)


def test_event_records_are_skipped_and_told(run, files, plain):
    event = "> 2024 06 01 09 30 10.5000000  4  1\n" + f"{'a stop for coffee':<60}COMMENT\n"
    done = run(epochs=[*files.epochs[:11], event, *files.epochs[11:]])
    assert done.called.code == 0
    assert "1 event skipped: header records" in done.notes
    assert_frame_equal(done.verdicts, plain.verdicts)


def test_a_power_failure_flag_keeps_the_epoch(run, files, plain):
    epochs = list(files.epochs)
    epochs[12] = epochs[12].replace("0000000  0 ", "0000000  1 ", 1)
    done = run(epochs=epochs)
    assert "power failure" in done.notes
    assert_frame_equal(done.verdicts, plain.verdicts)


@pytest.mark.parametrize("flag", ["1", "2", "3"], ids=["lost lock", "half cycle", "both"])
def test_flags_of_the_carrier_do_not_touch_the_code(run, files, plain, flag):
    marked = [
        _edited(e, lambda line: line[:33] + flag + line[34:]) if k % 7 == 0 else e
        for k, e in enumerate(files.epochs)
    ]
    assert marked != list(files.epochs)
    done = run(epochs=marked)
    assert done.called.code == 0
    assert_frame_equal(done.verdicts, plain.verdicts)


def _edited(epoch: str, edit) -> str:
    head, *rows = epoch.splitlines()
    return "\n".join([head, *map(edit, rows)]) + "\n"


def test_a_receiver_clock_jump_of_a_millisecond(run, files, plain, tmp_path):
    # GIVEN the same log by a receiver whose clock is 1 ms ahead (its tags are 1 ms late), from 35 s on
    late = simulated(60, clock_m=2000.0 + C_MPS * 1e-3)
    write_observations(tmp_path / "late.rnx", late.table)
    rest = ["> " + e.strip() + "\n" for e in (tmp_path / "late.rnx").read_text().split("\n>")[1:]]
    done = run(epochs=[*files.epochs[:35], *rest[35:]])
    assert done.called.code == 0
    assert done.excluded == ["G07"]
    assert any("clock jump of 1 ms removed" in event for event in done.summary["events"])
    for axis in ("x_m", "y_m", "z_m"):
        if axis in done.solution.columns:
            assert done.solution[axis].to_list() == pytest.approx(plain.solution[axis].to_list(), abs=0.01)
    assert done.summary["availability"]["ok"]["epochs"] == 60


# --- values
# --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "field", ["         0.000", " " * 14, "           NaN", "  9999999999.9", "    -99999.000"]
)
def test_pseudoranges_that_are_none_cost_their_rows_only(run, files, field):
    epochs = [
        _edited(e, lambda line: line[:3] + field + line[17:] if line[:3] in ("G05", "E16") else line)
        for e in files.epochs
    ]
    done = run("--end", "30", epochs=epochs)
    assert done.called.code == 0
    assert done.notes
    assert done.summary["availability"]["alert"]["epochs"] == 0
    used = done.summary["satellites"]["used_mean"]
    assert used < 16.5


def test_three_satellites_only_are_unavailable_with_the_reason(run, files):
    few = []
    for epoch in files.epochs[:10]:
        head, *rows = epoch.splitlines()
        kept = [r for r in rows if r[:3] in ("G05", "G24", "E16")]
        few.append("\n".join([f"{head[:32]}{len(kept):3d}", *kept]) + "\n")
    done = run(epochs=few)
    assert done.called.code == 0
    assert done.summary["availability"]["unavailable"]["epochs"] == 10
    assert done.verdicts["reason"].str.contains("a fix needs 5 satellites").all()
    assert (done.folder / "report.html").stat().st_size > 10_000


# --- options
# -------------------------------------------------------------------------------------------------

IMPOSSIBLE = {
    "--monitors foo": ["foo", "aime, factor_set, glr, rctm"],
    "--monitors ,": ["at least one monitor"],
    "--p-fa 0": ["p_fa", "greater than 0"],
    "--p-fa 0.5": ["p_fa", "0.5"],
    "--p-fa nan": ["p_fa"],
    "--p-fa much": ["--p-fa", "much"],
    "--mask-deg 95": ["mask_deg", "95"],
    "--mask-deg=-1": ["mask_deg", "-1"],
    "--systems X": ["systems", "X"],
    "--systems GX": ["systems", "GX"],
    "--estimator foo": ["foo", "spp, spp_kf"],
    "--variant inexact": ["--variant", "inexact"],
    "--truth-ecef 1,2": ["--truth-ecef"],
    "--truth-ecef 1,2,x": ["--truth-ecef"],
    "--truth-ecef 1,2,nan": ["truth_ecef_m", "finite"],
    "--truth-ecef 1,2,3 --truth t.csv": ["truth", "not both"],
    "--truth no_such.csv": ["no_such.csv", "no such file"],
    "--start soon": ["soon", "seconds from the start"],
    "--start nan": ["nan"],
    "--start 2024-13-01T00:00:00": ["2024-13-01"],
    "--start 40 --end 20": ["no epoch in the interval"],
    "--start 1e6": ["no epoch in the interval"],
    "--noise no_such.toml": ["no_such.toml"],
    "--config no_such.toml": ["no_such.toml"],
    "--frobnicate": ["--frobnicate"],
}
FAULTS = [
    "", "G05", "G05 wobble 3 m", "G05 bias", "G05 bias 15", "G05 bias 15 parsec", "G05 bias m",
    "G05 ramp 0.1 m 10:20",
    "G05 bias 1e999 m", "G05 bias nan m", "G05 bias 15 m 100:60", "G05 bias 15 m now",
    "G05 bias 15 m 10:20 and more", "bias 15 m",
    "G05 sine 3 m", "G05 sine 3 m 0 s", "??? bias 15 m", "G05 bias 15 m 2024-06-01T09:30:00",
]  # fmt: skip


@pytest.mark.parametrize("options", IMPOSSIBLE)
def test_an_impossible_option_is_refused(run, options):
    assert run(*options.split()).called.refused(*IMPOSSIBLE[options])


@pytest.mark.parametrize("text", FAULTS)
def test_a_fault_that_makes_no_sense_is_refused(run, text):
    assert run("--fault", text).called.refused("fault", "ramp 0.1 m/s 200:300")


CONFIGS = {
    "p_fa = 'small'": "p_fa",
    "monitors = 'rctm'": "monitors",
    "nonsense = 1": "nonsense",
    "faults = ['bad']": "bad",
    "noise = 3": "noise",
    "[noise]\ncode_white_m = -1.0": "code_white_m",
    "[noise]\ncode_white_m = 'big'": "code_white_m",
    "[noise]\nfoo = 1": "foo",
    "[noise]\nsatellites = 3": "satellites",
    "[noise.factors]\nglr = 'x'": "factors",
    "[noise.factors]\nglr = -1.0": "factor",
    "[monitor.foo]\nwindow = 3": "foo",
    "[monitor.aime]\nwindow = 0": "window",
    "[monitor.aime]\nwindow = 2.5": "window",
    "[monitor.aime]\nwindwo = 2": "windwo",
    "[monitor.rctm]\np_fa = 3.0": "p_fa",
    "[monitor.glr]\nlongest = 'x'": "longest",
    "[monitor.srctm]\nblock = 3": "block",
    "= = =": "not TOML",
    "\x00\x01": "not TOML",
}


@pytest.mark.parametrize("text", CONFIGS)
def test_a_configuration_that_cannot_be(run, tmp_path, text):
    config = tmp_path / "bad.toml"
    config.write_text(text + "\n")
    assert run("--config", config).called.refused(CONFIGS[text])


def test_options_that_are_missing(files, tmp_path, pnt):
    assert pnt("run", "--nav", files.nav, "--out", tmp_path).refused("no obs file", "--obs")
    assert pnt("run", "--obs", files.obs, "--out", tmp_path).refused("no nav file", "--nav")
    assert pnt("run", "--obs", files.obs, "--nav", files.nav).refused("--out")
    assert pnt("fly").refused("fly")
    assert pnt("reproduce", "nothing").refused("nothing")


def test_records_that_are_none(files, plain, tmp_path, pnt):
    record = plain.folder / "updates.npz"
    (tmp_path / "cut.npz").write_bytes(record.read_bytes()[:4000])
    (tmp_path / "noise.toml").write_text("[noise]\nfoo = 1\n")
    assert pnt("monitor", tmp_path / "none.npz").refused("none.npz")
    assert pnt("monitor", tmp_path / "cut.npz").refused("cut.npz")
    assert pnt("monitor", files.obs).refused("not a whole record")
    assert pnt("monitor", record, "--monitors", "foo").refused("foo")
    assert pnt("monitor", record, "--p-fa", "2").refused("2.0")
    assert pnt("monitor", record, "--noise", tmp_path / "noise.toml").refused("foo")
    assert pnt("monitor", record, "--out", tmp_path / "no" / "such" / "v.parquet").refused(
        "cannot be written"
    )
    assert pnt("audit", record, "--monitor", "rctm,glr").refused("one name")
    assert pnt("audit", record, "--monitor", "foo").refused("foo")
    assert pnt("audit", record, "--monitor", "rctm", "--delay", "-5").refused("--delay")
    assert pnt("audit", record, "--monitor", "rctm", "--p-fa", "0.9").refused("0.9")
    assert pnt("audit", record, "--monitor", "rctm", "--tests", "-1").refused("--tests")


def test_a_log_too_short_to_calibrate(files, tmp_path, pnt):
    called = pnt("calibrate", "--obs", files.obs, "--nav", files.nav, "--out", tmp_path / "noise.toml")
    assert called.refused("100 epochs")
    assert not (tmp_path / "noise.toml").exists()


def test_an_empty_table_is_refused_rather_than_written(tmp_path):
    with pytest.raises(ValueError, match="empty"):
        write_observations(tmp_path / "o.rnx", keep_only(simulated(3).table, lambda t, s: False))
