"""Satellites that fail together: who is in which sector, which events follow, what a city's message asks."""

from __future__ import annotations

import re
from dataclasses import replace
from math import inf, nan, radians
from pathlib import Path

import numpy as np
import pytest
from test_modes import rows, unassigned

from pntegrity.bounds import CITY, MESSAGES, Ism, events_of, fault_modes, sectors_at, with_risen
from pntegrity.errors import InputError

STREET = Ism(sectors=8, p_sector=1e-4, p_sat=1e-5)
SKY = {"G01": 0.1, "G02": 0.3, "E01": 0.5, "E02": 3.0, "G03": 3.2}


def test_every_azimuth_lies_in_as_many_sectors_as_overlap() -> None:
    for az in np.linspace(-7.0, 7.0, 997):
        assert len(sectors_at(STREET, float(az))) == 2
    assert len(sectors_at(Ism(sectors=3, sector_width_deg=120.0, p_sector=0.1), 1.0)) == 1
    assert len(sectors_at(Ism(sectors=4, sector_width_deg=360.0, p_sector=0.1), 1.0)) == 4


def test_two_satellites_closer_than_the_overlap_share_a_sector() -> None:
    rng = np.random.default_rng(2)
    for az in rng.uniform(0.0, 2.0 * np.pi, 500).tolist():
        near = az + radians(44.9) * float(rng.uniform(-1.0, 1.0))
        assert set(sectors_at(STREET, az)) & set(sectors_at(STREET, near))


@pytest.mark.parametrize(
    ("az_deg", "names"),
    [
        (0.0, ("az000", "az045")), (359.9, ("az000", "az315")), (45.0, ("az045", "az090")),
        (-100.0, ("az225", "az270")),
    ],
)  # fmt: skip
def test_sectors_are_named_by_their_middle(az_deg: float, names: tuple[str, ...]) -> None:
    assert sectors_at(STREET, radians(az_deg)) == names


@pytest.mark.parametrize("az", [nan, inf])
def test_no_azimuth_is_no_sector(az: float) -> None:
    assert sectors_at(STREET, az) == ()


def test_a_satellite_keeps_its_place_until_it_is_forgotten() -> None:
    first = with_risen(STREET, (), (), SKY)
    assert dict(first)["az180"] == ("E02", "G03")
    # WHEN it has moved, and another one rises where it was
    moved = {**SKY, "G03": 0.1, "R05": 3.0}
    after = with_risen(STREET, first, set(SKY), moved)
    assert dict(after)["az180"] == ("E02", "G03", "R05")
    # and when it was forgotten
    again = with_risen(STREET, after, {*SKY, "R05"} - {"G03"}, moved)
    assert dict(again)["az180"] == ("E02", "R05")
    assert "G03" in dict(again)["az000"]


def test_who_was_seen_without_an_azimuth_joins_no_sector_later() -> None:
    assert with_risen(STREET, (), {"G01"}, {"G01": 0.1}) == ()
    assert with_risen(STREET, (), (), {"G01": nan, "trop": 0.1, "lbl": 0.2}) == ()
    assert with_risen(Ism(), (), (), SKY) == ()


def test_a_sector_is_an_event_of_all_rows_of_its_satellites() -> None:
    sectors = with_risen(STREET, (), (), SKY)
    events = {e.name: e for e in events_of(STREET, tuple(SKY), sectors)}
    assert events["az180"].groups == ("E02", "G03")
    assert events["az180"].probability == 1e-4
    keys = ("G01:C1C", "G03:C1C", "G03:L1C", "E02:D1C", "iono:G03", "iono:G01", "trop:ZTD")
    assert rows(events["az180"].patterns, keys) == {"G03:C1C", "G03:L1C", "E02:D1C", "iono:G03"}
    # one of a single satellite counts beside it: both probabilities add
    alone = with_risen(STREET, (), (), {"G01": 0.1})
    modes = fault_modes(events_of(STREET, ("G01",), alone), 1e-3, 0.0).monitored
    assert {m.name: m.probability for m in modes} == pytest.approx(
        {"G01": 1e-5, "az000": 1e-4, "az045": 1e-4}
    )


