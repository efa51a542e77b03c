"""Campaigns in the layout of GNATSS: seafloor transponders ranged from a Wave Glider -> `AcousticLog`.

Files, plain or gzip: ``config.yaml``; ``pxp_tt`` (time of transmission, two-way times of the transponders,
us, 0 where there was no reply); ``GPS_POS_FREED`` (J2000 s, ECEF, sigmas: antenna); ``POS_FREED_TRANS_TWTT``
(J2000 s, ECEF of the transducer, covariance); ``RPH_TWTT`` (J2000 s, roll, pitch, heading, degrees); and a
profile of the speed of sound. Times are taken as GPS time; only differences matter here.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

import numpy as np
import numpy.typing as npt

from pntegrity.errors import InputError
from pntegrity.formats._acoustics import (
    AcousticLog,
    arms_of,
    check_in_common,
    fix_of,
    seconds_text_to_ns,
    with_repeats,
)
from pntegrity.formats._columns import checked
from pntegrity.formats._source import read_text
from pntegrity.formats.acoustic_profile import read_profile
from pntegrity.formats.truth import Truth
from pntegrity.physics.time import civil_to_ns
from pntegrity.records import FloatArray, Observation

__all__ = ["read_gnatss", "read_transducer"]

J2000_NS = civil_to_ns(2000, 1, 1, 12)
MONTHS = ("JAN", "FEB", "MAR", "APR", "MAY", "JUN", "JUL", "AUG", "SEP", "OCT", "NOV", "DEC")
MICROSECOND_NS = 1000
#: No travel time is longer, us.
MOST_US = 10**9


def read_gnatss(
    folder: Path | str, *, day: str = "*", source: str = "lbl", undulation_m: float | None = None,
    sigma_s: float = 1e-5,
) -> AcousticLog:  # fmt: skip
    """Read a campaign in the layout of GNATSS.

    Parameters
    ----------
    folder : Path or str
        With ``config.yaml``, a profile ``CTD*`` and a folder a day.
    day : str
        The folder of the day; of several, ``"*"`` takes the first.
    source : str
        What rows begin with: ``"lbl:R.T1"``, the transponders in the order of the configuration.
    undulation_m : float, optional
        Added to the transponders' heights: these are above the geoid. Without it, ``geoid_undulation`` of the
        configuration.
    sigma_s : float
        Standard deviation of a travel time.

    Returns
    -------
    AcousticLog
        One observation a ping, at its last reception; ``aux`` has ``"t0_ns"``, ``"received_ns"`` and
        ``"ways"`` a row. Travel times contain the transponders' delays.

    Raises
    ------
    InputError
        A missing file, a line that cannot be read, times that have nothing in common.
    """
    folder = Path(folder)
    notes: list[str] = []
    config = folder / "config.yaml"
    text = read_text(config)
    undulation = _number(text, "geoid_undulation", config) if undulation_m is None else undulation_m
    beacons = _transponders(text, config, undulation)
    where = _day(folder, day)
    path = _file(where, "pxp_tt")
    pings = _pings(path, list(beacons), source, sigma_s, notes)
    fixes = _fixes(_file(where, "GPS_POS_FREED"))
    check_in_common((source, _times(pings)), ("the positions", _times(fixes)), path, notes)
    forward, right, down = (_number(text, k, config) for k in ("forward", "rightward", "downward"))
    arm = (forward, right, down)
    attitude = _attitude(where, np.array(arm))
    profile = read_profile(_file(folder, "CTD*"), notes=notes)
    observations = with_repeats(pings, notes)
    return AcousticLog(source, observations, fixes, attitude, beacons, arm, undulation, profile, tuple(notes))


def read_transducer(folder: Path | str, day: str = "*") -> Truth:
    """Return where the transducer was at transmissions and receptions, of ``POS_FREED_TRANS_TWTT``.

    Raises
    ------
    InputError
        A missing file, or a line that cannot be read.
    """
    t_ns, numbers = _table(_file(_day(Path(folder), day), "POS_FREED_TRANS_TWTT"), 3)
    t_ns, first = np.unique(t_ns, return_index=True)
    return Truth(t_ns, numbers[first])


def _day(folder: Path, day: str) -> Path:
    days = sorted(p for p in folder.glob(day) if p.is_dir())
    if not days:
        raise InputError(f"no folder {day!r} of a day", path=folder, hint="It holds pxp_tt and GPS_POS_FREED")
    return days[0]


def _file(folder: Path, name: str) -> Path:
    found = [p for pattern in (name, name + ".gz") for p in sorted(folder.glob(pattern)) if p.is_file()]
    if not found:
        raise InputError(f"no file {name}", path=folder, hint="docs/formats/acoustics.md lists the files")
    return found[0]


def _times(observations: Sequence[Observation]) -> npt.NDArray[np.int64]:
    return np.array([o.t_ns for o in observations], dtype=np.int64)


# --- configuration ------------------------------------------------------------------------------------------


def _number(text: str, key: str, path: Path) -> float:
    found = re.search(rf"^[ \-]*{key}:\s*(\S+)\s*(?:#.*)?$", text, re.MULTILINE)
    try:
        return float(found[1]) if found else _missing(key, path)
    except InputError:
        raise
    except ValueError:
        raise InputError(f"`{key}` is no number", path=path, hint="Correct the configuration") from None


def _missing(key: str, path: Path) -> NoReturn:
    raise InputError(f"`{key}` is missing", path=path, hint="It is a key of GNATSS's configuration")


def _transponders(text: str, path: Path, undulation: float) -> dict[str, dict[str, float]]:
    """Return the items of the list ``transponders``, heights above the ellipsoid."""
    block = re.search(r"^transponders:\s*\n((?:[ \t-].*\n|\s*\n)*)", text + "\n", re.MULTILINE)
    items = re.split(r"^\s*-\s+", block[1], flags=re.MULTILINE)[1:] if block else []
    if not items:
        raise InputError("no list `transponders`", path=path, hint="Give lat, lon, height and internal_delay")
    out = {}
    for i, item in enumerate(items, 1):
        lat, lon, height, delay = (_number(item, k, path) for k in ("lat", "lon", "height", "internal_delay"))
        out[f"T{i}"] = {"lat_deg": lat, "lon_deg": lon, "height_m": height + undulation, "delay_s": delay}
    return out


# --- tables -------------------------------------------------------------------------------------------------


def _pings(
    path: Path, names: Sequence[str], source: str, sigma_s: float, notes: list[str]
) -> list[Observation]:
    """Return what was heard, by time; of pings of one time the last counts."""
    lines = [(n, line) for n, line in enumerate(read_text(path).splitlines(), 1) if line.strip()]
    pings = [_known_ping(line, len(names), path, n) for n, line in lines]
    heard = [_observation(t0, ticks, names, source, sigma_s) for t0, ticks in pings if any(ticks)]
    if not heard:
        raise InputError("no reply in any ping", path=path, hint="Is this pxp_tt?")
    if len(heard) < len(pings):
        notes.append(f"{path.name}: {len(pings) - len(heard)} pings without any reply")
    out = {o.t_ns: o for o in heard}
    return [out[t] for t in sorted(out)]


def _known_ping(line: str, n: int, path: Path, number: int) -> tuple[int, list[int]]:
    """Return when a ping was sent and the replies of the `n` transponders that are known."""
    try:
        t0, ticks = _ping(line.split())
    except (ValueError, OverflowError) as error:
        raise InputError(
            f"no ping: {error}", path=path, line=number, hint="27-JUL-22 17:37:45.00 and times in us"
        ) from None
    if any(ticks[n:]):
        raise InputError(
            f"a reply of transponder {n + 1}, which has no coordinates", path=path, line=number,
            hint="Add it to `transponders` of the configuration",
        )  # fmt: skip
    return t0, ticks[:n]


def _ping(cells: Sequence[str]) -> tuple[int, list[int]]:
    if len(cells) < 3:
        raise ValueError("too few columns")
    day, month, year = cells[0].split("-")
    hour, minute, second = cells[1].split(":")
    midnight = civil_to_ns(2000 + int(year), MONTHS.index(month.upper()) + 1, int(day))
    t0 = midnight + (int(hour) * 60 + int(minute)) * 60 * 10**9 + seconds_text_to_ns(second)
    ticks = [int(c) for c in cells[2:]]
    if min(ticks) < 0 or max(ticks) > MOST_US:
        raise ValueError("a negative or an absurd travel time")
    return checked(t0), ticks


def _observation(
    t0: int, ticks: Sequence[int], names: Sequence[str], source: str, sigma_s: float
) -> Observation:
    heard = [i for i, tick in enumerate(ticks) if tick > 0]
    took = np.array([ticks[i] * MICROSECOND_NS for i in heard], dtype=np.int64)
    seconds: FloatArray = took.astype(np.float64) * 1e-9
    n = len(heard)
    return Observation(
        source, t0 + int(took.max()), tuple(f"{source}:R.{names[i]}" for i in heard), seconds,
        np.full(n, sigma_s), {"t0_ns": np.full(n, t0), "received_ns": t0 + took, "ways": np.full(n, 2)},
    )  # fmt: skip


def _table(path: Path, n: int) -> tuple[npt.NDArray[np.int64], FloatArray]:
    """Return times and the `n` numbers behind them of each line; words between are skipped."""
    times, rows = [], []
    for number, line in enumerate(read_text(path).splitlines(), 1):
        cells = [c for c in line.split() if not c.isalpha()]
        if not cells:
            continue
        try:
            t_ns = J2000_NS + round(seconds_text_to_ns(cells[0]), -3)  # files of one day round apart
            times.append(checked(t_ns))
            rows.append([float(c) for c in cells[1 : n + 1]])
        except ValueError:
            rows.append([])
        if len(rows[-1]) < n or not np.isfinite(rows[-1]).all():
            raise InputError(
                f"not a time and {n} numbers", path=path, line=number, hint="Copy the file again"
            )
    if not rows:
        raise InputError("no line with numbers", path=path, hint="Copy the file again")
    return np.array(times, dtype=np.int64), np.array(rows)


def _fixes(path: Path) -> tuple[Observation, ...]:
    t_ns, numbers = _table(path, 6)
    return tuple(
        fix_of(t, row[:3], np.diag(row[3:] ** 2)) for t, row in zip(t_ns.tolist(), numbers, strict=True)
    )


def _attitude(where: Path, arm_m: FloatArray) -> Truth:
    """Return attitudes at transmissions and receptions, and the antenna above the transducer."""
    t_ns, angles = _table(_file(where, "RPH_TWTT"), 3)
    t_ns, first = np.unique(t_ns, return_index=True)
    place = read_transducer(where.parent, where.name)
    common, i, j = np.intersect1d(t_ns, place.t_ns, return_indices=True)
    turned = np.radians(angles[first][i])
    turned[:, 2] %= 2.0 * np.pi
    return Truth(common, place.position_m[j] - arms_of(place.position_m[j], turned, arm_m), None, (), turned)
