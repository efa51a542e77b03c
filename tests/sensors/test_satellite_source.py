"""RINEX files as a source of a vehicle: what is read, and what is refused with the source's name."""

from __future__ import annotations

import pytest

from gnss_logs import log, navigation, simulated
from pntegrity.errors import InputError
from pntegrity.formats.rinex_write import write_navigation, write_observations
from pntegrity.satellite_source import merged, satellites_of

EPOCHS = 5


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rinex")
    write_observations(folder / "rover.rnx", simulated(EPOCHS).table)
    write_navigation(folder / "brdc.rnx", navigation())
    return {
        "type": "gnss",
        "name": "rover",
        "obs": str(folder / "rover.rnx"),
        "nav": [str(folder / "brdc.rnx")],
    }


def test_codes_and_range_rates_come_as_one_observation_an_epoch(table):
    notes: list[str] = []
    fields, said = satellites_of(table, notes)
    assert fields == {"klobuchar": navigation().klobuchar["G"]}
    assert len(said) == EPOCHS
    assert {o.sensor for o in said} == {"rover"}
    for o, epoch in zip(said, log(EPOCHS), strict=True):
        assert o.keys == merged(epoch, "rover").keys
        assert len(set(o.keys)) == len(o.keys)
        assert all(k.startswith(("rover:R.", "rover:D.")) for k in o.keys)
        assert o.aux["sv_pos_m"].shape == (len(o.keys), 3)
    assert all(note.startswith("source rover: ") for note in notes)


def test_systems_and_one_navigation_file_by_name(table):
    _, said = satellites_of(table | {"systems": "G", "nav": table["nav"][0]}, [])
    assert {k.partition(".")[2][0] for o in said for k in o.keys} == {"G"}


def test_the_name_is_that_of_the_type_where_none_is_given(table):
    _, said = satellites_of({k: v for k, v in table.items() if k != "name"}, [])
    assert said[0].sensor == "gnss"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"obs": None}, ("source rover: no `obs`", 'obs = "')),
        ({"nav": []}, ("source rover: no `nav`", 'nav = ["')),
        ({"nav": [3]}, ("source rover: `nav` must name files", "3")),
        ({"obs": ["a.rnx", "b.rnx"]}, ("source rover: `obs` is one file, not 2",)),
        ({"obs": "nowhere.rnx"}, ("nowhere.rnx", "source rover: ")),
        ({"nav": ["nowhere.nav"]}, ("nowhere.nav", "source rover: ")),
        ({"systems": "XY"}, ("source rover: `systems`", "XY")),
        ({"systems": "C"}, ("rover.rnx", "source rover: ")),
    ],
)
def test_bad_input_names_the_source_and_what_to_do(table, changes, words):
    with pytest.raises(InputError) as refused:
        satellites_of(table | changes, [])
    assert all(word in str(refused.value) for word in words), refused.value
    assert refused.value.hint
