"""A small log in the layout of GARPOS: a boat on a slow curve above three transponders."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pntegrity.formats._acoustics import arms_of
from pntegrity.physics.acoustics import SoundSpeed, path_between
from pntegrity.physics.frames import enu_rotation, geodetic_to_ecef

LAT_DEG, LON_DEG, HEIGHT_M = 34.96, 139.26, 40.0
ORIGIN = geodetic_to_ecef(np.radians(LAT_DEG), np.radians(LON_DEG), HEIGHT_M)
TO_ENU = enu_rotation(ORIGIN)
BEACONS = {"M1": (0.0, 400.0, -900.0), "M2": (400.0, -200.0, -900.0), "M3": (-400.0, -200.0, -900.0)}
ARM = (1.0, 0.5, 4.0)
SOUND = SoundSpeed((0.0, 1000.0), (1500.0, 1490.0))
MIDNIGHT_S = 30000.0


def pose(s: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the antenna, ECEF, and roll, pitch, heading at a time."""
    east, north = 1.5 * s, 30.0 * np.sin(s / 60.0)
    heading = np.arctan2(1.5, 0.5 * np.cos(s / 60.0))
    antenna = ORIGIN + TO_ENU.T @ np.array([east - 200.0, north, 10.0])
    return antenna, np.array([0.02 * np.sin(s / 5.0), 0.01 * np.cos(s / 7.0), heading])


def _transducer(s: float) -> np.ndarray:
    antenna, angles = pose(s)
    return antenna + arms_of(antenna[None], angles[None], np.array(ARM))[0]


def _arrival(s: float, beacon: np.ndarray) -> float:
    """Return when the reply to a ping at `s` comes."""
    down = path_between(SOUND, _transducer(s), beacon, HEIGHT_M).time_s
    received = s + 2.0 * down
    for _ in range(4):
        received = s + down + path_between(SOUND, _transducer(received), beacon, HEIGHT_M).time_s
    return received


def write_log(folder: Path, seconds: float = 240.0, profile_m: float = 1000.0, seed: int = 3) -> Path:
    """Write the log: a shot each 2 s, one transponder after the other."""
    rng = np.random.default_rng(seed)
    folder.mkdir()
    pose_of = ("ant_e", "ant_n", "ant_u", "head", "pitch", "roll")
    lines = [",".join(["MT", "TT", "ST", "RT", *(n + k for k in "01" for n in pose_of)])]
    for i, s in enumerate(np.arange(0.0, seconds, 2.0).tolist()):
        name = list(BEACONS)[i % 3]
        received = _arrival(s, ORIGIN + TO_ENU.T @ np.array(BEACONS[name]))
        cells = [name, f"{received - s + 1e-5 * rng.normal():.6f}"]
        cells += [f"{MIDNIGHT_S + t:.6f}" for t in (s, received)]
        for t in (s, received):
            antenna, (roll, pitch, heading) = pose(t)
            enu = TO_ENU @ (antenna - ORIGIN) + 0.01 * rng.normal(size=3)
            cells += [f"{v:.5f}" for v in enu] + [f"{np.degrees(a):.4f}" for a in (heading, pitch, roll)]
        lines.append(",".join(cells))
    (folder / "boat-obs.csv").write_text("\n".join(lines) + "\n")
    depths = np.linspace(0.0, profile_m, 11)
    speeds = SOUND.at(depths)
    (folder / "boat-svp.csv").write_text(
        "depth,speed\n" + "".join(f"{z:.1f},{c:.3f}\n" for z, c in zip(depths, speeds, strict=True))
    )
    places = "".join(f"{n}_dPos = {e} {no} {u}\n" for n, (e, no, u) in BEACONS.items())
    (folder / "boat-initcfg.ini").write_text(
        "[Obs-parameter]\nDate(UTC) = 2024-06-01\n[Site-parameter]\n"
        f"Latitude0 = {LAT_DEG}\nLongitude0 = {LON_DEG}\nHeight0 = {HEIGHT_M}\n"
        f"Stations = {' '.join(BEACONS)}\n"
        f"[Model-parameter]\n{places}ATDoffset = {ARM[0]} {ARM[1]} {ARM[2]}\n"
    )
    return folder
