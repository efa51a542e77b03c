"""Arcs of whole tables: short gaps, clock resets, signals that alternate, and how many a clean log has."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from precise_files import SECOND, T0

from pntegrity.formats.rinex_obs import read_observations
from pntegrity.kernels import slips
from pntegrity.physics._assembly import bands
from pntegrity.physics._choice import choose, window
from pntegrity.physics.arcs import arcs_of, clock_resets_m
from pntegrity.physics.precise import clock_pieces
from pntegrity.physics.signals import SPEED_OF_LIGHT_MPS as C
from pntegrity.physics.signals import frequency_hz
from pntegrity.physics.tables import SignalTable

MS = C * 1e-3
PAIRS = {"G": ("1W", "2W", "2L"), "E": ("1C", "5Q", "7Q"), "R": ("1P", "2P", "2C")}


def table(n=60, step_s=30, sats=("G05", "G07", "E11", "R03", "G13"), seed=1, drop=lambda k, sat, name: False):
    """Return a log of three signals a satellite with carriers of 1 mm, codes of 10 cm, and Dopplers."""
    rng = np.random.default_rng(seed)
    rows = []
    ambiguity = {(s, x): int(rng.integers(-(10**6), 10**6)) for s in sats for x in PAIRS[s[0]]}
    for k in range(n):
        for j, sat in enumerate(sorted(sats)):
            rate = 300.0 * (j - 2)
            distance = 2.2e7 + 1e5 * j + rate * step_s * k
            for name in sorted(PAIRS[sat[0]]):
                if drop(k, sat, name):
                    continue
                wave = C / frequency_hz(sat, name, 0)
                code = distance + 0.1 * rng.standard_normal()
                carrier = (distance + 0.001 * rng.standard_normal()) / wave + ambiguity[sat, name]
                rows.append((k, sat, name, code, carrier, -rate / wave))
    columns = list(zip(*rows, strict=True))
    count = len(rows)
    return SignalTable(
        t_ns=T0 + step_s * SECOND * np.arange(n, dtype=np.int64),
        epoch=np.array(columns[0], dtype=np.int32), sat=np.array(columns[1]), signal=np.array(columns[2]),
        pseudorange_m=np.array(columns[3]), carrier_cycles=np.array(columns[4]),
        doppler_hz=np.array(columns[5]),
        cn0_dbhz=np.full(count, 45.0), lli=np.zeros(count, dtype=np.int8),
        glonass_channels={s: 0 for s in sats if s[0] == "R"},
    )  # fmt: skip


def edited(t, column, where, change):
    values = np.array(getattr(t, column))
    values[where] = change(values[where])
    return replace(t, **{column: values})


def begins(t, systems="GRE", clocks=None):
    """Return the satellites and epochs at which arcs begin, with the cause; and the number of clock
    resets.
    """
    _, rows = window(t, systems, None, None)
    chosen = choose(t, rows, {}, pair=True, precise=True)
    band = bands(t, t.glonass_channels, chosen, np.arange(len(chosen)))
    order = np.lexsort((chosen.epoch, chosen.sat))
    order = order[chosen.reason[order] == ""]
    shift, resets = clock_resets_m(t, chosen, band, order)
    piece = np.zeros(len(chosen), dtype=np.int64)
    if clocks is not None:
        piece = clock_pieces(clocks, chosen.sat, t.t_ns[chosen.epoch])
    arcs = arcs_of(t, chosen, band, order, piece, shift)
    at = np.flatnonzero(arcs.reason)
    found = {(str(chosen.sat[i]), int(chosen.epoch[i])): int(arcs.reason[i]) for i in at}
    return found, resets


def risen(t):
    return {(s, 0): slips.FIRST for s in np.unique(t.sat).tolist()}


def test_a_clean_log_has_an_arc_a_satellite():
    t = table()
    assert begins(t) == (risen(t), 0)


def test_a_missing_second_frequency_is_a_short_gap():
    t = table(drop=lambda k, sat, name: sat == "G05" and name[0] == "2" and k == 30)
    assert begins(t)[0] == risen(t)


def test_a_signal_that_is_missing_now_and_then_does_not_make_the_carrier_another_one():
    # GIVEN a second signal that is missing at every fourth epoch, where there would be another
    flicker = {"G05": "2L", "E11": "5Q", "R03": "2C"}
    t = table(drop=lambda k, sat, name: flicker.get(sat) == name and k % 4 == 3)
    assert begins(t)[0] == risen(t)


def test_where_the_signal_of_a_pass_is_gone_for_long_another_takes_its_place():
    t = table(n=120, drop=lambda k, sat, name: sat == "E11" and name == "5Q" and 40 <= k < 70)
    found, _ = begins(t)
    assert found == risen(t) | {("E11", 40): slips.RESTART, ("E11", 70): slips.RESTART}


def test_a_satellite_that_rises_again_may_have_other_signals():
    t = table(n=120, drop=lambda k, sat, name: sat == "E11" and (30 <= k < 90 or (k >= 90 and name == "5Q")))
    assert begins(t)[0] == risen(t) | {("E11", 90): slips.GAP}


@pytest.mark.parametrize("step_s", [1, 30])
@pytest.mark.parametrize(("n1", "n2"), [(1, 1), (9, 7), (1, 0)])
def test_slips_of_a_table_are_found(n1, n2, step_s):
    t = table(step_s=step_s)
    after = (t.sat == "G07") & (t.epoch >= 40)
    for names, cycles in ((("1W",), n1), (("2L", "2W"), n2)):
        t = edited(t, "carrier_cycles", after & np.isin(t.signal, names), lambda v, c=cycles: v + c)
    found, _ = begins(t)
    assert set(found) == {*risen(t), ("G07", 40)}


def test_the_flags_of_either_carrier_count():
    t = table()
    t = edited(t, "lli", (t.sat == "G05") & (t.epoch == 20) & (t.signal == "2W"), lambda v: v | 1)
    t = edited(t, "lli", (t.sat == "G13") & (t.epoch >= 40) & (t.signal == "1W"), lambda v: v | 2)
    expected = {("G05", 20): slips.LOST_LOCK, ("G13", 40): slips.HALF_CYCLE}
    assert begins(t)[0] == risen(t) | expected


@pytest.mark.parametrize("step_s", [1, 30])
@pytest.mark.parametrize("jumps", [{30: 1}, {20: -1, 40: 2}])
def test_a_receiver_clock_that_jumps_in_code_only_costs_no_arc(jumps, step_s):
    t = table(step_s=step_s)
    for at, ms in jumps.items():
        t = edited(t, "pseudorange_m", t.epoch >= at, lambda v, ms=ms: v + ms * MS)
    assert begins(t) == (risen(t), len(jumps))


def test_a_clock_that_jumps_in_code_and_carrier_is_no_reset():
    t = table()
    after = t.epoch >= 30
    wave = np.array(
        [C / frequency_hz(s, x, 0) for s, x in zip(t.sat.tolist(), t.signal.tolist(), strict=True)]
    )
    t = edited(t, "pseudorange_m", after, lambda v: v + MS)
    t = edited(t, "carrier_cycles", after, lambda v: v + MS / wave[after])
    assert begins(t) == (risen(t), 0)


def test_one_satellite_that_jumps_by_a_millisecond_is_no_reset():
    t = table()
    t = edited(t, "pseudorange_m", (t.sat == "G05") & (t.epoch >= 30), lambda v: v + MS)
    found, resets = begins(t)
    assert resets == 0
    assert found == risen(t) | {("G05", 30): slips.WIDE_LANE}


def one_frequency(step_s):
    t = table(step_s=step_s, sats=("G05", "G07", "G13", "G15", "G20"), drop=lambda k, sat, name: name != "1W")
    _, rows = window(t, "G", None, None)
    chosen = choose(t, rows, {"G": ("1W",)}, pair=False)
    return t, chosen


@pytest.mark.parametrize(("step_s", "found"), [(1, True), (30, False)])
def test_with_one_frequency_the_doppler_tells_at_1_hz_whatever_the_clock_does(step_s, found):
    t, chosen = one_frequency(step_s)
    wave = C / frequency_hz("G", "1W")
    # GIVEN a receiver clock that runs 20 m/s faster than Doppler says, and a slip of 5 cycles
    t = edited(t, "carrier_cycles", np.arange(len(t)), lambda v: v + 20.0 * step_s * t.epoch / wave)
    t = edited(t, "carrier_cycles", (t.sat == "G07") & (t.epoch >= 40), lambda v: v + 5.0)
    band = bands(t, {}, chosen, np.arange(len(chosen)))
    order = np.lexsort((chosen.epoch, chosen.sat))
    arcs = arcs_of(t, chosen, band, order, np.zeros(len(chosen), dtype=np.int64), np.zeros(len(chosen)))
    at = np.flatnonzero(arcs.reason > slips.FIRST)
    expected = [("G07", 40, slips.TIME_DIFFERENCE)] if found else []
    assert [(str(chosen.sat[i]), int(chosen.epoch[i]), int(arcs.reason[i])) for i in at] == expected


def test_arcs_are_counted_from_one_a_satellite():
    t = table()
    t = edited(t, "lli", (t.sat == "G05") & np.isin(t.epoch, (20, 40)), lambda v: v | 1)
    _, rows = window(t, "GRE", None, None)
    chosen = choose(t, rows, {}, pair=True, precise=True)
    band = bands(t, t.glonass_channels, chosen, np.arange(len(chosen)))
    order = np.lexsort((chosen.epoch, chosen.sat))
    nothing = np.zeros(len(chosen), dtype=np.int64)
    arcs = arcs_of(t, chosen, band, order, nothing, np.zeros(len(chosen)))
    assert np.unique(arcs.number[chosen.sat == "G05"]).tolist() == [1, 2, 3]
    assert np.unique(arcs.number[chosen.sat != "G05"]).tolist() == [1]


def test_a_clean_station_keeps_its_arcs(esbc, clocks):
    t = read_observations(next(esbc.glob("*_MO.rnx.gz")))
    found, resets = begins(t, clocks=clocks)
    causes = np.bincount(list(found.values()), minlength=9)
    assert resets == 0
    assert 60 <= causes[slips.FIRST] <= 70
    # a signal of a whole stretch ends, rarely; single epochs without it are gaps (59 when each epoch chose)
    assert causes[slips.RESTART] <= 18
    assert causes[slips.GAP] <= 8
    # slips of L2 below 16 dBHz, which the other carriers of the satellite do not show, and scintillation
    assert 4 <= causes[slips.GEOMETRY_FREE] <= 10
    assert causes[slips.WIDE_LANE] <= 16  # multipath, which only later epochs tell from a slip
    # THEN the gap in the clock product of G21 (01:49:30 to 01:50:30) begins a new arc
    assert [e for (s, e), why in found.items() if s == "G21" and why == slips.RESTART] == [221]
