"""Campaign on real inertial logs: a walk with raw GNSS, a car with RTK fixes and faults in them, two car
drives with the fixes of a receiver's own fusion.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from pntegrity.formats.rinex_nav import read_navigation
from pntegrity.formats.rinex_obs import read_observations
from pntegrity.formats.truth import read_truth
from pntegrity.physics.frames import enu_rotation
from pntegrity.physics.gnss_epochs import gnss_epochs
from pntegrity.records import FloatArray
from pntegrity.scenarios._ins_drive import NAME, alarms_in, drive_rows
from pntegrity.scenarios._ins_logs import (
    DRIVE,
    FUSION,
    FUSION_FOLDER,
    WALK_FOLDER,
    Branches,
    ellipsoidal_m,
    fusion_log,
    tracked,
    walk_log,
    write_spec,
)
from pntegrity.scenarios._real_logs import WALK, Row, Site, rms, row, skipped
from pntegrity.sensors.snapshot import snapshot

__all__ = ["ins_real"]


def ins_real(data: Path) -> list[Row]:
    """Return the figures of the real inertial logs."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        spec = str(write_spec(Path(folder)))
        for name, make in ((WALK_FOLDER, _walk), (DRIVE, drive_rows), (FUSION_FOLDER, _fusion)):
            there = (data / name).is_dir()
            rows += make(data, spec) if there else skipped(NAME, f"{name} is not here")
    return rows


# ---- the walk: everything real ------------------------------------------------------------------------


def _walk(data: Path, spec: str) -> list[Row]:
    heights = ellipsoidal_m(data / WALK_FOLDER / "gnss_1730.ubx")
    above = float(np.median(heights[:, 1] - heights[:, 0]))
    log = walk_log(data)
    track = tracked(log)
    mean = np.nanmean(track.enu_m, axis=0)
    known = np.isfinite(track.enu_m[:, 0])
    dropped = sum(len(u.screening.dropped) for o in track.outcomes if (u := o.update).screening is not None)
    used = sum(len(o.update.keys) for o in track.outcomes)
    left = np.hypot(*(track.enu_m[:, :2] - mean[:2]).T)
    lag = next((n for n in log.notes if "stamps are" in n), "not told")
    return [
        row(
            NAME,
            "walk: epochs with a position, of all",
            "runs",
            f"{int(known.sum())} of {len(known)}",
            bool(known.sum() > 400),
            note="the others are before the first course: at rest nothing tells the heading",
        ),
        row(
            NAME,
            "walk: lag of the stamps",
            "estimated or configured",
            lag.partition(": ")[2],
            "stamps are" in lag,
        ),
        row(
            NAME,
            "walk: horizontal difference from the RTK file, RMS, m",
            "stated",
            round(rms(track.horizontal_m), 2),
            note=f"of which constant: {_enu(mean)} m east, north, up; see the next rows",
        ),
        row(
            NAME,
            "walk: the same without its own mean, m",
            "stated",
            round(rms(np.asarray(left)), 2),
            note="precision, not accuracy: the mean of the same log is taken away",
        ),
        *_offsets(data, above),
        row(
            NAME,
            "walk: horizontal velocity against the RTK file, RMS, m/s",
            "stated",
            round(rms(np.hypot(*track.enu_mps[:, :2].T)), 2),
            note="velocities of the file are 0.12 s late",
        ),
        row(
            NAME,
            "walk: pseudoranges and range rates dropped, of all",
            "stated",
            f"{dropped} of {dropped + used}",
        ),
        row(
            NAME,
            "walk: innovations squared over their covariance, per row",
            "stated",
            round(float(track.nis.mean()), 2),
        ),
        *_few(data),
    ]


def _offsets(data: Path, above_m: float) -> list[Row]:
    """Return where the constant offset comes from: heights of the file, the ionosphere, the base."""
    one, two = (_snapshots(data, both) + np.array([0.0, 0.0, above_m]) for both in (False, True))
    return [
        row(
            NAME,
            "walk: heights of the RTK file above those of the receiver's messages, m",
            "stated",
            round(above_m, 2),
            note="they are above the geoid; the two rows below are above the ellipsoid",
        ),
        row(
            NAME,
            "walk: mean offset of snapshots, one frequency, m",
            "stated",
            _enu(one),
            note="east, north, up; the log has no coefficients of the ionosphere",
        ),
        row(
            NAME,
            "walk: mean offset of snapshots, two frequencies, GPS and Galileo, m",
            "stated",
            _enu(two),
            note="without the ionosphere the height fits; what is left east, 5 to 7 m with each "
            "constellation alone, is most likely the base's coordinates, which the log does not hold",
        ),
    ]


def _snapshots(data: Path, both: bool) -> FloatArray:
    """Return the mean difference of snapshots from the RTK file, east, north, up."""
    site = Site(WALK, data)
    folder = data / WALK.folder
    table, nav = read_observations(folder / WALK.obs), read_navigation([folder / n for n in WALK.nav])
    loaded = gnss_epochs(table, nav, systems=WALK.systems, ionosphere_free=both)
    fixes = [snapshot(e, site.options(), np.zeros(3)) for e in loaded.epochs]
    place = np.array([np.full(3, np.nan) if f.reason else f.position_m for f in fixes])
    truth = read_truth(folder / (WALK.truth_file or "")).at(np.array([e.t_ns for e in loaded.epochs]))[0]
    known = np.isfinite(place - truth).all(axis=1)
    return np.asarray((place - truth)[known].mean(axis=0) @ enu_rotation(truth[known][0]).T)


def _enu(offset: FloatArray) -> str:
    return ", ".join(f"{v:.1f}" for v in offset)


def _few(data: Path) -> list[Row]:
    """Return the walk with three satellites for 20 s."""
    whole = Branches(walk_log(data))
    begin, end = 90.0, 110.0
    few = whole.with_satellites(begin, end, 3)
    i, j = whole.index(begin), whole.index(end)
    apart = [
        float(np.linalg.norm(a.mean[:3] - b.mean[:3]))
        for a, b in zip(few[i:j], whole.states[i:j], strict=True)
    ]
    last = float(np.linalg.norm(few[-1].mean[:3] - whole.states[-1].mean[:3]))
    return [
        row(
            NAME,
            "walk: three satellites for 20 s: largest difference from the run with all, m",
            "runs",
            round(max(apart), 1),
            bool(np.isfinite(max(apart))),
            note=f"{last:.2f} m at the end of the log",
        ),
    ]


# ---- two drives with a receiver's own fusion ----------------------------------------------------------


def _fusion(data: Path, spec: str) -> list[Row]:
    rows = []
    for name, floors in ((n, f) for n in FUSION for f in ((0.0, 0.0), (1.0, 0.5))):
        track = tracked(fusion_log(data, name, *floors))
        out = sum(len(o.exclusions) for o in track.outcomes)
        known = track.horizontal_m[np.isfinite(track.horizontal_m)]
        rows.append(
            row(
                NAME,
                f"{name}, floors {floors[0]:g} m, {floors[1]:g} m/s: horizontal difference from the "
                "receiver's fusion, RMS and median, m",
                "runs",
                f"{rms(known):.2f}, {np.median(known):.2f}",
                bool(len(known) > 500),
                note=f"not independent: the fixes are from the same fusion; {out} exclusions, "
                f"{alarms_in(track, True)} epochs with an alarm; innovations squared over their covariance, "
                f"per row: {track.nis.mean():.2f}",
            )
        )
    return rows
