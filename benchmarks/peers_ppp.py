"""Kinematic PPP of RTKLIB on the real files that ours is measured on.

``python -m benchmarks.peers_ppp --data FOLDER --card FOLDER_OR_WHEEL [--json]``. The road drive ships in a
wheel: ``pip download gnss-benchmark==2.3.0 --no-deps``. Each run is forward only, from the first epoch on.
"""

from __future__ import annotations

import argparse
import gzip
import json
import sys
import tempfile
import zipfile
from collections.abc import Iterator
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.timing import markdown
from benchmarks.tools.rtklib_ppp import SETTINGS, Job, Track, solve
from benchmarks.workload import DEFAULT_DATA
from pntegrity.formats.truth import Truth, read_truth
from pntegrity.physics.frames import enu_rotation
from pntegrity.records import FloatArray

__all__ = ["main"]

Figures = dict[str, Any]
#: What is left out of the figures of the static receivers.
CONVERGED_S = 3600
CARD_FOLDER = "gnss_benchmark/datasets/mosaicx5_multi_dynamic"
CARD_TRUTH = "card-mare-2020334/card_ppk_rtklib_combined.pos.gz"
ESBC_OFFSET_ENU_M = np.array([0.524, 0.527, 0.266])
OPEC_ECEF_M = np.array([3149785.49, 598261.34, 5495348.98])
NAMES = {"G": "GPS", "R": "GLO", "E": "GAL", "C": "BDS"}
STATIC_HEAD = (
    "static, after the first hour", "epochs solved", "longest gap, s", "satellites", "std E/N/U, cm",
    "mean offset E/N/U, cm", "wall ms an epoch",
)  # fmt: skip
ROAD_HEAD = (
    "road drive, to the PPK (good to 1.5-3 m)", "epochs solved", "longest gap, s", "satellites",
    "3-D median/RMS/max, m", "horizontal median/RMS/max, m", "wall ms an epoch",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Case:
    """Files of a log, what the truth is, and what to run."""

    name: str
    job: Job
    systems: tuple[str, ...]
    ecef_m: FloatArray | None = None
    truth: Truth | None = None

    def jobs(self) -> Iterator[tuple[str, Job]]:
        """Yield the runs; Galileo also with the signals that RTKLIB takes by itself."""
        for systems in self.systems:
            name = f"{self.name} " + "+".join(NAMES[s] for s in systems)
            job = replace(self.job, systems=systems)
            yield name, job
            if systems[-1] == "E":
                yield f"{name}, E1/E5b as RTKLIB has it", replace(job, as_is=True)


def esbc(data: Path, scratch: Path) -> Case:
    """Return the static receiver with GRG orbits every 15 min and clocks every 30 s."""
    folder = data / "esbc-static-2020177"
    job = _job(folder, data, scratch / "esbc", obs="*_MO.rnx.gz", nav="*_MN.rnx.gz", clocks="*_CLK.CLK.gz")
    lines = job.obs.read_text("latin-1").split("\n")
    start = np.array(next(line for line in lines if "APPROX POSITION XYZ" in line)[:42].split(), dtype=float)
    truth = start + enu_rotation(start).T @ ESBC_OFFSET_ENU_M
    return Case("ESBC", job, ("G", "GR", "GRE"), ecef_m=truth)


def opec(data: Path, scratch: Path) -> Case:
    """Return the static receiver with CODE orbits and clocks every 5 min."""
    folder = data / "opec-static-2022001"
    job = _job(folder, data, scratch / "opec", obs="*_MO.rnx.gz", nav="*_[GRCE]N.rnx.gz")
    return Case("OPEC", job, ("G", "GR", "GC", "GE", "GREC"), ecef_m=OPEC_ECEF_M)


def card(data: Path, scratch: Path, source: Path) -> Case:
    """Return the road drive with CODE orbits and clocks every 15 min, none of them of BDS."""
    if not (data / CARD_TRUTH).is_file():
        raise FileNotFoundError(f"{CARD_TRUTH} is not in the data folder")
    if source.suffix == ".whl":
        with zipfile.ZipFile(source) as wheel:
            wheel.extractall(scratch, [n for n in wheel.namelist() if n.startswith(f"{CARD_FOLDER}/C")])
        source = scratch / CARD_FOLDER
    files = {"obs": "CARD*_MO.rnx", "nav": "CARD*_MN.rnx", "orbits": "COD*.sp3"}
    job = _job(source, data, scratch / "card", **files)
    return Case("CARD", job, ("G", "GR", "GRE"), truth=read_truth(data / CARD_TRUTH))


def _job(
    folder: Path, data: Path, scratch: Path, obs: str, nav: str, orbits: str = "*SP3.gz", clocks: str = ""
) -> Job:
    """Copy the files, decompressed, to a folder of their own."""
    scratch.mkdir()

    def copied(where: Path, pattern: str) -> tuple[Path, ...]:
        out = []
        for source in sorted(where.glob(pattern)):
            raw = source.read_bytes()
            out.append(scratch / source.name.removesuffix(".gz"))
            out[-1].write_bytes(gzip.decompress(raw) if source.suffix == ".gz" else raw)
        if not out:
            raise FileNotFoundError(f"{where.name}/{pattern} is not in the data folder")
        return tuple(out)

    antennas = copied(data / "antex", "igs14_sats_only.atx.gz")[0]
    clock_files = copied(folder, clocks) if clocks else ()
    return Job(copied(folder, obs)[0], copied(folder, nav), copied(folder, orbits), clock_files, antennas, "")


def measure(case: Case) -> dict[str, Figures]:
    """Return the figures of each run of a case, or why there are none."""
    found: dict[str, Figures] = {}
    for name, job in case.jobs():
        try:
            track = solve(job)
        except (BrokenProcessPool, RuntimeError) as error:
            found[name] = {"failed": str(error)}
            continue
        figures = _common(track)
        if track.t_ns.size:
            figures |= _static(track, case.ecef_m) if case.ecef_m is not None else _road(track, case.truth)
        found[name] = figures
    return found


def _common(track: Track) -> Figures:
    gaps = np.diff(track.t_ns) * 1e-9
    return {
        "epochs": track.epochs,
        "solved": int(track.t_ns.size),
        "longest_gap_s": float(gaps.max()) if gaps.size else float("inf"),
        "mean_satellites": float(track.satellites.mean()) if track.satellites.size else 0.0,
        "wall_ms": track.wall_s / track.epochs * 1e3,
        "cpu_ms": track.cpu_s / track.epochs * 1e3,
        "version": track.version,
    }


def _static(track: Track, truth_m: FloatArray) -> Figures:
    late = track.t_ns >= track.t_ns[0] + CONVERGED_S * 10**9
    if not late.any():
        return {"failed": "no solution after the first hour"}
    enu = (track.position_m[late] - truth_m) @ enu_rotation(truth_m).T
    return {"std_enu_m": enu.std(axis=0).tolist(), "mean_enu_m": enu.mean(axis=0).tolist()}


def _road(track: Track, truth: Truth | None) -> Figures:
    assert truth is not None
    position, valid = truth.at(track.t_ns)
    rows = zip(track.position_m[valid], position[valid], strict=True)
    enu = np.array([enu_rotation(there) @ (here - there) for here, there in rows]).reshape(-1, 3)
    spread = {"compared": len(enu), "mean_enu_m": enu.mean(axis=0).tolist()}
    for name, columns in (("3d", 3), ("horizontal", 2)):
        size = np.linalg.norm(enu[:, :columns], axis=1)
        spread[f"{name}_m"] = [float(np.median(size)), float(np.sqrt(np.mean(size**2))), float(size.max())]
    return spread


# --- the tables -------------------------------------------------------------------------------------


def tables(found: dict[str, Figures]) -> str:
    """Return a table of the static receivers and one of the road drive."""
    versions = {f["version"] for f in found.values() if "version" in f}
    parts = [f"RTKLIB 2.4.3 b34 ({', '.join(versions)}): {SETTINGS}.\n"]
    for head, key in ((STATIC_HEAD, "std_enu_m"), (ROAD_HEAD, "3d_m")):
        rows = [_row(n, f, key) for n, f in found.items() if key in f]
        parts += [markdown(head, rows)] if rows else []
    parts += [
        f"{n}: no figures ({f.get('failed', 'no solution')})"
        for n, f in found.items()
        if "mean_enu_m" not in f
    ]
    return "\n".join(parts)


def _row(name: str, f: Figures, key: str) -> tuple[str, ...]:
    first, second = (f[key], f["mean_enu_m"]) if key == "std_enu_m" else (f[key], f["horizontal_m"])
    scale, form = (100.0, ".1f") if key == "std_enu_m" else (1.0, ".2f")
    return (
        name, f"{f['solved']} of {f['epochs']}", f"{f['longest_gap_s']:.0f}", f"{f['mean_satellites']:.1f}",
        "/".join(f"{scale * v:{form}}" for v in first), "/".join(f"{scale * v:{form}}" for v in second),
        f"{f['wall_ms']:.2f}",
    )  # fmt: skip


def main() -> None:
    """Run the cases whose files are there."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=DEFAULT_DATA, help="folder of the real logs")
    parser.add_argument("--card", type=Path, help="the wheel of gnss-benchmark 2.3.0, or the drive's folder")
    parser.add_argument("--json", action="store_true", help="print figures as JSON")
    options = parser.parse_args()
    if find_spec("pyrtklib") is None:
        sys.exit("nothing to measure: pyrtklib is not installed")
    found: dict[str, Figures] = {}
    with tempfile.TemporaryDirectory(prefix="pntegrity-bench-") as folder:
        for make in (esbc, opec, card):
            extra = (options.card,) if make is card else ()
            if extra == (None,):
                print("CARD is not run: give --card", file=sys.stderr)
                continue
            try:
                found |= measure(make(options.data, Path(folder), *extra))
            except FileNotFoundError as error:
                print(f"{make.__name__.upper()} is not run: {error}", file=sys.stderr)
    if not found:
        sys.exit("nothing to measure")
    print(json.dumps({"settings": SETTINGS, "figures": found}, indent=2) if options.json else tables(found))


if __name__ == "__main__":
    main()
