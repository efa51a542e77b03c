"""``pntegrity products``: a file from half an hour of a real station, and what it refuses."""

from __future__ import annotations

import numpy as np
import pytest

from pntegrity.formats.atmosphere import read_atmosphere
from pntegrity.physics.atmosphere_products import metres_per_tecu

OPEC = "3149785.49,598261.34,5495348.98"


@pytest.fixture
def make(shared, pnt, tmp_path):
    """Run the command on the first half hour of the OPEC log."""
    folder = shared / "opec-static-2022001"
    if not folder.is_dir():
        pytest.skip("opec-static-2022001 not in the shared data")
    obs, sp3 = next(folder.glob("*_MO.rnx.gz")), next(folder.glob("*SP3.gz"))
    given = [
        "--obs",
        obs,
        "--sp3",
        sp3,
        "--antex",
        shared / "antex/igs14_sats_only.atx.gz",
        "--systems",
        "GC",
    ]

    def run(name, *options, position=OPEC, end="1800"):
        words = [*given, "--end", end, "--position", position, "--out", tmp_path / name, *options]
        return pnt("products", *words), tmp_path / name

    return run


PLAIN: list = []


@pytest.fixture
def plain(make):
    """Return what it says and makes without further options, run once."""
    if not PLAIN:
        called, path = make("plain.csv")
        PLAIN.append((called, path))
    return PLAIN[0]


def test_it_writes_what_it_says(plain):
    called, path = plain
    assert called.code == 0, called
    made = read_atmosphere(path)
    assert made.self_derived
    assert (made.latency_s, made.interval_s, made.troposphere_kind) == (30.0, 30.0, "ZWD")
    assert {s[0] for s in made.ionosphere} == {"G", "C"}
    assert made.notes == ()
    assert str(len(made.ionosphere)) in called.out
    assert "self-derived" in called.out
    assert "share its noise" in called.out
    assert str(path) in called.out.replace("\n", "")
    assert called.err == ""


def test_parquet_holds_the_same(make, plain):
    called, path = make("same.parquet")
    assert called.code == 0, called
    one, two = read_atmosphere(plain[1]), read_atmosphere(path)
    for sat, series in one.ionosphere.items():
        np.testing.assert_allclose(two.ionosphere[sat], series, rtol=0, atol=1e-6)


def test_added_errors_are_as_stated_and_are_those_of_the_seed(make, plain):
    extra = ("--add-noise", "0.2,0.1", "--tau-s", "0")
    (_, one), (_, again), (_, other) = (
        make(f"{n}.csv", *extra, "--seed", seed) for n, seed in (("a", 1), ("b", 1), ("c", 2))
    )
    assert one.read_bytes() == again.read_bytes() != other.read_bytes()
    clean, made = read_atmosphere(plain[1]), read_atmosphere(one)
    assert "errors added: slant 0.2 m" in made.source
    scale = metres_per_tecu(1575.42e6)
    added = np.concatenate(
        [scale * (made.ionosphere[s][1] - clean.ionosphere[s][1]) for s in clean.ionosphere]
    )
    assert added.std() == pytest.approx(0.2, rel=0.1)
    grown = np.concatenate([np.hypot(clean.ionosphere[s][2], 0.2 / scale) for s in clean.ionosphere])
    np.testing.assert_allclose(
        np.concatenate([made.ionosphere[s][2] for s in clean.ionosphere]), grown, rtol=1e-6
    )


def test_latency_and_interval(make, plain):
    called, path = make("later.csv", "--latency-s", "90", "--interval-s", "120")
    assert called.code == 0, called
    early, late = read_atmosphere(plain[1]), read_atmosphere(path)
    assert set(np.diff(late.troposphere[0])) == {120 * 10**9}
    np.testing.assert_array_equal(late.troposphere[0] - 60 * 10**9, early.troposphere[0][::4])
    np.testing.assert_allclose(late.troposphere[1], early.troposphere[1][::4], atol=1e-9)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--position", "1,2"), ("--position", "3 numbers X,Y,Z")),
        (("--position", "1,2,nan"), ("--position", "3 numbers X,Y,Z")),
        (("--position", OPEC, "--add-noise", "0.2"), ("--add-noise", "2 numbers SLANT,ZENITH")),
        (("--position", OPEC, "--add-noise", "0.2,-1"), ("--add-noise", "at least 0")),
        (("--position", OPEC, "--latency-s", "-1"), ("--latency-s",)),
        (("--position", OPEC, "--estimator", "spp"), ("No such option", "--estimator")),
        (("--obs", "x"), ("--position",)),
        (("--position", OPEC), ("no obs file",)),
    ],
)
def test_options_that_make_no_sense(pnt, tmp_path, options, words):
    called = pnt("products", "--out", tmp_path / "p.csv", *options)
    assert called.refused(*words)
    assert list(tmp_path.iterdir()) == []


def test_it_refuses_before_the_work_what_it_could_not_write(pnt, tmp_path):
    for out, words in ((tmp_path, "directory"), (tmp_path / "no" / "p.csv", "folder is not there")):
        assert pnt("products", "--obs", "x", "--position", OPEC, "--out", out).refused(words)


def test_broadcast_ephemerides_are_not_enough(pnt, files, tmp_path):
    given = ("--obs", files.obs, "--nav", files.nav, "--position", OPEC, "--out", tmp_path / "p.csv")
    assert pnt("products", *given).refused("precise orbits", "--sp3")


def test_coordinates_of_another_place(make):
    called, path = make("wrong.csv", position="3149785.49,598261.34,5495848.98", end="120")
    assert called.refused("from the coordinates", "--position")
    assert not path.exists()
