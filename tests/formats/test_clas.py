"""Decoded files of CLAS corrections, and what surrounds the decoder of raw ones."""

from __future__ import annotations

import builtins
import importlib

import numpy as np
import pytest

from pntegrity.errors import InputError
from pntegrity.formats import clas_l6
from pntegrity.formats.clas import read_clas
from pntegrity.formats.clas_l6 import corrections_for, read_l6
from pntegrity.physics.time import from_week_tow

SATELLITES = (
    "gps_week,tow,sat,iode,dorb_radial_m,dorb_along_m,dorb_cross_m,dclk_m,ura_m,stec_tecu,stec_quality,"
    "cbias,pbias\n"
)
TROPOSPHERE = "gps_week,tow,network,zhd_at_0m,zwd_at_0m,trop_quality\n"
PLACE = [-3962108.673, 3381309.574, 3668678.638]
GRID = "Compact Network ID    GRID No.  Latitude     Longitude   Ellipsoidal height\n 7 1 35.16 139.61 0.00\n"


def line(tow=100, sat="G03", iode=37, clock="-1.45", ura="0.12", quality="0.0395", cbias=None, pbias=None):
    code = f"{sat[0]}C1C=0.0000;{sat[0]}C2X=1.8600" if cbias is None else cbias
    phase = f"{sat[0]}L1C=2.3070;{sat[0]}L2X=nan" if pbias is None else pbias
    return f"2149,{tow},{sat},{iode},0.5,0.6,0.1,{clock},{ura},-0.37,{quality},{code},{phase}\n"


def test_columns_of_both_files(save):
    sats = save(
        SATELLITES + line() + line(105, iode=38, clock="") + line(sat="E11", quality="nan"), "sat.csv"
    )
    trop = save(TROPOSPHERE + "2149,100,7,2.3,0.147,\n2149,105,7,2.312,0.1495,\n", "trop.csv")
    c = read_clas([trop, sats])
    assert sorted(c.satellites) == ["E11", "G03"]
    g = c.satellites["G03"]
    assert g.t_ns.tolist() == [int(from_week_tow(2149, t)) for t in (100, 105)]
    assert g.iode.tolist() == [37, 38]
    assert g.orbit_m[0].tolist() == [0.5, 0.6, 0.1]
    assert g.clock_m[0] == -1.45
    assert np.isnan(g.clock_m[1])
    assert g.code_bias_m["2X"].tolist() == [1.86, 1.86]
    assert np.isnan(g.phase_bias_m["2X"]).all()
    assert g.stec_sigma_tecu[0] == pytest.approx(0.0395 / 0.1624, rel=1e-3)
    assert c.zwd_m.tolist() == [0.147, 0.1495]
    assert (c.network, c.sources) == (7, ("trop.csv", "sat.csv"))
    assert "biases not known, signal not used then: 3 values" in c.notes
    assert "quality of the slant delay not known, delay not used then: 1 values" in c.notes
    assert c.coverage_ns == (g.t_ns[0], g.t_ns[1])


def test_order_does_not_matter_and_the_last_of_equal_rows_counts(save):
    rows = line(105) + line(100, clock="1.0") + line(100, clock="2.0")
    g = read_clas(save(SATELLITES + rows)).satellites["G03"]
    assert np.diff(g.t_ns).tolist() == [5 * 10**9]
    assert g.clock_m.tolist() == [2.0, -1.45]


def test_a_signal_that_comes_later_is_unknown_before(save):
    rows = line(100, cbias="GC1C=0.0") + line(105)
    g = read_clas(save(SATELLITES + rows)).satellites["G03"]
    assert np.isnan(g.code_bias_m["2X"]).tolist() == [True, False]


