"""Output folders that cannot be written, and interrupts: nothing is lost, nothing is half, and it is said."""

from __future__ import annotations

import signal
import subprocess
import sys

import polars as pl
import pytest
from polars.testing import assert_frame_equal

from pntegrity.pipeline import Pipeline


def test_a_file_where_the_folder_should_be(files, tmp_path, pnt):
    (tmp_path / "results").write_text("precious")
    assert pnt("run", "--obs", files.obs, "--nav", files.nav, "--out", tmp_path / "results").refused(
        "there is a file of that name"
    )
    assert pnt("run", "--obs", files.obs, "--nav", files.nav, "--out", tmp_path / "results" / "a").refused(
        "cannot be made"
    )
    assert (tmp_path / "results").read_text() == "precious"


def test_the_folder_is_tried_before_the_work(files, tmp_path, pnt, monkeypatch):
    (tmp_path / "results").write_text("precious")
    monkeypatch.setattr(Pipeline, "push", lambda *_: pytest.fail("worked in vain"))
    assert pnt("run", "--obs", files.obs, "--nav", files.nav, "--out", tmp_path / "results").refused(
        "cannot be made"
    )


def snapshot(folder):
    return {p.name: p.read_bytes() for p in folder.iterdir() if p.is_file()}


def test_what_was_there_stays_whole_when_a_file_cannot_be_replaced(run):
    # GIVEN results, and a folder in the way of one of the next ones
    before = run("--end", "8")
    report = before.folder / "report.html"
    report.unlink()
    report.mkdir()
    # WHEN another run is written over them
    again = run("--end", "12")
    # THEN it is one line, no temporary file is left, and every file that is there is whole
    assert again.called.refused("report.html", "cannot be written")
    assert not [p for p in again.folder.iterdir() if p.name.endswith(".tmp")]
    assert again.verdicts.height in (9 * 5, 13 * 5) or again.verdicts.height > 0
    assert again.summary["epochs"] in (9, 13)


def test_a_full_disk_leaves_the_old_results(run, monkeypatch):
    import os

    before = snapshot(run("--end", "8").folder)

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    again = run("--end", "12")
    assert again.called.refused("No space left on device")
    assert snapshot(again.folder) == before


def test_leftovers_of_a_killed_run_do_not_harm(run, tmp_path):
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / ".verdicts.parquet.1.tmp").write_bytes(b"half")
    (tmp_path / "results" / "verdicts.parquet").write_bytes(b"half a file of another tool")
    done = run("--end", "8")
    assert done.called.code == 0
    assert done.verdicts.height > 0


def test_ctrl_c_keeps_and_says_what_was_done(run, plain, monkeypatch):
    # GIVEN a user who loses patience after 25 epochs
    push, seen = Pipeline.push, []

    def impatient(self, epoch):
        seen.append(epoch.t_ns)
        if len(seen) > 25:
            raise KeyboardInterrupt
        return push(self, epoch)

    monkeypatch.setattr(Pipeline, "push", impatient)
    done = run()
    # THEN all results of 25 epochs are there, it is said, and the exit status is that of an interrupt
    assert done.called.code == 130
    assert "the 25 epochs done so far were written" in done.called.err
    assert done.summary["interrupted"] is True
    assert done.summary["epochs"] == 25
    assert done.excluded == ["G07"]
    first = plain.verdicts.filter(pl.col("t_ns") <= seen[24])
    assert_frame_equal(done.verdicts, first)
    assert (done.folder / "report.html").exists()


def test_ctrl_c_before_the_first_epoch(run, monkeypatch):
    def at_once(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(Pipeline, "push", at_once)
    done = run()
    assert done.called.code == 130
    assert "the 0 epochs" in done.called.err
    assert done.summary["epochs"] == 0


def test_ctrl_c_while_reading(run, monkeypatch):
    import pntegrity.run

    def at_once(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(pntegrity.run, "read_observations", at_once)
    done = run()
    assert done.called.code == 130
    assert "interrupted" in done.called.err
    assert "Traceback" not in done.called.err


SIGNALLED = """
import os, signal, sys
from pntegrity.pipeline import Pipeline
push, count = Pipeline.push, [0]
def counted(self, epoch):
    count[0] += 1
    if count[0] == 12:
        os.kill(os.getpid(), signal.SIGINT)
    return push(self, epoch)
Pipeline.push = counted
from pntegrity.cli import main
sys.argv = ["pntegrity", *{arguments}]
main()
"""


def test_a_real_signal(files, tmp_path):
    out = tmp_path / "r"
    arguments = [
        "run",
        "--obs",
        str(files.obs),
        "--nav",
        str(files.nav),
        "--out",
        str(out),
        "--monitors",
        "rctm",
    ]
    code = SIGNALLED.format(arguments=arguments)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.returncode == 130
    assert "interrupted: the 12 epochs done so far were written" in done.stderr
    assert "Traceback" not in done.stderr
    # the epoch that is computed while the signal comes is finished
    assert pl.read_parquet(out / "verdicts.parquet")["t_ns"].n_unique() == 12
    assert signal.SIGINT.value == 2
