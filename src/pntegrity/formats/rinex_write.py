"""`SignalTable` and `Navigation` -> RINEX 3.04 files, written so that a reader never meets a part of one."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import sidereon

from pntegrity.formats.atomic import write_text
from pntegrity.physics.tables import Klobuchar, Navigation, SignalTable
from pntegrity.physics.time import SECOND_NS, from_iso, to_iso

__all__ = ["write_navigation", "write_observations"]

WIDEST = 1e9
"""RINEX has 14 columns with 3 decimals: values beyond do not fit."""
IONO_NAMES = {"G": "GPS", "C": "BDS", "J": "QZS"}


def write_observations(path: Path | str, table: SignalTable, *, comment: str = "") -> None:
    """Write a RINEX 3.04 observation file.

    Values are rounded to 0.001 (metres, cycles, Hz, dB-Hz) and time tags to 100 ns, as RINEX has it; nan is
    left blank.

    Parameters
    ----------
    path : Path or str
        The file; an existing one is replaced in one step.
    table : SignalTable
        What to write; every system's list holds all four kinds (C, L, D, S) of its signals.
    comment : str
        One line for the header, cut at 60 characters.

    Raises
    ------
    InputError
        The file cannot be written.
    ValueError
        A value does not fit RINEX's columns, or the table is empty.
    """
    if not len(table):
        raise ValueError("`table` is empty: nothing to write")
    largest = max(float(np.nanmax(np.abs(v), initial=0.0)) for v in _values(table).values())
    if largest >= WIDEST:
        raise ValueError(f"`table` holds {largest:g}: RINEX has room for values below {WIDEST:g}")
    signals = _signals(table)
    lines = [*_obs_header(table, signals, comment), *_epochs(table, signals)]
    write_text(path, "\n".join(lines) + "\n", "ascii")


def _values(table: SignalTable) -> dict[str, Any]:
    return {"C": table.pseudorange_m, "L": table.carrier_cycles, "D": table.doppler_hz, "S": table.cn0_dbhz}


def _signals(table: SignalTable) -> dict[str, list[str]]:
    both = np.unique(np.char.add(table.sat.astype("<U1"), table.signal)).tolist()
    return {s: [b[1:] for b in both if b[0] == s] for s in table.systems}


def _line(text: str, label: str) -> str:
    return f"{text[:60]:<60}{label}"


def _obs_header(table: SignalTable, signals: dict[str, list[str]], comment: str) -> Iterator[str]:
    yield _line(f"{3.04:9.2f}{'':11}{'OBSERVATION DATA':<20}{'M (MIXED)':<20}", "RINEX VERSION / TYPE")
    yield _line(f"{'pntegrity':<40}", "PGM / RUN BY / DATE")
    if comment:
        yield _line(comment, "COMMENT")
    yield _line(table.marker, "MARKER NAME")
    yield _line("", "OBSERVER / AGENCY")
    yield _line(f"{'':20}{table.receiver[:20]:<20}", "REC # / TYPE / VERS")
    yield _line(f"{'':20}{table.antenna[:20]:<20}", "ANT # / TYPE")
    if table.approx_position_m is not None:
        yield _line("".join(f"{v:14.4f}" for v in table.approx_position_m), "APPROX POSITION XYZ")
    yield _line("".join(f"{v:14.4f}" for v in table.antenna_delta_hen_m), "ANTENNA: DELTA H/E/N")
    for system, names in signals.items():
        codes = [kind + name for name in names for kind in "CLDS"]
        for i in range(0, len(codes), 13):
            head = f"{system}  {len(codes):3d}" if i == 0 else " " * 6
            yield _line(head + "".join(f" {c}" for c in codes[i : i + 13]), "SYS / # / OBS TYPES")
    if table.interval_s:
        yield _line(f"{table.interval_s:10.3f}", "INTERVAL")
    yield _line(
        f"{_civil(int(table.t_ns[0]), '{:6d}{:6d}{:6d}{:6d}{:6d}{:13.7f}')}     GPS", "TIME OF FIRST OBS"
    )
    yield from _slots(table)
    yield _line("", "END OF HEADER")


def _slots(table: SignalTable) -> Iterator[str]:
    slots = [f"{sat} {channel:2d} " for sat, channel in sorted(table.glonass_channels.items())]
    for i in range(0, len(slots), 8):
        head = f"{len(slots):3d} " if i == 0 else " " * 4
        yield _line(head + "".join(slots[i : i + 8]), "GLONASS SLOT / FRQ #")
    if "R" in table.systems:
        yield _line("", "GLONASS COD/PHS/BIS")


def _civil(t_ns: int, form: str) -> str:
    rounded = (t_ns + 50) // 100 * 100
    text = to_iso(rounded // SECOND_NS * SECOND_NS)
    second = int(text[17:19]) + rounded % SECOND_NS / SECOND_NS
    return form.format(
        int(text[:4]), int(text[5:7]), int(text[8:10]), int(text[11:13]), int(text[14:16]), second
    )


def _epochs(table: SignalTable, signals: dict[str, list[str]]) -> Iterator[str]:
    """Yield the epochs, one line a satellite: its signals at their places of the header's list."""
    place = {s + name: 64 * i for s, names in signals.items() for i, name in enumerate(names)}
    bounds = np.searchsorted(table.epoch, np.arange(len(table.t_ns) + 1)).tolist()
    sats, names, lli = table.sat.tolist(), table.signal.tolist(), table.lli.tolist()
    columns = [v.tolist() for v in _values(table).values()]
    for t, i, j in zip(table.t_ns.tolist(), bounds, bounds[1:], strict=False):
        rows: dict[str, str] = {}
        for k in range(i, j):
            line = rows.get(sats[k], sats[k])
            at = 3 + place[sats[k][0] + names[k]]
            c, p, d, s = (_field(column[k]) for column in columns)
            rows[sats[k]] = f"{line:<{at}}{c}  {p}{lli[k] or ' '} {d}  {s}  "
        yield f"{_civil(t, '> {:4d} {:02d} {:02d} {:02d} {:02d}{:11.7f}')}  0{len(rows):3d}"
        yield from (row.rstrip() for row in rows.values())


