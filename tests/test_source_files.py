"""What a table of a source reads, and from where."""

from __future__ import annotations

import numpy as np
import pytest

from acoustic_logs import ARM, BEACONS, write_log
from pntegrity.errors import InputError
from pntegrity.source_files import fields_of, formats_of, read_log, read_source
from pntegrity.vehicle import loaded, sources_of


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return write_log(tmp_path_factory.mktemp("logs") / "boat")


def table(kind, folder, **more):
    return {"type": kind, "file": str(folder), "format": "garpos", **more}


def test_a_log_gives_the_fixes_and_the_travel_times_under_the_names_of_the_sources(log):
    notes: list[str] = []
    fixes = read_source("fix", table("fix", log, name="gnss"), notes).observations
    times = read_source("lbl", table("lbl", log, name="sound"), notes).observations
    assert {o.sensor for o in fixes} == {"gnss"}
    assert fixes[0].keys == ("gnss:RX", "gnss:RY", "gnss:RZ")
    assert {k for o in times for k in o.keys} == {f"sound:R.{b}" for b in BEACONS}
    assert all(o.sigma is None for o in times)  # the source's own `sigma_s` counts


def test_what_the_table_does_not_say_of_the_source_comes_from_the_log(log):
    (lbl,) = sources_of([table("lbl", log)])
    assert set(lbl.beacons) == set(BEACONS)
    assert tuple(lbl.lever_arm_m) == ARM
    assert lbl.two_way
    assert lbl.sigma_s == 2e-4
    (own,) = sources_of(
        [table("lbl", log, sigma_s=1e-3, lever_arm_m=[0.0, 0.0, 2.0], sound_speed_mps=1490.0)]
    )
    assert own.sigma_s == 1e-3
    assert own.lever_arm_m == (0.0, 0.0, 2.0)
    assert own.profile is None


def test_a_fix_of_a_log_may_be_given_a_sigma(log):
    fix = read_source("fix", table("fix", log, sigma_m=0.2), []).observations[0]
    np.testing.assert_allclose(fix.aux["cov"], 0.04 * np.eye(3))
    with pytest.raises(InputError, match="sigma_m"):
        read_source("fix", table("fix", log, sigma_m=-1.0), [])


def test_a_log_is_read_once_until_a_file_of_it_changes(tmp_path):
    folder = write_log(tmp_path / "boat", 40.0)
    first = read_log(folder, "garpos")
    assert read_log(folder, "garpos") is first
    path = folder / "boat-obs.csv"
    path.write_text("\n".join(path.read_text().splitlines()[:-5]) + "\n")
    assert len(read_log(folder, "garpos").observations) == len(first.observations) - 5


def test_both_sources_of_a_log_come_in_one_order(log):
    epochs = loaded([table("fix", log, name="gnss"), table("lbl", log)], [])
    t = [e.t_ns for e in epochs]
    assert t == sorted(set(t))
    assert any(len(e.observations) == 2 for e in epochs)


def test_formats_are_those_of_the_type():
    assert formats_of("fix") == ("csv", "gnatss", "garpos")
    assert formats_of("gnss") == ("rinex",)
    assert formats_of("depth") == ("csv",)


def test_a_profile_may_be_a_file(log, tmp_path):
    path = tmp_path / "svp.csv"
    path.write_text("depth,speed\n0,1500\n1200,1488\n")
    (lbl,) = sources_of([table("lbl", log, profile=str(path))])
    assert float(lbl.water.sound.at(1200.0)) == 1488.0
    assert "profile" in fields_of("lbl", {"type": "lbl", "profile": str(path)})


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"format": "rinex"}, ("rinex", "csv", "garpos")),
        ({"file": "nowhere"}, ("nowhere", "no such folder")),
        ({"format": "gnatss"}, ("config.yaml",)),
        ({"beacons": {"M1": {"lat_deg": 34.9, "lon_deg": 139.2, "height_m": -900.0}}}, ("M2", "coordinates")),
        ({"profile": "nowhere.csv"}, ("nowhere.csv",)),
    ],
)
def test_what_cannot_be_read_says_what_to_do(log, change, words):
    with pytest.raises(ValueError, match=words[0]) as caught:
        sources_of([table("lbl", log) | change])
    assert all(w in str(caught.value) for w in words)


def test_a_log_is_a_folder(log):
    with pytest.raises(InputError, match="folder"):
        read_log(log / "boat-obs.csv", "garpos")
