"""The drive of the inertial campaign: clean, with faults in its fixes, with outages beside an independent
library, and without fixes for minutes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from pntegrity.estimators._gnss import GnssOptions
from pntegrity.formats.fixes import read_fixes
from pntegrity.formats.imu_table import read_imu
from pntegrity.imu_lag import estimate_lag, tracks
from pntegrity.scenarios import _python_ins
from pntegrity.scenarios._ins_logs import DRIVE, Branches, Bridge, Track, drive_log, tracked
from pntegrity.scenarios._real_logs import Row, row

__all__ = ["NAME", "alarms_in", "drive_rows"]

NAME = "ins-real"
#: The part of the drive on which the specification and the floors were chosen, s.
TRAINED_S = 300.0
OUTAGES_S, OUTAGE_S = tuple(range(100, 500, 50)), 30.0
#: Faults of the drive's fixes: what, when it begins, when it ends, s.
FAULTS = (
    ("fix bias 5 m 100:120", 100, 120),
    ("fix bias 20 m 100:120", 100, 120),
    ("fix bias 20 m 300:330", 300, 330),
    ("fix:Z bias 5 m 400:430", 400, 430),
    ("fix:X ramp 0.5 m/s 250:280", 250, 280),
)
ABSENT_S = (240.0, 420.0)


def drive_rows(data: Path, spec: str) -> list[Row]:
    """Return the figures of the drive; `spec` is the file of its unit's specification."""
    return [
        *_clean(data, spec),
        *_lags(data),
        *_faults(data, spec),
        *_outages(data, spec),
        *_absent(data, spec),
    ]


def _clean(data: Path, spec: str) -> list[Row]:
    rows = []
    for name, log in (
        ("unit as fitted", drive_log(data, spec)),
        (
            "low-cost, sigmas of the file",
            drive_log(data, "low-cost", fix_floor_m=0.0, fix_floor_mps=0.0, fix_velocity_lag_s=0.0),
        ),
    ):
        track = tracked(log)
        late = track.seconds >= TRAINED_S
        alarms = [alarms_in(track, part) for part in (~late, late)]
        fitted = name == "unit as fitted"
        must = "0 in the verified part" if fitted else "stated"
        rows.append(
            row(
                NAME,
                f"drive, {name}: epochs with an alarm, trained part and rest",
                must,
                f"{alarms[0]} of {int((~late).sum())}, {alarms[1]} of {int(late.sum())}",
                alarms[1] == 0 if fitted else None,
                note=f"innovations squared over their covariance, per row: {track.nis.mean():.2f}; "
                f"largest horizontal difference from the fixes {_most(track, track.seconds > 0)} m "
                "(they are what is measured)",
            )
        )
    return rows


def alarms_in(track: Track, part: Any) -> int:
    """Return in how many epochs of a part a monitor spoke up."""
    alert = np.array([any(v.status == "alert" for v in o.first) for o in track.outcomes])
    return int((alert & part).sum())


def _lags(data: Path) -> list[Row]:
    folder = data / DRIVE
    unit = read_imu(folder / "imu_gpst.csv.gz", axes="-x,y,-z", mount_deg=(0.0, -6.79, 5.35))
    notes: list[str] = []
    fixes = read_fixes(folder / "gnss_1934_sf.pos.gz")
    lag = estimate_lag(unit, fixes, tracks(fixes, GnssOptions()), notes)
    told = (
        "not told"
        if lag is None
        else f"{lag.lag_s:.3f} s +- {lag.sigma_s:.3f} s, correlation {lag.correlation:.2f}"
    )
    return [
        row(
            NAME,
            "drive: lag of the stamps",
            "estimated or configured",
            told,
            lag is not None,
            note="; ".join(n.partition(":")[0] for n in notes),
        ),
    ]


