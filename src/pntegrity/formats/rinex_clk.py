"""RINEX clock files -> `PreciseClocks`: the satellites' (AS) records of one or several files."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import sidereon

from pntegrity.errors import InputError
from pntegrity.formats._source import read_text, rinex_first_line, with_decimal_version, without_cut_line
from pntegrity.formats.sp3 import civil_to_gps_ns
from pntegrity.physics.products import PreciseClocks, most_frequent_step_s
from pntegrity.physics.time import DAY_NS, from_j2000_s, to_iso

__all__ = ["PreciseClocks", "read_clocks"]

_REFUSED = (sidereon.SidereonError, ValueError)
_HINT = "Give a RINEX clock file (.clk): a final or rapid product of IGS or one of its centres"
_J2000_GPS_S = 630_763_200.0
"""J2000 in seconds of GPS time."""
_JD_GPS = 2_444_244.5
MAX_CLOCK_S = 0.1
"""A satellite clock further off than this is a damaged number: the worst real ones are off by 1 ms."""
Series = tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]


def read_clocks(paths: Sequence[Path | str] | Path | str) -> PreciseClocks:
    """Read one or several RINEX clock files; of an instant in two files the later file's value counts.

    Parameters
    ----------
    paths : sequence of Path
        Plain or gzip, version 2 or 3, in any order.

    Returns
    -------
    PreciseClocks
        In GPS time; its `notes` tell what was left out.

    Raises
    ------
    InputError
        A file is missing or no clock file, or all files together hold no satellite clock.
    """
    files = [Path(paths)] if isinstance(paths, str | Path) else [Path(p) for p in paths]
    if not files:
        raise InputError("no clock file given", hint=_HINT)
    notes: list[str] = []
    read = [_read(path, notes) for path in files]
    parts = sorted((p for p in read if p[2]), key=lambda p: _span(p[2]))
    if not parts:
        why = "; ".join(notes) or "the file holds none"
        raise InputError(f"no satellite clock can be used ({why})", path=files[0], hint=_HINT)
    series = _merged([p[2] for p in parts])
    agencies = tuple(dict.fromkeys(p[1] for p in parts if p[1]))
    if len(agencies) > 1:
        notes.append(f"the clocks are of {' and '.join(agencies)}: their datum may differ")
    return PreciseClocks(
        series=series,
        interval_s=most_frequent_step_s(t for t, _ in series.values()),
        kind="CLK",
        agency="/".join(agencies),
        sources=tuple(_source(*p) for p in parts),
        notes=tuple(notes),
    )


def _read(path: Path, notes: list[str]) -> tuple[str, str, dict[str, Series]]:
    text = read_text(path)
    first = rinex_first_line(text, path, _HINT)
    if first[20:21].upper() != "C" and "CLOCK" not in first.upper():
        raise InputError(
            f"this RINEX file holds {first[20:40].strip()!r}, not clocks", path=path, line=1, hint=_HINT
        )
    if "END OF HEADER" not in text:
        raise InputError("the header does not end", path=path, hint="The file is cut off: download it again")
    own: list[str] = []
    text = with_decimal_version(without_cut_line(text, own))
    try:
        product = sidereon.parse_rinex_clock_lossy(text)
    except _REFUSED as error:
        raise InputError(
            f"cannot be read ({str(error)[:120]})", path=path, hint="Download the clock file again"
        ) from None
    own += _dropped(product)
    series = _series(product, path, own)
    notes += [f"{path.name}: {note}" for note in own]
    return path.name, _agency(product), series


def _dropped(product: Any) -> list[str]:
    """Return notes about the lines that could not be read."""
    bad = list(product.diagnostics)
    notes = [f"line {d.line} dropped ({str(d.message).split(': ', 1)[-1][:80]})" for d in bad[:5]]
    if len(bad) > 5:
        notes.append(f"{len(bad) - 5} more lines dropped")
    return notes + [str(n.message) for n in product.notices]


def _series(product: Any, path: Path, notes: list[str]) -> dict[str, Series]:
    if product.time_system is None:
        raise InputError(
            f"its time system is unknown ({product.time_system_status.label!r})",
            path=path,
            hint="'TIME SYSTEM ID' must be GPS, GAL, QZS, BDT, UTC, GLO or TAI",
        )
    label = str(product.time_system.label)
    out = {}
    wild = 0
    for one in product.series:
        t_ns, bias = _times(one, label), np.asarray(one.bias_s, dtype=np.float64)
        good = np.abs(bias) < MAX_CLOCK_S
        wild += int((~good).sum())
        if good.any():
            out[one.satellite] = t_ns[good], bias[good]
    if wild:
        notes.append(f"{wild} clock values dropped, over {MAX_CLOCK_S:g} s")
    return _merged([out])


def _times(series: Any, label: str) -> npt.NDArray[np.int64]:
    """Return the times of a satellite, ns of GPS time: sidereon projects those of GPS and QZSS itself."""
    if series.gps_seconds_valid.all():
        return from_j2000_s(series.gps_seconds - _J2000_GPS_S)
    civil = [
        round((e.jd_whole - _JD_GPS) * DAY_NS) + round(e.fraction * 86_400e6) * 1000 for e in series.epochs
    ]
    return np.array([t + civil_to_gps_ns(t, label) for t in civil], dtype=np.int64)


def _merged(parts: Sequence[dict[str, Series]]) -> dict[str, Series]:
    """Return the series joined, strictly rising; the last value of an instant counts."""
    out = {}
    for sat in sorted({s for p in parts for s in p}):
        t = np.concatenate([p[sat][0] for p in parts if sat in p])
        bias = np.concatenate([p[sat][1] for p in parts if sat in p])
        kept, last = np.unique(t[::-1], return_index=True)
        out[sat] = kept, bias[::-1][last]
    return out


def _agency(product: Any) -> str:
    named = [r.payload.split() for r in product.header_records if r.label == "ANALYSIS CENTER"]
    return named[0][0] if named and named[0] else ""


def _span(series: dict[str, Series]) -> tuple[int, int]:
    ends = [(int(t[0]), int(t[-1])) for t, _ in series.values()]
    return min(a for a, _ in ends), max(b for _, b in ends)


def _source(name: str, agency: str, series: dict[str, Series]) -> str:
    first, last = (to_iso(t)[:16].replace("T", " ") for t in _span(series))
    step = most_frequent_step_s(t for t, _ in series.values())
    every = f", every {step:g} s" if math.isfinite(step) else ""
    return f"{name} ({agency}{every}, {first} to {last})"