def _field(value: float) -> str:
    return f"{value:14.3f}" if value == value else " " * 14


def write_navigation(path: Path | str, nav: Navigation, *, comment: str = "") -> None:
    """Write a RINEX 3.04 navigation file with all ephemerides of `nav`.

    Parameters
    ----------
    path : Path or str
        The file; an existing one is replaced in one step.
    nav : Navigation
        Ephemerides, ionosphere coefficients and leap seconds.
    comment : str
        One line for the header, cut at 60 characters.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    lines = [_line(f"{3.04:9.2f}{'':11}{'N: GNSS NAV DATA':<20}{'M: MIXED':<20}", "RINEX VERSION / TYPE")]
    lines.append(_line(f"{'pntegrity':<40}", "PGM / RUN BY / DATE"))
    lines += [_line(comment, "COMMENT")] if comment else []
    for system, coefficients in nav.klobuchar.items():
        lines += _iono(IONO_NAMES[system], coefficients)
    if nav.leap_seconds is not None:
        lines.append(_line(f"{round(nav.leap_seconds):6d}", "LEAP SECONDS"))
    lines.append(_line("", "END OF HEADER"))
    if nav.kepler:
        text = sidereon.encode_rinex_nav(list(nav.kepler))
        lines.append(text[text.index("\n", text.index("END OF HEADER")) + 1 :].rstrip("\n"))
    lines += [line for record in nav.glonass for line in _glonass(record)]
    write_text(path, "\n".join(lines) + "\n", "ascii")


def _iono(name: str, k: Klobuchar) -> list[str]:
    rows = (("A", k.alpha), ("B", k.beta))
    return [
        _line(f"{name}{x} " + "".join(f"{v:12.4E}" for v in values), "IONOSPHERIC CORR") for x, values in rows
    ]


def _glonass(r: Any) -> list[str]:
    utc = from_iso("2000-01-01T12:00:00") + round(r.epoch_utc_j2000_s) * SECOND_NS
    text = to_iso(utc)
    stamp = text.replace("-", " ").replace("T", " ").replace(":", " ")
    position, velocity, push = (
        np.asarray(v) * 1e-3 for v in (r.position_m, r.velocity_m_s, r.acceleration_m_s2)
    )
    first = [r.clock_bias_s, r.gamma_n, r.message_frame_time_s or 0.0]
    last = [r.sv_health, float(r.freq_channel), r.age_days or 0.0]
    rows = [[position[i], velocity[i], push[i], last[i]] for i in range(3)]
    head = f"{r.satellite} {stamp}" + "".join(f"{v:19.12E}" for v in first)
    return [head, *("    " + "".join(f"{v:19.12E}" for v in row) for row in rows)]
