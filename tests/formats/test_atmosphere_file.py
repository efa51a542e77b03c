"""Files with products of the atmosphere: what is written comes back, what is damaged is told."""

import contextlib
import tempfile
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pntegrity.errors import InputError
from pntegrity.formats.atmosphere import read_atmosphere, write_atmosphere
from pntegrity.physics.atmosphere_products import AtmosphereProducts
from pntegrity.physics.time import from_iso

T0 = from_iso("2022-01-01T00:00:00")
TEXT = """\
# source = station OPEC, GPS and BeiDou
# self_derived = true
# latency_s = 30
time,quantity,satellite,value,sigma
2022-01-01T00:00:00,zwd,,0.0812,0.01
2022-01-01T00:00:00,stec,G05,12.25,0.5
2022-01-01T00:00:00.25,stec,C21,-3.5,1e-3
2022-01-01T00:00:30,stec,G05,12.5,0.5
"""


def some(kind="ZWD", seed=1):
    rng = np.random.default_rng(seed)
    t_ns = T0 + 250_000_000 * np.arange(50)
    slant = {
        s: (t_ns[:n], rng.normal(20, 9, n), rng.uniform(1e-5, 2, n)) for s, n in (("G05", 50), ("E11", 9))
    }
    zenith = t_ns[::10], rng.normal(0.1, 0.01, 5), rng.uniform(1e-4, 0.1, 5)
    return AtmosphereProducts(slant, zenith, kind, 0.25, "a station, by hand", True, 12.5)


@pytest.mark.parametrize("name", ["p.csv", "p.csv.gz", "p.parquet", "p"])
@pytest.mark.parametrize("kind", ["ZWD", "ZTD"])
def test_what_is_written_comes_back(tmp_path, name, kind):
    made = some(kind)
    write_atmosphere(tmp_path / name, made)
    found = read_atmosphere(tmp_path / name)
    assert list(found.ionosphere) == ["E11", "G05"]
    for sat, series in made.ionosphere.items():
        np.testing.assert_array_equal(found.ionosphere[sat][0], series[0])
        np.testing.assert_allclose(found.ionosphere[sat], series, rtol=0, atol=1e-6)
    np.testing.assert_allclose(found.troposphere, made.troposphere, rtol=0, atol=1e-6)
    for fact in ("troposphere_kind", "interval_s", "source", "self_derived", "latency_s", "notes"):
        assert getattr(found, fact) == getattr(made, fact), fact
    assert [p.name for p in tmp_path.iterdir()] == [name]


def test_a_file_by_hand(save):
    found = read_atmosphere(save(TEXT, "hand.csv"))
    assert (found.source, found.self_derived, found.latency_s) == ("station OPEC, GPS and BeiDou", True, 30.0)
    assert found.interval_s == 30.0
    assert found.troposphere_kind == "ZWD"
    np.testing.assert_array_equal(found.ionosphere["G05"][1], [12.25, 12.5])
    assert found.ionosphere["C21"][0].tolist() == [T0 + 250_000_000]
    assert found.notes == ()


@pytest.mark.parametrize("mark", [";", "\t"])
def test_other_separators_orders_and_a_windows_file(save, mark):
    lines = [line.split(",") for line in TEXT.splitlines()[3:]]
    text = "\r\n".join(mark.join([*line[::-1], "x"]) for line in lines) + "\r\n"
    found, plain = read_atmosphere(save(text, "other.csv")), read_atmosphere(save(TEXT, "hand.csv"))
    np.testing.assert_array_equal(found.ionosphere["G05"], plain.ionosphere["G05"])
    assert found.source == "other.csv"
    assert not found.self_derived


def test_parquet_of_another_maker_has_times_as_times(tmp_path):
    frame = pl.read_csv(TEXT.encode(), comment_prefix="#", try_parse_dates=True)
    assert frame["time"].dtype.is_temporal()
    frame.write_parquet(tmp_path / "theirs.parquet")
    found = read_atmosphere(tmp_path / "theirs.parquet")
    assert found.ionosphere["C21"][0].tolist() == [T0 + 250_000_000]
    assert found.troposphere[1].tolist() == [0.0812]