def test_what_is_missing_or_odd_is_told(save):
    c = read_clas(save(SATELLITES + line(ura="nan") + line(105).rstrip(), "a.csv"))
    assert len(c.t_ns) == 0
    assert "no file of the troposphere: no zenith delay" in c.notes
    assert "a.csv: the last line has no line end and may be cut off: dropped" in c.notes
    assert "accuracy (URA) not known, satellite not used then: 1 values" in c.notes
    trop = save(TROPOSPHERE + "2149,100,7,2.3,0.1,\n2149,105,8,2.3,0.1,\n", "t.csv")
    notes = read_clas([save(SATELLITES + line()), trop]).notes
    assert any(n.startswith("zenith delays of several networks (7, 8)") for n in notes)


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (line(sat="X03"), "no such satellite: 'X03'"),
        (line(sat="G3"), "no such satellite"),
        (line(iode="x"), "invalid literal"),
        (line(clock="one"), "could not convert"),
        (line(clock="inf"), "not finite"),
        (line(tow=700_000), "no such GPS time"),
        (line(tow="nan"), "no such GPS time"),
        (line(cbias="EC1C=0.0"), "no bias: 'EC1C=0.0'"),
        (line(pbias="GL1C:0.0"), "no bias"),
        ("2149,100,G03\n", "invalid literal"),
    ],
)
def test_a_bad_line_is_named(save, bad, words):
    path = save(SATELLITES + line() + bad, "sat.csv")
    with pytest.raises(InputError, match=r"sat\.csv, line 3") as caught:
        read_clas(path)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("gps_week,tow,sat\n2149,1,G03\n", "its header lacks iode"),
        (SATELLITES, "no satellite's corrections"),
        (TROPOSPHERE + "2149,100,7,2.3,0.1,\n", "no satellite's corrections"),
        ("\n", "empty"),
        ("\x00\x01\x02" * 50, "binary"),
    ],
)
def test_files_that_cannot_be_used(save, text, words):
    with pytest.raises(InputError, match=words):
        read_clas(save(text))


def test_no_file_at_all():
    with pytest.raises(InputError, match="no file"):
        read_clas([])


# --- raw messages -------------------------------------------------------------------------------------------


def test_without_the_decoder_the_extra_is_named(save, monkeypatch):
    real = importlib.import_module

    def missing(name, *rest):
        if name.startswith("cssrlib"):
            raise ModuleNotFoundError(f"No module named {name!r}")
        return real(name, *rest)

    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(InputError, match=r"pip install 'pntegrity\[clas\]'"):
        read_l6(save(b"\x1a\xcf\xfc\x1d" + bytes(246), "a.l6"), save(GRID, "grid.def"), 2149, PLACE)


def test_the_package_does_not_need_the_decoder(monkeypatch):
    real = builtins.__import__

    def strict(name, *rest, **more):
        assert not name.startswith("cssrlib")
        return real(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", strict)
    importlib.reload(clas_l6)


@pytest.mark.parametrize(("week", "place"), [(-1, PLACE), (2149, [1.0, 2.0]), (2149, [np.nan] * 3)])
def test_arguments_are_checked(week, place):
    with pytest.raises(ValueError, match=r"week|receiver_m"):
        read_l6("a.l6", "grid.def", week, place)


def message(number: int, alert: bool = False) -> bytes:
    return b"\x1a\xcf\xfc\x1d\xc7\xa0" + bytes([0x80 * alert]) + bytes([number]) * 243


def test_messages_are_found_between_other_bytes_and_alerts_left_out(save):
    from collections import Counter

    dropped: Counter[str] = Counter()
    data = b"junk" + message(1) + message(2, alert=True) + b"xyz" + message(3) + message(4)[:100]
    frames = list(clas_l6._frames(data, save(data), dropped))
    assert [f[-1] for f in frames] == [1, 3]
    assert dropped == {"message with the alert flag": 1, "bytes between messages": 3}
    with pytest.raises(InputError, match="no L6 message"):
        list(clas_l6._frames(b"junk" * 100, save(b"junk"), dropped))


class Log:
    """What is asked of a log."""

    def __init__(self, place=PLACE) -> None:
        self.t_ns = np.array([from_week_tow(2149, 100.0), from_week_tow(2149, 105.0)])
        self.approx_position_m, self.source = place, "log.21o"


def test_decoded_and_raw_files_are_told_apart_by_content(save, monkeypatch):
    csv = save(SATELLITES + line(), "named.l6")
    assert list(corrections_for(Log(), [csv]).satellites) == ["G03"]
    raw, grid = save(message(1) * 3, "named.csv"), save(GRID, "grid.def")
    asked = []
    monkeypatch.setattr(clas_l6, "read_l6", lambda *a, **k: asked.append((a, k)))
    log = Log()
    corrections_for(log, [raw], grid)
    assert asked == [((raw, grid, 2149, PLACE), {"end_ns": int(log.t_ns[-1])})]


@pytest.mark.parametrize(
    ("many", "grid", "place", "words"),
    [
        (True, "g", PLACE, "goes alone"),
        (False, None, PLACE, "need the grid's definition"),
        (False, "g", None, "does not tell where the receiver is"),
    ],
)
def test_what_a_raw_file_needs(save, many, grid, place, words):
    raw = save(message(1), "a.l6")
    with pytest.raises(InputError, match=words):
        corrections_for(Log(place), [raw, save(SATELLITES, "b.csv")] if many else [raw], grid)
