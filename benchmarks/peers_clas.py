"""PPP-RTK of cssrlib with CLAS on the real log that ours is measured on: clean, and with a ramp.

``python -m benchmarks.peers_clas --data FOLDER [--ramp G17 ...] [--out FILE.npz] [--json]``. It needs
``pip install 'pntegrity[clas]'``. The settings are cssrlib's own, for an antenna that is not calibrated: one
L6 message an epoch, GPS L1/L2, Galileo E1/E5a, QZSS L1/L2, its ambiguity resolution on.
"""

from __future__ import annotations

import argparse
import gzip
import io
import json
import sys
import tempfile
import time
from contextlib import redirect_stdout
from copy import deepcopy
from dataclasses import dataclass
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.timing import markdown
from benchmarks.workload import DEFAULT_DATA
from pntegrity.physics.frames import enu_rotation
from pntegrity.records import FloatArray

__all__ = ["Ramp", "Track", "main", "solve"]

FOLDER = "clas-sept-2021078"
TRUTH_M = np.array([-3962108.673, 3381309.574, 3668678.638])
START, WEEK, FRAME, SUBFRAME = (2021, 3, 19, 12, 0, 0), 2149, 250, 5
SIGNALS = {"G": ("1C", "2W"), "E": ("1C", "5Q"), "J": ("1C", "2L")}
FIXED, CONVERGED_S = 4, 60
HEAD = (
    "run", "epochs solved", "fixed", "first fix, s", "H/V RMS after 60 s, m", "largest H/V after 60 s, m",
    "vertical past 0.5 m", "fixed then", "wall ms an epoch",
)  # fmt: skip


@dataclass(frozen=True)
class Ramp:
    """An error that grows on code and carrier of all bands of one satellite."""

    sat: str
    start_s: float = 300.0
    rate_mps: float = 0.02

    def at(self, t_s: float) -> float:
        """Return the error at a time, m."""
        return self.rate_mps * max(t_s - self.start_s, 0.0)


@dataclass(frozen=True, eq=False)
class Track:
    """Errors east, north, up (m, nan where not solved) and cssrlib's mode (4: fixed) at each epoch, 1 Hz."""

    enu_m: FloatArray
    mode: np.ndarray
    wall_s: float


def solve(folder: Path, ramp: Ramp | None = None) -> Track:
    """Run cssrlib over the log of a folder with decompressed files."""
    with redirect_stdout(io.StringIO()):  # it reports to the terminal
        return _solve(folder, ramp)


