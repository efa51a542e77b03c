"""A small log on disk, and a way to call the command line as a shell would."""

from __future__ import annotations

import contextlib
import io
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from gnss_logs import navigation, simulated
from pntegrity.cli import main
from pntegrity.formats.rinex_write import write_navigation, write_observations
from pntegrity.simulate.faults import parse_fault
from pntegrity.simulate.receiver import with_faults

EPOCHS = 60
FAULT = "G07 bias 20 m 20:30"


@dataclass(frozen=True)
class Called:
    """What a command left: exit status, standard output, standard error."""

    code: int
    out: str
    err: str

    def refused(self, *words: str) -> bool:
        """Tell whether this was one line on standard error with some words in it, and exit status 2."""
        lines = self.err.strip().splitlines()
        assert self.code == 2, self
        assert len(lines) == 1, self.err
        assert lines[0].startswith("pntegrity: ")
        assert all(word in lines[0] for word in words), lines[0]
        return True


@dataclass(frozen=True)
class Files:
    """The log: files, and the text of the observations in parts (header, one string an epoch)."""

    obs: Path
    nav: Path
    header: str
    epochs: tuple[str, ...]


def call(*args: object) -> Called:
    """Run ``pntegrity ARGS`` in this process."""
    out, err, argv = io.StringIO(), io.StringIO(), sys.argv
    sys.argv = ["pntegrity", *map(str, args)]
    try:
        with (
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(err),
            pytest.raises(SystemExit) as stop,
        ):
            main()
    finally:
        sys.argv = argv
    return Called(stop.value.code, out.getvalue(), err.getvalue())


@pytest.fixture(scope="session")
def files(tmp_path_factory) -> Files:
    """One minute of GPS and Galileo with one fault, as RINEX."""
    folder = tmp_path_factory.mktemp("log")
    obs, nav = folder / "rover.rnx", folder / "brdc.rnx"
    write_observations(obs, with_faults(simulated(EPOCHS).table, [parse_fault(FAULT)]))
    write_navigation(nav, navigation())
    header, *epochs = obs.read_text().split("\n>")
    return Files(obs, nav, header + "\n", tuple(f">{e.rstrip()}\n" for e in epochs))


@pytest.fixture
def pnt() -> Callable[..., Called]:
    return call


@dataclass(frozen=True)
class Results:
    """The results folder of a run."""

    called: Called
    folder: Path

    @property
    def summary(self) -> dict[str, Any]:
        return json.loads((self.folder / "summary.json").read_text())

    @property
    def verdicts(self) -> pl.DataFrame:
        return pl.read_parquet(self.folder / "verdicts.parquet")

    @property
    def solution(self) -> pl.DataFrame:
        return pl.read_parquet(self.folder / "solution.parquet")

    @property
    def excluded(self) -> list[str]:
        return pl.read_csv(self.folder / "exclusions.csv")["key"].to_list()

    @property
    def notes(self) -> str:
        return "; ".join(self.summary["notes"])


@pytest.fixture
def run(files, tmp_path) -> Callable[..., Results]:
    """Run the log, or a changed one (a list of epochs as text), with options."""

    def go(
        *options: object,
        epochs: Sequence[str] | None = None,
        header: str | None = None,
        nav: Path | None = None,
    ) -> Results:
        obs = files.obs
        if epochs is not None or header is not None:
            obs = tmp_path / "changed.rnx"
            obs.write_text((header or files.header) + "".join(files.epochs if epochs is None else epochs))
        out = tmp_path / "results"
        return Results(call("run", "--obs", obs, "--nav", nav or files.nav, "--out", out, *options), out)

    return go


@pytest.fixture(scope="session")
def plain(files, tmp_path_factory) -> Results:
    """The log with all defaults."""
    out = tmp_path_factory.mktemp("plain")
    return Results(call("run", "--obs", files.obs, "--nav", files.nav, "--out", out), out)