def test_bad_lines_are_dropped_counted_and_the_first_are_named(save):
    bad = [
        "2022-01-01T00:01:00,stec,G05,nan,0.5", "2022-01-01T00:01:00,stec,G05,1,0",
        "2022-01-01T00:01:00,stec,G05,1,-1", "late,stec,G05,1,1", "1970-01-01,stec,G05,1,1",
        "2022-01-01T00:01:00,vtec,G05,1,1", "2022-01-01T00:01:00,stec,X05,1,1",
        "2022-01-01T00:01:00,zwd,G05,1,1", "2022-01-01T00:01:00,stec,G05,1", "",
        "2022-01-01T00:01:00,stec,G05,1,inf", "2022-01-01T00:01:00,stec,G05,1,nan",
        "2022-01-01T00:00:30,stec,G05,13.5,0.5",
    ]  # fmt: skip
    found = read_atmosphere(save(TEXT + "\n".join(bad) + "\n2022-01-01T00:02:00,stec,G05,12.6,0.", "bad.csv"))
    assert found.notes == (
        "bad.csv: the last line has no line end and may be cut off: dropped",
        "bad.csv: 1 lines dropped: value is not finite; line 9",
        "bad.csv: 4 lines dropped: sigma is not finite and above 0; line 10, 11, 19, ...",
        "bad.csv: 2 lines dropped: time, value or sigma cannot be read; line 12, 13",
        "bad.csv: 1 lines dropped: unknown quantity (stec, zwd and ztd are known); line 14",
        "bad.csv: 1 lines dropped: no such satellite; line 15",
        "bad.csv: 1 lines dropped: zenith delay with a satellite; line 16",
        "bad.csv: 1 lines dropped: 5 cells expected; line 17",
        "1 samples left out: another one of the same product and time follows",
    )
    np.testing.assert_array_equal(found.ionosphere["G05"][1], [12.25, 13.5])


def test_facts_that_cannot_be_understood_are_told(save):
    text = TEXT.replace("= true", "= perhaps").replace("= 30", "= -1")
    found = read_atmosphere(save(text, "facts.csv"))
    assert (found.self_derived, found.latency_s) == (False, 0.0)
    assert len(found.notes) == 2
    assert all("cannot be understood" in n for n in found.notes)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", ("empty",)),
        ("# source = nobody\n", ("nothing but comments", "Columns are")),
        ("time,stec,value\n", ("no column quantity, satellite, sigma", "line 1")),
        (TEXT.replace("time,", "when,"), ("no column time", "line 4")),
        ("time,quantity,satellite,value,sigma\n", ("no line can be used", "Columns are")),
        ("time,quantity,satellite,value,sigma\nx,stec,G05,1,1\n", ("no line can be used (1 lines", "line 2")),
        (TEXT + "2022-01-01T00:00:30,ztd,,2.4,0.1\n", ("two kinds", "line 9", "not both")),
        (b"PAR1" + bytes(40) + b"PAR1", ("Parquet file is damaged",)),
        (b"\x00\x01\x02" * 50, ("binary",)),
    ],
)
def test_what_cannot_be_used_is_refused_with_the_file_the_line_and_a_hint(save, content, words):
    path = save(content, "wrong.csv")
    with pytest.raises(InputError) as caught:
        read_atmosphere(path)
    text = str(caught.value)
    assert text.startswith(str(path))
    assert all(word in text for word in words), text
    assert caught.value.hint


def test_parquet_without_a_column_or_with_nothing_in_it(tmp_path):
    frame = pl.read_csv(TEXT.encode(), comment_prefix="#")
    for part, words in ((frame.drop("sigma"), "no column sigma"), (frame[:0], "no line can be used")):
        part.write_parquet(tmp_path / "p.parquet")
        with pytest.raises(InputError, match=words):
            read_atmosphere(tmp_path / "p.parquet")


def test_a_folder_that_is_not_there(tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        write_atmosphere(tmp_path / "no" / "p.csv", some())
    with pytest.raises(InputError, match="no such file"):
        read_atmosphere(tmp_path / "p.csv")


def _whole(name):
    with tempfile.TemporaryDirectory() as folder:
        write_atmosphere(Path(folder) / name, some())
        return (Path(folder) / name).read_bytes()


@settings(max_examples=150, deadline=5000)
@given(
    st.sampled_from([TEXT.encode(), _whole("p.csv.gz")]),
    st.floats(0, 1), st.binary(max_size=6), st.integers(0, 60),
)  # fmt: skip
def test_damage_gives_products_or_an_input_error(original, where, insert, deleted):
    at = int(where * len(original))
    with tempfile.TemporaryDirectory() as folder, contextlib.suppress(InputError):
        path = Path(folder) / "sample"
        path.write_bytes(original[:at] + insert + original[at + deleted :])
        read_atmosphere(path)


def test_a_parquet_file_that_is_cut_off(tmp_path):
    whole, path = _whole("p.parquet"), tmp_path / "cut.parquet"
    for end in range(4, len(whole), 37):
        path.write_bytes(whole[:end])
        with pytest.raises(InputError, match="damaged"):
            read_atmosphere(path)