def _solve(folder: Path, ramp: Ramp | None) -> Track:
    from cssrlib.cssrlib import cssr
    from cssrlib.gnss import Nav, ecef2pos, rSigRnx, time2gpst
    from cssrlib.ppprtk import ppprtkpos
    from cssrlib.rinex import rnxdec

    corrections, observations, nav = cssr(), rnxdec(), Nav()
    corrections.week = WEEK
    corrections.read_griddef(str(folder / "clas_grid.def"))
    observations.setSignals(
        [rSigRnx(s + kind + name) for s, pair in SIGNALS.items() for name in pair for kind in "CLS"]
    )
    nav = observations.decode_nav(str(folder / "SEPT078M.21P"), nav)
    observations.decode_obsh(str(folder / "SEPT078M.21O"))
    observations.autoSubstituteSignals()
    filter_ = ppprtkpos(nav, observations.pos, str(folder / "cssrlib.log"))
    nav.elmin = np.deg2rad(10.0)
    corrections.find_grid_index(ecef2pos(observations.pos))
    messages = (folder / "2021078M.l6").read_bytes()
    turn, enu, mode = enu_rotation(TRUTH_M), [], []
    began = time.perf_counter()
    for epoch in range(len(messages) // FRAME):
        seen = observations.decode_obs()
        if seen.t.time == 0:
            break
        corrections.decode_l6msg(messages[FRAME * epoch : FRAME * (epoch + 1)], 0)
        if corrections.fcnt == SUBFRAME:
            corrections.week = time2gpst(seen.t)[0]
            corrections.decode_cssr(corrections.buff, 0)
        if epoch == 0:
            nav.t = nav.time_p = deepcopy(seen.t)
        if ramp is not None:
            _bend(seen, ramp, ramp.at(epoch))
        ready = corrections.chk_stat()
        if ready:
            filter_.process(seen, cs=corrections)
        found = nav.xa[:3] if nav.smode == FIXED else nav.x[:3]
        enu.append(turn @ (found - TRUTH_M) if ready else np.full(3, np.nan))
        mode.append(nav.smode if ready else 0)
    return Track(np.array(enu), np.array(mode), time.perf_counter() - began)


def _bend(seen: Any, ramp: Ramp, error_m: float) -> None:
    """Add the error to an epoch's code (m) and carrier (cycles)."""
    from cssrlib.gnss import id2sat, sat2prn, uTYP

    number = id2sat(ramp.sat)
    for i in np.flatnonzero(seen.sat == number):
        waves = [s.wavelength() for s in seen.sig[sat2prn(number)[0]][uTYP.L]]
        for band, wave in enumerate(waves):
            seen.P[i, band] += error_m if seen.P[i, band] else 0.0
            seen.L[i, band] += error_m / wave if seen.L[i, band] else 0.0


def unpacked(data: Path, scratch: Path) -> Path:
    """Copy the log's files, decompressed, to a folder; QZSS messages of the whole day go with the others."""
    source = data / FOLDER
    for name in ("2021078M.l6", "SEPT078M.21O", "SEPT078M.21P"):
        (scratch / name).write_bytes(gzip.decompress((source / f"{name}.gz").read_bytes()))
    (scratch / "clas_grid.def").write_bytes((source / "clas_grid.def").read_bytes())
    return scratch


def figures(track: Track) -> dict[str, Any]:
    """Return what the table shows of a run."""
    h, v = np.hypot(track.enu_m[:, 0], track.enu_m[:, 1]), track.enu_m[:, 2]
    late, fixed = np.isfinite(h), track.mode == FIXED
    late[:CONVERGED_S] = False
    past = np.flatnonzero(late & (np.abs(v) > 0.5))
    return {
        "epochs": len(h),
        "solved": int(np.isfinite(h).sum()),
        "fixed": int(fixed.sum()),
        "first_fix_s": int(np.argmax(fixed)) if fixed.any() else None,
        "rms_hv_m": [float(np.sqrt(np.mean(x[late] ** 2))) for x in (h, v)],
        "mean_enu_m": np.mean(track.enu_m[late], axis=0).tolist(),
        "largest_hv_m": [float(np.abs(x[late]).max()) for x in (h, v)],
        "past_half_metre": len(past),
        "past_half_metre_fixed": int(fixed[past].sum()),
        "wall_ms": track.wall_s / len(h) * 1e3,
    }


def table(found: dict[str, dict[str, Any]]) -> str:
    """Return the figures as a table."""
    rows = [
        (
            name, f"{f['solved']} of {f['epochs']}", str(f["fixed"]), str(f["first_fix_s"]),
            "/".join(f"{x:.3f}" for x in f["rms_hv_m"]), "/".join(f"{x:.2f}" for x in f["largest_hv_m"]),
            str(f["past_half_metre"]), str(f["past_half_metre_fixed"]), f"{f['wall_ms']:.1f}",
        )
        for name, f in found.items()
    ]  # fmt: skip
    return (
        f"cssrlib {version('cssrlib')}, static receiver with CLAS, 1 Hz, {START[3]}:00 GPS time.\n\n"
        + markdown(HEAD, rows)
    )


def main() -> None:
    """Run the log clean, and with a ramp on each satellite asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=DEFAULT_DATA, help="folder of the real logs")
    parser.add_argument("--ramp", nargs="*", default=["G17"], help="satellites that get 2 cm/s after 300 s")
    parser.add_argument("--out", type=Path, help="write errors and modes of each run to this .npz file")
    parser.add_argument("--json", action="store_true", help="print figures as JSON")
    options = parser.parse_args()
    if find_spec("cssrlib") is None:
        sys.exit("nothing to measure: cssrlib is not installed")
    if not (options.data / FOLDER).is_dir():
        sys.exit(f"nothing to measure: {FOLDER} is not in the data folder")
    with tempfile.TemporaryDirectory(prefix="pntegrity-bench-") as scratch:
        folder = unpacked(options.data, Path(scratch))
        ramps = [None, *(Ramp(sat) for sat in options.ramp)]
        tracks = {f"2 cm/s on {r.sat}" if r else "clean": solve(folder, r) for r in ramps}
    if options.out is not None:
        arrays = {
            n.replace(" ", "_").replace("/", "p"): np.column_stack([t.enu_m, t.mode])
            for n, t in tracks.items()
        }
        np.savez_compressed(options.out, **arrays)  # type: ignore[arg-type]
    found = {name: figures(track) for name, track in tracks.items()}
    print(json.dumps(found, indent=2) if options.json else table(found))


if __name__ == "__main__":
    main()