@pytest.mark.parametrize("threshold", [0.1, 0.03, 1e-3, 0.0])
def test_with_sectors_everything_that_can_happen_is_covered_or_counted(threshold: float) -> None:
    ism = Ism(
        p_sat=0.03, p_trop=0.1, p_constellation=0.01, sectors=2, sector_width_deg=200.0, p_sector=0.05,
        together=(("mast", ("G01", "trop"), 0.02),),
    )  # fmt: skip
    groups = (*SKY, "trop")
    events = events_of(ism, groups, with_risen(ism, (), (), SKY))
    assert {e.name for e in events} == {*groups, "G", "E", "az000", "az180", "mast"}
    found = fault_modes(events, 1.0, threshold, 10_000)
    keys = ("trop:ZTD", *(f"{s}:C1C" for s in SKY))
    assert unassigned(events, found, keys) <= found.unmonitored + 1e-9
    assert found.unmonitored <= threshold


def test_declared_groups_are_an_event_as_soon_as_one_of_them_is_there() -> None:
    ism = Ism(p_sat=0.0, p_other=0.0, together=(("mast", ("G05", "lbl"), 1e-3), ("off", ("G05",), 0.0)))
    (event,) = events_of(ism, ("lbl", "G07"))
    assert (event.name, event.groups, event.probability) == ("mast", ("lbl",), 1e-3)
    assert rows(event.patterns, ("lbl:AP1", "G05:C1C", "iono:G05", "G07:C1C")) == {
        "lbl:AP1", "G05:C1C", "iono:G05",
    }  # fmt: skip
    assert events_of(ism, ("G07",)) == ()


def test_a_name_that_is_a_group_of_the_data_is_refused() -> None:
    ism = Ism(together=(("lbl", ("G05", "lbl"), 1e-3),))
    with pytest.raises(InputError, match="name of a group of rows, 'lbl'"):
        events_of(ism, ("lbl",))


@pytest.mark.parametrize("satellites", [6, 15, 30, 50])
def test_in_a_city_singles_sectors_and_constellations_are_enough(satellites: int) -> None:
    rng = np.random.default_rng(satellites)
    sky = {
        f"{'GECR'[i % 4]}{i // 4 + 1:02d}": float(rng.uniform(0.0, 2.0 * np.pi)) for i in range(satellites)
    }
    events = events_of(CITY, tuple(sky), with_risen(CITY, (), (), sky))
    found = fault_modes(events, CITY.p_hmi, CITY.p_unmonitored, CITY.max_modes)
    names = {m.name for m in found.monitored}
    # only GPS as a whole is too improbable to be looked at, and no pair is needed
    assert names == {e.name for e in events} - {"G"}
    assert all(len(m.events) == 1 for m in found.monitored)
    assert found.unmonitored <= CITY.p_unmonitored
    assert min(CITY.risks(found.unmonitored)) > 0.0


def test_the_page_tells_the_numbers_of_a_city() -> None:
    page = (Path(__file__).parents[2] / "docs" / "formats" / "ism.md").read_text(encoding="utf-8")
    told = dict(re.findall(r"`(\w+)` = ([0-9.e-]+)", page))
    changed = {k: v for k, v in CITY.to_table().items() if v != Ism().to_table()[k] or k in told}
    assert changed.pop("constellations")["G"]["p_constellation"] == 1e-8
    assert {k: float(v) for k, v in told.items()} == changed


def test_a_message_of_ones_own_starts_from_that_of_the_surroundings() -> None:
    mine = Ism.from_table(MESSAGES["city"].to_table() | {"p_hmi": 1e-4})
    assert mine == replace(CITY, p_hmi=1e-4)
    assert MESSAGES["open"] == Ism()
