"""A vessel whose files or description are wrong: an error that names what to do, or a run that tells it."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from pntegrity.pipeline import Pipeline
from pntegrity.scenarios.vessel import simulated_vessel

SECONDS, SECOND_NS = 60, 10**9
Lines = list[str]
Change = Callable[[Lines], Lines]


@pytest.fixture(scope="module")
def ship(tmp_path_factory):
    """A short vessel as files: GNSS, LBL, USBL, depth."""
    folder = tmp_path_factory.mktemp("bad") / "ship"
    folder.mkdir()
    simulated_vessel(SECONDS, 1.0, 100.0, 3).write(folder)
    return folder


class Ran:
    """What a run left, and how far it was off while it said ok."""

    def __init__(self, called, out: Path) -> None:
        self.called, self.code, self.err, self.out = called, called.code, called.err, out

    @property
    def told(self):
        return json.loads((self.out / "summary.json").read_text())

    @property
    def notes(self) -> str:
        return "; ".join(self.told["notes"])

    @property
    def solution(self) -> pl.DataFrame:
        return pl.read_parquet(self.out / "solution.parquet")

    @property
    def left_out(self) -> set[str]:
        return {e["key"].partition(".")[0] for e in self.told["exclusions"]}

    def honest(self) -> bool:
        """Tell whether it ended well, without a word of Python, and no ok epoch is off beyond its level."""
        assert self.code == 0, self.err
        assert not self.err
        s = self.solution.filter(pl.col("status") == "ok")
        assert np.isfinite(s.select("x_m", "y_m", "z_m").to_numpy()).all()
        known = s.drop_nulls(["error_h_m", "hpl_m"])
        assert (known["error_h_m"] <= known["hpl_m"]).all()
        assert (known["error_u_m"].abs() <= known["vpl_m"]).all()
        return True


@pytest.fixture
def broken(ship, pnt, tmp_path):
    """Run the vessel with files changed line by line, and its description by pairs of texts."""

    def go(*options: object, toml: Sequence[tuple[str, str]] = (), **files: Change | None) -> Ran:
        text = (ship / "vehicle.toml").read_text()
        for stem, change in files.items():
            old = next(p for p in ship.iterdir() if p.stem == stem and p.suffix in (".csv", ".rnx"))
            new = tmp_path / old.name
            if change is not None:  # None: there is no such file
                new.write_text("\n".join(change(old.read_text().splitlines())) + "\n")
            assert str(old) in text
            text = text.replace(str(old), str(new))
        for old_text, new_text in toml:
            assert old_text in text
            text = text.replace(old_text, new_text, 1)
        (tmp_path / "vehicle.toml").write_text(text)
        out = tmp_path / "out"
        return Ran(pnt("run", "--config", tmp_path / "vehicle.toml", "--out", out, *options), out)

    return go


def rows(change: Callable[[float, list[str]], list[str] | None]) -> Change:
    """Return a change of each row of a table by its time, s after the first; None drops it."""

    def changed(lines: Lines) -> Lines:
        start = int(lines[2].split(",")[0])
        cells = (line.split(",") for line in lines[2:])
        found = (change((int(c[0]) - start) * 1e-9, c) for c in cells)
        return [*lines[:2], *(",".join(c) for c in found if c is not None)]

    return changed


def renamed(old: str, new: str) -> Change:
    return lambda lines: [lines[0], lines[1].replace(old, new), *lines[2:]]


def later(seconds: float) -> Change:
    return rows(lambda t, c: [str(int(c[0]) + round(seconds * SECOND_NS)), *c[1:]])


def until(seconds: float) -> Change:
    return rows(lambda t, c: c if t <= seconds else None)


def stuck(from_s: float, to_s: float, names: int) -> Change:
    """Return a change that repeats the last value of each row; `names`: columns before the values."""
    last: dict[str, list[str]] = {}

    def hold(t: float, c: list[str]) -> list[str]:
        key = c[1] if names == 2 else ""
        if not from_s < t <= to_s:
            last[key] = c[names:]
        return [*c[:names], *last[key]]

    return rows(hold)


@pytest.mark.parametrize(
    ("files", "words"),
    [
        ({"lbl": lambda lines: []}, ("lbl.csv", "source lbl", "empty")),
        ({"lbl": lambda lines: lines[:2]}, ("lbl.csv", "source lbl", "no usable line")),
        ({"gnss": lambda lines: lines[:8]}, ("gnss.rnx", "source gnss")),
        ({"gnss": None}, ("gnss.rnx: source gnss: no such file",)),
        ({"depth": None}, ("depth.csv: source depth: no such file",)),
        ({"imu": None}, ("imu.csv: no such file",)),
        ({"lbl": later(86400.0)}, ("lbl.csv", "clocks disagree", "lbl from", "the IMU from")),
        ({"usbl": renamed("bearing_deg", "bearing_rad")}, ("usbl.csv, line", "source usbl", "bearing_deg")),
        ({"usbl": renamed("bearing_deg", "bearing")}, ("usbl.csv", "has no unit", "bearing_rad")),
        ({"lbl": renamed("one_way_ms", "one_way_s")}, ("lbl.csv", "source lbl", "one_way_s", "ms")),
        ({"lbl": rows(lambda t, c: [*c[:2], "-" + c[2]])}, ("lbl.csv, line 3", "no usable line")),
        ({"imu": lambda lines: [*lines[:2], *lines[:1:-1]]}, ("imu.csv", "Sort the table")),
    ],
)  # fmt: skip
def test_files_that_cannot_be_used_are_refused_with_source_and_file(broken, files, words):
    ran = broken(**files)
    assert ran.called.refused(*words)
    assert "options" not in ran.err


@pytest.mark.parametrize(
    ("toml", "words"),
    [
        (("3361184", "-3361184"), ("source lbl", "beacon 'AP2'", "km from where gnss says", "signs")),
        (("y_m = 4591086", "y_m = -4591086"), ("source usbl", "the transponder", "its sound comes from")),
        (("sigma_s = 0.001", "sound_speed_mps = 15"), ("`sound_speed_mps`", "1300 and 1800 m/s, not 15")),
        (("sigma_s = 0.001", 'two_way = "yes"'), ("source lbl", "`two_way` must be true or false")),
        (("sigma_s = 0.001", "sea_height_m = 0\nprofile = 3"), ("source lbl", "`profile` must be", "file")),
        (
            ("sigma_s = 0.001", "sea_height_m = 0\nprofile = { depth_m = [0, 'a'], speed_mps = [1500, 1] }"),
            ("`profile`: `depth_m` must be a number, not 'a'",),
        ),
        (("sigma_m = 0.3", "sea_height_m = 'high'"), ("source depth", "`sea_height_m` must be a number")),
        (("AP2 = {", "AP5 = {"), ("lbl.csv", "source lbl", "beacon 'AP2' has no coordinates", "AP5")),
        (("AP2 = { x_m", "AP2 = { delay_s"), ("source lbl", "AP2")),
        (("sigma_s = 0.001", "prior = 2"), ("source lbl", "`prior`", "0 to 1")),
        (("sigma_s = 0.001", "sigma_s = -1"), ("source lbl", "`sigma_s` must be positive")),
        (("sigma_s = 0.001", "lever_arm_m = [1500, 0, 2000]"), ("source lbl", "lever_arm_m")),
        (("sigma_m = 2.5", "lever_arm_m = [1500, 0, 2000]"), ("source gnss", "lever_arm_m")),
        (("sigma_m = 2.5", 'lever_arm_m = "1,2,3"'), ("source gnss", "`lever_arm_m`", "three numbers")),
        (('type = "usbl"', 'type = "noise"'), ("`type` must be one of depth, dvl, fix, gnss, lbl, usbl",)),
        (('name = "usbl"', 'name = "lbl"'), ("two sources", "'lbl'")),
        (("estimator =", "source = ['a']\nestimator ="), ("vehicle.toml",)),
    ],
)
def test_descriptions_that_cannot_be_are_refused_with_the_source(broken, toml, words):
    ran = broken(toml=[toml])
    assert ran.called.refused(*words)
    assert "options:" not in ran.err


def test_a_profile_that_ends_above_the_beacons_is_refused_with_both_depths(broken, tmp_path):
    path = tmp_path / "ssp.csv"
    path.write_text("depth_m,speed_mps\n0,1500\n50,1498\n")
    ran = broken(toml=[("sigma_s = 0.001", f'sea_height_m = 0.0\nprofile = "{path}"')])
    assert ran.called.refused("source lbl", "ends at 50.0 m", "beacon 'AP1'", "add a row at that depth")


@pytest.mark.parametrize("value", ["3", "['a.csv', 'b.csv']"])
def test_a_file_that_is_no_name_is_refused(broken, ship, value):
    ran = broken(toml=[(f'file = "{ship / "depth.csv"}"', f"file = {value}")])
    assert ran.called.refused("source depth", "`file` must be the name of a file", 'file = "..."')


def test_travel_times_a_thousand_times_too_short_are_refused(broken):
    ran = broken(lbl=rows(lambda t, c: [*c[:2], f"{float(c[2]) * 1e-3:.9f}"]))
    assert ran.called.refused("source lbl", "beacon 'AP1'", "unit of its times")


def test_bare_seconds_of_a_source_need_the_field_that_says_when_they_begin(broken):
    def bare(lines: Lines) -> Lines:
        start = int(lines[2].partition(",")[0])
        cells = (line.split(",") for line in lines[2:])
        table = [f"{(int(c[0]) - start) * 1e-9:.3f},{c[1]}" for c in cells]
        return [lines[0], lines[1].replace("t_ns", "t_s"), *table]

    ran = broken(depth=bare)
    assert ran.called.refused("depth.csv", "source depth", "bare seconds", "origin_ns")
    assert "--imu-start" not in ran.err
    ran = broken(depth=bare, toml=[("sigma_m = 0.3", 'origin_ns = "2024-05-17T16:53:26"')])
    assert ran.called.refused("source depth", "`origin_ns` must be a whole number")


def test_marks_of_the_byte_order_are_no_part_of_a_name(broken):
    def marked(lines: Lines) -> Lines:
        return ["\ufeff" + lines[1], *lines[2:]]

    assert broken("--end", "20", imu=marked, lbl=marked, depth=marked).honest()


def test_angles_that_look_like_radians_are_told(broken):
    def small(t: float, c: list[str]) -> list[str]:
        return [*c[:2], *(f"{np.radians(float(v)):.9f}" for v in c[2:])]

    told = "where these are radians, name the columns bearing_rad and elevation_rad"
    assert told in broken("--end", "15", usbl=rows(small)).notes


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("lbl.AP1 ramp 0.8 m/s 20:30", ("lbl.AP1 measures s, not m",)),
        ("usbl.bearing bias 1 m 20:30", ("usbl.bearing measures rad, not m",)),
        ("dvl.X bias 1 m 20:30", ("no such row", "lbl.AP1")),
        ("lbl.AP1 ramp 0.8 ms/s 120:140", ("no epoch in that time", "from 0 s to 59 s", "every 1 s")),
        ("lbl.AP1 bias 8 m 120:140", ("lbl.AP1 measures s, not m",)),
        ("gnss.G01 bias 9 m 60:", ("no epoch in that time", "from 0 s to 59 s")),
        ("usbl.bearing sine 9 deg 5 s 20.2:20.8", ("no epoch in that time", "from 0 s to 59 s")),
        ("clock-drift 1 m/s 100:200", ("no epoch in that time", "from 0 s to 59 s")),
        (
            "depth bias 9 m 2024-05-17T16:00:00/2024-05-17T16:30:00",
            ("no epoch in that time", "from 2024-05-17T16:53:26 to 2024-05-17T16:54:25"),
        ),
    ],
)
def test_a_fault_on_what_is_not_there_is_refused_with_what_is(broken, fault, words):
    assert broken("--fault", fault).called.refused(*words)


def test_a_fault_where_its_sensor_is_silent_is_refused_with_when_it_speaks(broken):
    silent = rows(lambda t, c: c if c[1] != "AP1" or 10.0 <= t <= 40.0 else None)
    ran = broken("--fault", "lbl.AP1 bias 5 ms 45:55", lbl=silent)
    assert ran.called.refused("no such row at that time", "from 10 s to 40 s after the first")


def test_a_unit_in_degrees_or_whose_rates_are_too_small_is_refused_by_the_track(pnt, tmp_path):
    folder = tmp_path / "ship"
    folder.mkdir()
    simulated_vessel(300, 1.0, 100.0, 1).write(folder)
    table = folder / "imu.csv"
    head, lines = table.read_text().splitlines()[:2], table.read_text().splitlines()[2:]
    for factor, words in (
        (np.pi / 180.0, ("57.3 times too small", "gyro_x_rps", "dtheta_x_rad")),
        (0.01, ("100 times too small", "increments that are named rates", "dtheta_x_rad")),
        (180.0 / np.pi, ("angular rates are absurd", "gyro_x_dps", "dtheta_x_deg")),
    ):
        cells = (line.split(",") for line in lines)
        other = [",".join([c[0], *(f"{float(v) * factor:.9e}" for v in c[1:4]), *c[4:]]) for c in cells]
        table.write_text("\n".join([*head, *other]) + "\n")
        ran = pnt("run", "--config", folder / "vehicle.toml", "--end", "240", "--out", tmp_path / "out")
        assert ran.refused("imu.csv", *words)


def test_what_is_damaged_is_dropped_and_told_once(broken):
    def damaged(lines: Lines) -> Lines:
        bad = [
            "!!garbage;;",
            lines[10].rpartition(",")[0] + ",NaN",
            lines[12].rpartition(",")[0] + ",inf",
            "",
        ]
        return [*lines[:10], *bad, *lines[13:60], *lines[50:60], *lines[60:]]

    def negative(t: float, c: list[str]) -> list[str]:
        return [*c[:2], "-" + c[2]] if c[1] == "AP1" and 20 < t < 30 else c

    ran = broken(
        usbl=damaged, depth=damaged, lbl=rows(negative), toml=[("AP2 =", "AP9 = {x_m=-2868096,y_m=4590969,"
        "z_m=3361184}\nAP2 =")],
    )  # fmt: skip
    assert ran.honest()
    assert "lbl.csv: 9 lines dropped" in ran.notes
    assert "source lbl: beacon 'AP9' never replies" in ran.notes
    assert ran.notes.count("usbl.csv") == 2
    assert ran.notes.count("of the same name and time") == 2


def test_tables_in_any_order_are_put_in_order(broken):
    turned: Change = lambda lines: [*lines[:2], *lines[:1:-1]]  # noqa: E731
    ran = broken(lbl=turned, usbl=turned, depth=turned)
    assert ran.honest()
    assert ran.told["availability"]["ok"]["share"] == 1.0
    assert ran.told["exclusions"] == []


@pytest.mark.parametrize("name", ["lbl", "usbl"])
def test_a_source_that_repeats_its_last_value_is_told_and_left_out(broken, name):
    ran = broken(**{name: stuck(20.0, 50.0, 2 if name == "lbl" else 1)})
    assert ran.honest()
    assert f"{name}:R." in ran.notes
    assert "repeats its last value" in ran.notes
    assert ran.left_out == {name}


def test_sources_that_come_late_or_go_early_are_told(broken):
    ran = broken(lbl=rows(lambda t, c: c if t >= 35.0 else None), usbl=until(24.0))
    assert ran.honest()
    assert "source lbl begins at" in ran.notes
    assert "source usbl ends at" in ran.notes


def test_stamps_in_utc_are_told(broken):
    ran = broken(depth=later(-18.0))
    assert "all times of source depth are 18 s before those of the others" in ran.notes
    assert ran.honest()


def test_where_all_sources_are_lost_the_levels_grow_up_to_the_alert(broken):
    ends = until(30.0)

    def receiver(lines: Lines) -> Lines:
        at = [i for i, line in enumerate(lines) if line.startswith(">")]
        return lines[: at[31]]

    ran = broken(lbl=ends, usbl=ends, depth=ends, gnss=receiver, toml=[("[ism]", "[ism]\nhal_m = 20.0")])
    assert ran.honest()
    assert "no source says anything after" in ran.notes
    alone = ran.solution.slice(31)
    assert len(alone) > 25
    assert (alone["hpl_m"].diff().drop_nulls() > 0.0).all()
    assert alone["status"][0] == "ok"
    assert set(alone.filter(pl.col("hpl_m") > 20.0)["status"]) == {"alert"}
    assert "alert limit" in alone["reason"][-1]
    # AND not beyond the end that was asked for
    ended = broken("--end", "40", lbl=ends, usbl=ends, depth=ends, gnss=receiver).solution
    assert ended["t_ns"].max() <= alone["t_ns"][9]
    assert len(ended) > 38


@pytest.mark.parametrize(
    ("change", "note"),
    [
        (rows(lambda t, c: c if not 30.0 < t < 35.0 else None), "the IMU has 1 gap"),
        (until(25.0), "the IMU ends at"),
        (stuck(36.0, 50.0, 1), "all six values stay the same"),
    ],
)
def test_a_unit_that_fails_is_told_and_the_sources_go_on(broken, change, note):
    ran = broken(imu=change)
    assert ran.honest()
    assert note in ran.notes
    assert ran.left_out == set()
    assert ran.told["availability"]["ok"]["share"] == 1.0


def test_what_was_computed_before_an_interrupt_is_kept(broken, monkeypatch):
    # GIVEN an interrupt while the 20th epoch is computed
    push, pushed = Pipeline.push, []

    def interrupted(self, epoch):
        pushed.append(epoch.t_ns)
        if len(pushed) == 20:
            signal.raise_signal(signal.SIGINT)
        return push(self, epoch)

    monkeypatch.setattr(Pipeline, "push", interrupted)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # jobs in the background ignore it
    usual = signal.getsignal(signal.SIGINT)
    try:
        ran = broken()
    finally:
        after = signal.signal(signal.SIGINT, before)
    assert (ran.code, ran.told["interrupted"]) == (130, True)
    assert "the 20 epochs done so far were written" in ran.err
    assert ran.solution["t_ns"].to_list() == pushed
    assert after is usual