def _faults(data: Path, spec: str) -> list[Row]:
    rows = []
    for fault, begin, end in FAULTS:
        track = tracked(drive_log(data, spec).with_fault(fault))
        made = [(track.at(o.t_ns), e) for o in track.outcomes for e in o.exclusions]
        first = next((s for s, _ in made if s >= begin), np.inf)
        back = next(
            (
                track.at(o.t_ns)
                for o in track.outcomes
                if o.readmitted and o.t_ns > 0 and track.at(o.t_ns) > first
            ),
            np.inf,
        )
        size = next((e.size for s, e in made if s == first), np.nan)
        during = (track.seconds >= begin) & (track.seconds < end)
        after = track.seconds > back + 5.0
        until = (track.seconds >= begin) & (track.seconds <= back + 0.25)
        rows.append(
            row(
                NAME,
                f"drive: {fault}: seen after, s",
                "detected",
                round(first - begin, 2),
                bool(np.isfinite(first)),
                note=f"size found {size:.2f}; left out until {back:.1f} s ({back - end:.1f} s after its "
                f"end), {len(made)} exclusions; largest horizontal error (against the clean fixes) during it "
                f"{_most(track, during)} m, until readmission {_most(track, until)} m, "
                f"more than 5 s after it {_most(track, after)} m",
            )
        )
    return rows


def _most(track: Track, part: Any) -> str:
    known = track.horizontal_m[part & np.isfinite(track.horizontal_m)]
    return f"{known.max():.2f}" if len(known) else "-"


def _outages(data: Path, spec: str) -> list[Row]:
    branches = Branches(drive_log(data, spec))
    bridges = [branches.bridge(s, OUTAGE_S) for s in OUTAGES_S]
    ours = [b.horizontal_m for b in bridges]
    inside = sum(b.square <= 11.83 for b in bridges)
    theirs = _theirs(branches, bridges) if _python_ins.available() else None
    beside = "python-ins is not installed" if theirs is None else _spread(theirs)
    must = "beside an independent library"
    ok = (
        None
        if theirs is None
        else bool(np.median(ours) <= 1.1 * np.median(theirs) and max(ours) <= 1.1 * max(theirs))
    )
    each = "; ".join(
        f"{s} s: {a:.0f}" + ("" if theirs is None else f"/{b:.0f}")
        for s, a, b in zip(OUTAGES_S, ours, theirs or ours, strict=True)
    )
    return [
        row(
            NAME,
            f"drive: {len(ours)} outages of 30 s, error at the end, median and largest, m",
            must,
            _spread(ours),
            ok,
            note=f"python-ins, same increments, fixes and noise: {beside}; each: {each}. The unit is the "
            "limit: its noise in the car is 25 times that of the data sheet",
        ),
        row(
            NAME,
            "drive: outages whose error lies inside the 3-sigma ellipse of the prediction",
            "stated",
            f"{inside} of {len(bridges)}",
            note="the noise of the specification is white; that of a shaken unit need not be",
        ),
    ]


def _spread(errors: list[float]) -> str:
    return f"{np.median(errors):.1f}, {max(errors):.1f}"


def _theirs(branches: Branches, bridges: list[Bridge]) -> list[float]:
    options, first = branches.estimator.options.ins, branches.first
    other = _python_ins.Filtered(
        branches.epochs,
        first,
        branches.states[first],
        options.spec,
        0.05,
        0.2,
        np.asarray(options.lever_arm_m),
    )
    out = []
    for bridge in bridges:
        i, j = branches.index(bridge.begin_s), branches.index(bridge.begin_s + OUTAGE_S)
        fix = branches.epochs[j].observations[0].y[:3]
        away = other.bridge(float(branches.seconds[i]), float(branches.seconds[j]), fix)
        out.append(float(np.hypot(away[0], away[1])))
    return out


def _absent(data: Path, spec: str) -> list[Row]:
    """Return the drive without fixes for three minutes: the unit alone, and how it comes back."""
    branches = Branches(drive_log(data, spec))
    errors, seconds = branches.without(*ABSENT_S)
    end = ABSENT_S[1]
    gone, back = errors[(seconds >= ABSENT_S[0]) & (seconds < end)], errors[seconds > end + 5.0]
    return [
        row(
            NAME,
            "drive: no fixes for 180 s: largest horizontal error 5 s after they are back, m",
            "no lock-out",
            round(float(back.max()), 2),
            bool(back.max() < 1.0),
            note=f"{gone.max():.0f} m at most without them",
        ),
    ]
