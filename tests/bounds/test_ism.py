"""The integrity support message: what it holds, what it refuses."""

import re
import tomllib
from pathlib import Path

import pytest

from pntegrity.bounds import Ism, events_of
from pntegrity.bounds.ism import FAULTS

PAGE = Path(__file__).parents[2] / "docs" / "formats" / "ism.md"


def tables() -> list[str]:
    return re.findall(r"^```toml\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


def test_the_example_file_is_one() -> None:
    ism = Ism.from_table(tomllib.loads(tables()[0]))
    assert ism.satellite("G05") == 1e-4
    assert ism.constellation("C") == (2e-5, 1e-4)
    assert dict(ism.noise)["iono_walk_m"] == 1e-3


def test_the_four_cases_of_the_paper() -> None:
    groups = ("G05", "C11", "trop", "iono")
    wanted = [set(), {"G05", "C11"}, {"G05", "C11", "trop"}, {"G05", "C11", "trop", "iono"}]
    for text, names in zip(tables()[1:], wanted, strict=True):
        events = events_of(Ism.from_table(tomllib.loads(text)), groups)
        assert {e.name for e in events} == names
        assert {e.probability for e in events} <= {1e-5}


def test_the_page_tells_every_default() -> None:
    page, table = PAGE.read_text(encoding="utf-8"), Ism().to_table()
    told = dict(re.findall(r"^\| `(\w+)` \| ([^|]+?) \|", page, re.MULTILINE))
    for name, value in table.items():
        if name in ("sources", "satellites", "constellations", "noise", "together"):
            continue
        numbers = value if isinstance(value, list) else [value]
        assert [float(v) for v in told[name].split(", ")] == numbers, name


def test_a_table_and_back_is_the_same_message() -> None:
    ism = Ism(
        satellites=(("E11", 0.5), ("G05", 0.0)),
        constellations=(("C", 1e-4, 1e-3),),
        noise=(("code_m", 0.3),),
        hal_m=40.0,
        sectors=8,
        p_sector=1e-4,
        together=(("mast", ("E11", "G05"), 1e-3), ("tram", ("lbl", "G05"), 1e-4)),
    )
    assert Ism.from_table(ism.to_table()) == ism
    assert hash(Ism.from_table(ism.to_table())) == hash(ism)
    assert Ism.from_table({}) == Ism()


def test_a_satellite_fails_with_the_sum_of_its_causes() -> None:
    ism = Ism(p_sat=1e-5, p_dcb=2e-5, p_iono_sat=3e-5, p_user=4e-5, constellations=(("E", 1e-3, 0.0),))
    assert ism.satellite("G05") == pytest.approx(1e-4)
    assert ism.satellite("G05", products=False) == pytest.approx(7e-5)
    assert ism.satellite("E05", products=False) == pytest.approx(1e-3 + 6e-5)


def test_what_is_unmonitored_comes_off_the_exposure_time_once() -> None:
    ism = Ism(p_hmi=1e-7, independent_epochs=50.0)
    assert ism.risk == pytest.approx(2e-9)
    assert ism.risks(4e-8) == pytest.approx((0.3e-9, 0.3e-9, 0.6e-9))
    assert ism.risks(2e-7) == (0.0, 0.0, 0.0)
    assert ism.false_alerts_per_hour == pytest.approx(5e-5)
    assert sum(ism.false_alerts()) == pytest.approx(1e-6)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        *((name, v) for name in FAULTS for v in (-1e-9, 1.5, float("nan"), "1e-5", True)),
        ("p_hmi", 0.0), ("p_hmi", 1.0), ("p_fa", 0.5), ("p_emt", 0.0), ("exposure_s", 0.0),
        ("exposure_s", float("inf")), ("independent_epochs", 0.5), ("unmonitored_share", 1.1),
        ("max_modes", 0), ("max_modes", 1.5), ("b_code_m", -0.1), ("hal_m", 0.0), ("val_m", float("nan")),
        ("hal_m", "far"),
        ("split", (0.5, 0.5, 0.5)), ("split", (0.5, 0.5)), ("fa_split", (1.5, -0.5, 0.0)), ("fa_split", 0.5),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_by_name(field: str, value: object) -> None:
    with pytest.raises(ValueError, match=f"`{field}`? must be .*not {re.escape(repr(value))}|{field}.*must"):
        Ism(**{field: value})


@pytest.mark.parametrize(
    ("table", "names"),
    [
        ({"p_satellite": 1e-5}, "p_satellite"),
        ({"satellites": {"G5": 1e-5}}, "G5"),
        ({"satellites": {"G05": 2.0}}, "satellites.G05"),
        ({"satellites": 1.0}, "satellites"),
        ({"constellations": {"GPS": {"p_sat": 0.0, "p_constellation": 0.0}}}, "GPS"),
        ({"constellations": {"G": {"p_sat": 0.0}}}, "constellations.G"),
        ({"constellations": {"G": {"p_sat": "x", "p_constellation": 0.0}}}, "constellations.G.p_sat"),
        ({"constellations": {"G": {"p_sat": 0.0, "p_constellation": -1.0}}}, "G.p_constellation"),
        ({"constellations": {"G": {"p_sat": 0.9, "p_constellation": 0.0}}, "p_user": 0.2}, "other causes"),
        ({"noise": {"code_m": "much"}}, "noise.code_m"),
        ({"p_sat": 0.6, "p_user": 0.6}, "p_sat + p_dcb"),
        ({"sectors": 4, "sector_width_deg": 80.0, "p_sector": 1e-4}, "at least 90 where there are 4 sectors"),
        ({"sectors": 4}, "p_sector"),
        ({"sectors": 4.0, "p_sector": 1e-4}, "sectors"),
        ({"sectors": 361, "p_sector": 1e-4}, "at most 360"),
        ({"together": {"name": "tram"}}, "together"),
        ({"together": [{"name": "tram", "groups": ["G05"]}]}, "probability"),
        ({"together": [{"name": "tram", "groups": "G05", "probability": 0.0}]}, "together"),
        ({"together": [{"name": "tram", "groups": [], "probability": 0.0}]}, "together.tram.groups"),
        ({"together": [{"name": "tram", "groups": ["G05:C1C"], "probability": 0.0}]}, "together.tram.groups"),
        ({"together": [{"name": "tram", "groups": ["G05"], "probability": 2.0}]}, "tram.probability"),
        ({"together": [{"name": "az045", "groups": ["G05"], "probability": 0.1}]}, "az045"),
        ({"together": [{"name": "G05", "groups": ["G05"], "probability": 0.1}]}, "names of its own"),
        ({"together": 2 * [{"name": "tram", "groups": ["G05"], "probability": 0.1}]}, "different names"),
    ],
)  # fmt: skip
def test_a_wrong_table_is_refused_by_name(table: dict[str, object], names: str) -> None:
    with pytest.raises(ValueError, match=re.escape(names)):
        Ism.from_table(table)
