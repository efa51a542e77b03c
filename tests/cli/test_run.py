"""``pntegrity run`` and the commands that go on from its record, when all is well."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys

import polars as pl
import pytest
from polars.testing import assert_frame_equal

from gnss_logs import PLACE

NAMES = [
    "config.toml",
    "exclusions.csv",
    "report.html",
    "solution.parquet",
    "summary.json",
    "updates.npz",
    "verdicts.parquet",
]


def test_a_log_gives_all_results_and_a_table(plain):
    assert plain.called.code == 0
    assert plain.called.err == ""
    assert sorted(p.name for p in plain.folder.iterdir()) == NAMES
    assert plain.excluded == ["G07"]
    assert plain.summary["epochs"] == 60
    assert plain.summary["availability"]["ok"]["epochs"] == 60
    assert set(plain.verdicts["status"].unique()) <= {"ok", "alert", "unavailable"}
    assert str(plain.folder / "report.html") in plain.called.out


def test_the_configuration_beside_the_results_gives_the_same_results(plain, tmp_path, pnt):
    again = tmp_path / "again"
    assert pnt("run", "--config", plain.folder / "config.toml", "--out", again).code == 0
    assert_frame_equal(pl.read_parquet(again / "verdicts.parquet"), plain.verdicts)
    assert_frame_equal(pl.read_parquet(again / "solution.parquet"), plain.solution)
    assert (again / "config.toml").read_text() == (plain.folder / "config.toml").read_text()


def test_every_option_survives_the_configuration_file(run, tmp_path, pnt):
    (tmp_path / "noise.toml").write_text(
        "[noise]\ncode_bias_m = 0.5\n[noise.factors]\nglr = 1.5\n[noise.satellites]\nG05 = [2.0, 1.5]\n"
    )
    first = run(
        "--estimator", "spp_kf", "--monitors", "glr,rctm", "--p-fa", "1e-4", "--no-exclude", "--mask-deg",
        "15", "--systems", "GE",
        "--truth-ecef", ",".join(map(str, PLACE)), "--fault", "G05 ramp 0.5 m/s 40:", "--start", "2", "--end",
        "50", "--no-doppler",
        "--noise", tmp_path / "noise.toml",
    )  # fmt: skip
    assert first.called.code == 0
    assert first.excluded == []
    assert first.verdicts["monitor"].unique().to_list() in (["glr", "rctm"], ["rctm", "glr"])
    assert first.solution.height == 49
    assert pnt("run", "--config", first.folder / "config.toml", "--out", tmp_path / "again").code == 0
    assert_frame_equal(pl.read_parquet(tmp_path / "again" / "verdicts.parquet"), first.verdicts)
    assert (tmp_path / "again" / "config.toml").read_text() == (first.folder / "config.toml").read_text()


def test_an_option_wins_over_the_file(plain, tmp_path, pnt):
    assert (
        pnt(
            "run", "--config", plain.folder / "config.toml", "--monitors", "rctm", "--out", tmp_path / "r"
        ).code
        == 0
    )
    assert pl.read_parquet(tmp_path / "r" / "verdicts.parquet")["monitor"].unique().to_list() == ["rctm"]


def test_options_of_single_monitors_come_from_the_file(plain, tmp_path, pnt):
    text = (plain.folder / "config.toml").read_text()
    (tmp_path / "c.toml").write_text(text + "\n[monitor.aime]\nwindow = 1\n")
    assert (
        pnt("run", "--config", tmp_path / "c.toml", "--monitors", "aime,rctm", "--out", tmp_path / "r").code
        == 0
    )
    table = pl.read_parquet(tmp_path / "r" / "verdicts.parquet")
    aime, rctm = (table.filter(pl.col("monitor") == m)["statistic"].to_list() for m in ("aime", "rctm"))
    assert aime == pytest.approx(rctm, rel=1e-6)  # AIME over one epoch is RCTM


def test_the_record_gives_the_verdicts_of_the_run_again(plain, tmp_path, pnt):
    out = tmp_path / "again.parquet"
    called = pnt("monitor", plain.folder / "updates.npz", "--out", out)
    assert called.code == 0
    assert "glr" in called.out
    columns = ["t_ns", "monitor", "status", "statistic", "threshold", "suspects"]
    assert_frame_equal(pl.read_parquet(out).select(columns), plain.verdicts.filter("final").select(columns))


def test_audit_of_a_record(plain, pnt):
    called = pnt(
        "audit", plain.folder / "updates.npz", "--monitor", "rctm", "--tests", 20_000, "--onsets", 1, "--json"
    )
    assert called.code == 0
    assert json.loads(called.out)


def test_the_snapshot_estimator_runs_too(run):
    done = run("--estimator", "spp", "--monitors", "rctm", "--end", "30")
    assert done.called.code == 0
    assert done.excluded == ["G07"]


def test_gzip_is_read_as_it_is(files, tmp_path, pnt, plain):
    import gzip

    packed = tmp_path / "rover.rnx.gz"
    packed.write_bytes(gzip.compress(files.obs.read_bytes()))
    assert pnt("run", "--obs", packed, "--nav", files.nav, "--out", tmp_path / "r").code == 0
    assert_frame_equal(pl.read_parquet(tmp_path / "r" / "verdicts.parquet"), plain.verdicts)


LIGHT = """
import sys
sys.argv = ["pntegrity", {arguments}]
from pntegrity.cli import main
try:
    main()
except SystemExit as stop:
    assert stop.code == 0, stop.code
heavy = {{"numpy", "scipy", "numba", "polars", "plotly", "pydantic", "sidereon"}} & set(sys.modules)
assert not heavy, heavy
"""


@pytest.mark.parametrize("arguments", ['"--help"', '"--version"', '"run", "--help"', '"audit", "--help"'])
def test_help_imports_nothing_heavy(arguments):
    done = subprocess.run(
        [sys.executable, "-c", LIGHT.format(arguments=arguments)], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    assert "Usage" in done.stdout or "version" in done.stdout


def test_the_installed_command_says_what_it_can_do():
    command = shutil.which("pntegrity", path=str(sys.prefix) + "/bin")
    done = subprocess.run([command, "--help"], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0
    for name in ("run", "demo", "monitor", "audit", "calibrate", "reproduce"):
        assert f"\n  {name} " in done.stdout


def test_every_command_has_a_help(pnt):
    from pntegrity.cli import COMMANDS

    for name in COMMANDS:
        called = pnt(name, "--help")
        assert called.code == 0
        assert called.out.startswith(f"Usage: pntegrity {name}")
