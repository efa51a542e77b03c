"""The embedded demo scenario: a small simulated log with known faults, and how it was made.

The files lie in ``scenarios/data``; `build_demo` makes the same ones again from ``demo.toml``.
"""

from __future__ import annotations

import gzip
import io
import tempfile
import tomllib
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import numpy as np

from pntegrity.formats.rinex_nav import read_navigation
from pntegrity.formats.rinex_write import write_navigation, write_observations
from pntegrity.physics.frames import geodetic_to_ecef
from pntegrity.physics.time import SECOND_NS, from_iso
from pntegrity.sensors.noise import NoiseModel
from pntegrity.simulate.constellation import nominal_navigation
from pntegrity.simulate.faults import Fault, parse_fault
from pntegrity.simulate.receiver import Receiver, Simulated, keep_only, simulate, with_faults
from pntegrity.simulate.trajectory import car

__all__ = ["DemoPaths", "build_demo", "demo_facts", "demo_paths"]

OBS, NAV, TRUTH = "demo.rnx.gz", "demo_nav.rnx.gz", "demo_truth.csv.gz"


@dataclass(frozen=True)
class DemoPaths:
    """Where the demo's files are, and what is wrong in them.

    Parameters
    ----------
    obs, nav, truth : Path
        RINEX observations and ephemerides, reference trajectory; gzip.
    faults : tuple of Fault
    """

    obs: Path
    nav: Path
    truth: Path
    faults: tuple[Fault, ...]


class _Opened(AbstractContextManager[DemoPaths]):
    """The demo's files on disk, also where the package is not (a zip file)."""

    def __enter__(self) -> DemoPaths:
        self._stack = ExitStack()
        folder = files("pntegrity.scenarios").joinpath("data")
        paths = [self._stack.enter_context(as_file(folder.joinpath(name))) for name in (OBS, NAV, TRUTH)]
        return DemoPaths(paths[0], paths[1], paths[2], demo_faults(demo_facts()))

    def __exit__(self, *_: object) -> None:
        self._stack.close()


def demo_paths() -> AbstractContextManager[DemoPaths]:
    """Return a context in which the demo's files are there: ``with demo_paths() as demo: read(demo.obs)``."""
    return _Opened()


def demo_facts() -> dict[str, Any]:
    """Return what ``demo.toml`` says."""
    return tomllib.loads(files("pntegrity.scenarios").joinpath("demo.toml").read_text(encoding="utf-8"))


def demo_faults(facts: dict[str, Any]) -> tuple[Fault, ...]:
    """Return the demo's faults."""
    return tuple(parse_fault(text) for text in facts["faults"])


def build_demo(out_dir: Path | str, rng: np.random.Generator | None = None) -> tuple[Path, Path, Path]:
    """Make the demo's files: observations, ephemerides, truth. The same generator gives the same bytes.

    Parameters
    ----------
    out_dir : Path or str
        A folder, made where it is missing.
    rng : numpy.random.Generator, optional
        That of the seed in ``demo.toml`` where not given: the files that ship with the package.
    """
    facts, out = demo_facts(), Path(out_dir)
    out.mkdir(parents=True, exist_ok=True)
    start = from_iso(facts["start"])
    t_ns = start + SECOND_NS * np.arange(facts["epochs"], dtype=np.int64)
    with tempfile.TemporaryDirectory() as folder:
        plain = Path(folder) / "nav.rnx"
        comment = "simulated by pntegrity: nominal constellations"
        write_navigation(plain, nominal_navigation(start, int(t_ns[-1]), facts["systems"]), comment=comment)
        _pack(plain.read_bytes(), out / NAV)
        simulated = _observed(facts, plain, t_ns, rng or np.random.default_rng(facts["seed"]))
        table = keep_only(with_faults(simulated.table, demo_faults(facts)), _sky(facts["outage"]))
        plain = Path(folder) / "obs.rnx"
        write_observations(plain, table, comment="simulated by pntegrity, with faults: see demo.toml")
        _pack(plain.read_bytes(), out / OBS)
    _pack(_truth_csv(t_ns, simulated), out / TRUTH)
    return out / OBS, out / NAV, out / TRUTH


def _observed(
    facts: dict[str, Any], nav: Path, t_ns: np.ndarray[Any, Any], rng: np.random.Generator
) -> Simulated:
    """Simulate on what the reader makes of the navigation file."""
    latitude, longitude = np.deg2rad(facts["latitude_deg"]), np.deg2rad(facts["longitude_deg"])
    place = geodetic_to_ecef(latitude, longitude, facts["height_m"])
    drive = car(place, heading_rad=np.deg2rad(facts["heading_deg"]))
    receiver = Receiver(NoiseModel(**facts["noise"]), mask_rad=float(np.deg2rad(10.0)))
    return simulate(read_navigation(nav), drive, t_ns, receiver, rng)


def _sky(outage: dict[str, Any]) -> Any:
    def wanted(since_s: float, sat: str) -> bool:
        return not outage["start_s"] <= since_s < outage["end_s"] or sat in outage["satellites"]

    return wanted


def _truth_csv(t_ns: np.ndarray[Any, Any], simulated: Simulated) -> bytes:
    lines = ["t_ns,x_m,y_m,z_m,vx_mps,vy_mps,vz_mps"]
    for t, p, v in zip(t_ns.tolist(), simulated.position_m, simulated.velocity_mps, strict=True):
        lines.append(f"{t}," + ",".join([f"{x:.4f}" for x in p] + [f"{x:.4f}" for x in v]))
    return ("\n".join(lines) + "\n").encode("ascii")


def _pack(content: bytes, path: Path) -> None:
    """Write gzip without name and time, so that the bytes depend on the content alone."""
    buffer = io.BytesIO()
    with gzip.GzipFile(filename="", mode="wb", compresslevel=9, fileobj=buffer, mtime=0) as packed:
        packed.write(content)
    path.write_bytes(buffer.getvalue())
