"""The source of docs/add-a-source.md: put where types are looked for, it runs in a vehicle like any other."""

from __future__ import annotations

import importlib
import re
import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import pntegrity.sensors
from pntegrity.cli.simulate_vessel import command
from pntegrity.config import make_config
from pntegrity.discovery import classes_with
from pntegrity.kernels.rotations import rotation
from pntegrity.records import Observation
from pntegrity.run import run
from pntegrity.sensors.source import Pose, Source, Track
from pntegrity.vehicle import sources_of, types

PAGE = Path(__file__).parents[2] / "docs" / "add-a-source.md"
FAULT = "laser bias 8 m 40:60"
PLACE = np.array([-2869014.0, 4591371.0, 3360443.0])


def block(language, start):
    """Return the block of a language on the page that begins in some way."""
    found = re.findall(rf"^```{language}\n(.*?)^```", PAGE.read_text("utf-8"), re.MULTILINE | re.DOTALL)
    (text,) = (b for b in found if b.startswith(start))
    return text


@pytest.fixture
def laser(tmp_path, monkeypatch):
    """Put the module of the page into a folder of the package that types are looked for in."""
    (tmp_path / "types").mkdir()
    (tmp_path / "types" / "laser.py").write_text(block("python", '"""A laser'), encoding="utf-8")
    monkeypatch.setattr(pntegrity.sensors, "__path__", [*pntegrity.sensors.__path__, str(tmp_path / "types")])
    importlib.invalidate_caches()
    classes_with.cache_clear()
    yield types()["laser"]
    classes_with.cache_clear()
    sys.modules.pop("pntegrity.sensors.laser", None)
    vars(pntegrity.sensors).pop("laser", None)


def table():
    return tomllib.loads(block("toml", "[[source]]"))["source"][0]


def test_its_type_is_found_and_made_from_its_table(laser):
    (made,) = sources_of([table()])
    assert isinstance(made, laser)
    assert isinstance(made, Source)
    assert (made.sigma_m, made.zero_sigma_m) == (0.2, 0.5)
    assert made.nuisances()[0].name == "laser.zero"
    for change, word in (({"sigma_m": 0.0}, "sigma_m"), ({"reflector_m": [1.0, 2.0, 3.0]}, "reflector_m")):
        with pytest.raises(ValueError, match=f"source laser: `{word}`"):
            sources_of([table() | change])


def test_without_its_file_there_is_no_such_type():
    assert "laser" not in types()
    with pytest.raises(ValueError, match="laser"):
        sources_of([table()])


def test_its_jacobian_is_that_of_its_rows(laser):
    made = laser(
        reflector_m=tuple(PLACE + np.array([300.0, -200.0, 40.0])),
        lever_arm_m=(4.0, -2.0, 1.0),
        zero_sigma_m=1.0,
    )
    said = Observation("laser", 0, ("laser:R.range",), np.array([350.0]))
    C = rotation([0.3, -0.2, 1.1])
    track = Track(np.array([0]), PLACE[None], C[None])
    pose = Pose(0, PLACE, np.zeros(3), C, np.zeros(3), track, {"laser.zero": 0.2})
    rows = made.rows(said, pose)
    for i, step in enumerate(1e-3 * np.eye(3)):
        moved = made.rows(said, replace(pose, position_m=PLACE + step)).nu - rows.nu
        turned = made.rows(said, replace(pose, C=rotation(step) @ C)).nu - rows.nu
        np.testing.assert_allclose(moved, -1e-3 * rows.H["pos"][:, i], atol=1e-8)
        np.testing.assert_allclose(turned, -1e-3 * rows.H["att"][:, i], atol=1e-5)
    off = made.rows(said, replace(pose, nuisance={"laser.zero": 0.7})).nu - rows.nu
    np.testing.assert_allclose(off, -0.5 * rows.H["laser.zero"][:, 0], atol=1e-8)
    lost = made.rows(replace(said, y=np.array([np.nan])), pose)
    assert lost.keys == ()
    assert "no number" in lost.reason


def test_its_fault_is_found_in_a_vehicle_and_it_comes_back(laser, tmp_path, monkeypatch):
    # GIVEN the vessel of the page with the laser on board
    monkeypatch.chdir(tmp_path)
    command.main(["--out", "ship", "--seconds", "90", "--seed", "2"], standalone_mode=False)
    exec(compile(block("python", "# laser.py"), "laser.py", "exec"), {})
    text = Path("ship/vehicle.toml").read_text("utf-8") + "\n" + block("toml", "[[source]]")
    told = tomllib.loads(text)
    # WHEN it runs as it is, THEN nobody is left out, and the state of the zero error is found
    clean = run(make_config(told)).outcomes
    assert not [e for o in clean for e in o.exclusions]
    zero, _ = clean[-1].update.posterior.block("laser.zero")
    assert abs(float(zero[0]) - 0.3) < 0.15
    # WHEN the distances are wrong for a time
    outcomes = run(make_config(told | {"faults": (FAULT,)})).outcomes
    left_out = [(o.t_ns, e.group) for o in outcomes for e in o.exclusions]
    back = [(o.t_ns, name) for o in outcomes for name in o.readmitted]
    first = outcomes[0].t_ns
    # THEN it is named and left out at once, and comes back after the end
    assert [name for _, name in left_out] == ["laser"]
    assert 40.0 <= (left_out[0][0] - first) * 1e-9 <= 42.0
    assert [name for _, name in back] == ["laser"]
    assert 60.0 <= (back[0][0] - first) * 1e-9 <= 75.0
    during = [o for o in outcomes if 42.0 < (o.t_ns - first) * 1e-9 < 60.0]
    assert all("laser" not in {k.partition(":")[0] for k in o.update.keys} for o in during)
    assert {o.status for o in outcomes} == {"ok"}
