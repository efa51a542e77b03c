"""A vessel to try: simulated to files, and run from them as a user would."""

from __future__ import annotations

import json
import tomllib
from dataclasses import replace

import numpy as np
import polars as pl
import pytest

from pntegrity.cli.simulate_vessel import command
from pntegrity.config import make_config
from pntegrity.estimators.multi_source import MultiSource
from pntegrity.exclusion import Policy
from pntegrity.pipeline import Pipeline
from pntegrity.run import load_epochs, options_for, pipeline_for
from pntegrity.scenarios.vessel import simulated_vessel
from pntegrity.simulate.constellation import KLOBUCHAR

SECONDS, SEED = 75, 4
FILES = {
    "depth.csv", "gnss.nav", "gnss.rnx", "imu.csv", "lbl.csv", "spec.toml", "truth.csv", "usbl.csv",
    "vehicle.toml",
}  # fmt: skip
FAULT = "lbl.AP1 ramp 0.8 ms/s 40:60"


def simulate(folder):
    argv = ["--out", str(folder), "--seconds", str(SECONDS), "--seed", str(SEED)]
    assert command.main(argv, standalone_mode=False) == 0
    return folder


def place(outcome):
    return outcome.update.posterior.block("pos")[0]


@pytest.fixture(scope="module")
def ship(tmp_path_factory):
    """A short vessel as files."""
    return simulate(tmp_path_factory.mktemp("vessel") / "ship")


def test_a_false_beacon_is_left_out_since_its_onset_and_comes_back(ship, pnt, tmp_path):
    out = tmp_path / "out"
    called = pnt("run", "--config", ship / "vehicle.toml", "--fault", FAULT, "--out", out)
    assert called.code == 0, called
    told = json.loads((out / "summary.json").read_text())
    (left_out,) = told["exclusions"]
    assert left_out["key"] == "lbl.AP1"
    times = pl.read_parquet(out / "solution.parquet")["t_ns"].to_numpy()
    (row,) = pl.read_csv(out / "exclusions.csv").iter_rows(named=True)
    # left out 8 s after the fault began at most, and run again from before its onset was estimated
    assert 40.0 < (row["t_ns"] - times[0]) * 1e-9 < 48.0
    assert left_out["onset"] < left_out["from"] < left_out["to"]
    assert told["availability"]["ok"]["epochs"] == SECONDS
    assert max(told["position"][axis]["max_m"] for axis in "enu") < 5.0
    assert (out / "report.html").exists()


def test_files_say_what_the_vessel_in_memory_says(ship):
    made = simulated_vessel(SECONDS, 1.0, 100.0, SEED)
    config = make_config(tomllib.loads((ship / "vehicle.toml").read_text()))
    loaded = load_epochs(config)
    assert [e.t_ns for e in loaded.epochs] == [e.t_ns for e in made.log.epochs]
    assert not loaded.notes
    # THEN the description makes the sources that the vessel has
    options = options_for(config, loaded)
    sources = tuple(replace(s, klobuchar=KLOBUCHAR) if s.name == "gnss" else s for s in made.log.sources)
    for read, own in zip(options.sources, sources, strict=True):
        assert type(read) is type(own)
        assert all(getattr(read, f) == getattr(own, f) for f in vars(own) if f.startswith(("sigma", "mask")))
    # AND both navigate alike: RINEX rounds pseudoranges to 1 mm, twelve of them to 3 tenths of it each
    read = pipeline_for(config, loaded)
    model = MultiSource(replace(options, sources=sources))
    own = Pipeline(model, config.build_monitors(), Policy(**model.policy))
    outcomes = [(read.push(a), own.push(b)) for a, b in zip(loaded.epochs, made.log.epochs, strict=True)]
    apart = [np.linalg.norm(place(a) - place(b)) for a, b in outcomes]
    assert max(apart) < 1e-3


def test_the_truth_is_that_of_the_motion(ship):
    made = simulated_vessel(SECONDS, 1.0, 100.0, SEED)
    table = pl.read_csv(ship / "truth.csv", comment_prefix="#")
    assert {"vx_mps", "roll_deg", "heading_deg"} <= set(table.columns)
    np.testing.assert_allclose(
        table.select("x_m", "y_m", "z_m").to_numpy(), made.log.truth.position_m, atol=1e-6
    )


def test_the_same_seed_gives_the_same_bytes(ship, tmp_path, monkeypatch):
    # GIVEN the same name of the folder, which stands in the description
    monkeypatch.chdir(tmp_path)
    for run in ("a", "b"):
        (tmp_path / run).mkdir()
        monkeypatch.chdir(tmp_path / run)
        command.main(["--out", "ship", "--seconds", "60", "--seed", "9"], standalone_mode=False)
    first, second = (tmp_path / run / "ship" for run in ("a", "b"))
    assert {p.name for p in first.iterdir()} == {p.name for p in second.iterdir()} == FILES
    for path in first.iterdir():
        assert path.read_bytes() == (second / path.name).read_bytes(), path.name
    assert (first / "lbl.csv").read_bytes() != (ship / "lbl.csv").read_bytes()


def test_a_folder_of_an_earlier_vessel_is_taken_and_any_other_refused(pnt, tmp_path):
    other = tmp_path / "other"
    other.mkdir()
    (other / "thesis.tex").write_text("years of work")
    assert pnt("simulate-vessel", "--out", other).refused("other", "--out")
    assert [p.name for p in other.iterdir()] == ["thesis.tex"]
    ship = tmp_path / "ship"
    for seed in (1, 2):
        made = pnt("simulate-vessel", "--out", ship, "--seconds", 60, "--seed", seed)
        assert made.code == 0, made
    assert "seed 2" in (ship / "vehicle.toml").read_text()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--seconds", "5"), ("--seconds", "60")),
        (("--rate-hz", "3"), ("--rate-hz", "RINEX")),
        (("--rate-hz", "0"), ("--rate-hz",)),
        (("--imu-hz", "1"), ("--imu-hz",)),
        (("--seed", "-1"), ("--seed",)),
        (("--seed", "x"), ("--seed",)),
    ],
)
def test_options_that_cannot_be_are_refused(pnt, tmp_path, options, words):
    assert pnt("simulate-vessel", "--out", tmp_path / "ship", *options).refused(*words)
    assert not (tmp_path / "ship").exists()


def test_a_file_in_the_place_of_the_folder_is_refused(pnt, tmp_path):
    (tmp_path / "ship").write_text("")
    assert pnt("simulate-vessel", "--out", tmp_path / "ship", "--seconds", 60).refused("ship")
