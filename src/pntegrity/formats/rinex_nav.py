"""RINEX 2, 3 and 4 navigation files -> `Navigation`: mixed, or one system a file (n, g, b, q, l files)."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import sidereon

from pntegrity.errors import InputError
from pntegrity.formats._source import read_text, rinex_first_line, with_decimal_version
from pntegrity.physics.ephemeris import is_possible, sisa_is_index
from pntegrity.physics.signals import WORDS
from pntegrity.physics.tables import Klobuchar, Navigation
from pntegrity.physics.time import to_iso

__all__ = ["Navigation", "read_navigation"]

_REFUSED = (sidereon.SidereonError, ValueError)
_NUMBER = re.compile(r"[-+]?\d*\.\d+(?:[DEde][-+]?\d+)?")
IONO_LABELS = {"GPSA": "G", "GPSB": "G", "BDSA": "C", "BDSB": "C", "QZSA": "J", "QZSB": "J"}


def read_navigation(paths: Sequence[Path | str] | Path | str) -> Navigation:
    """Read one or several RINEX navigation files into one store.

    Parameters
    ----------
    paths : sequence of Path
        Mixed files or one a system, plain or gzip, any RINEX version.

    Returns
    -------
    Navigation
        Every readable ephemeris, repeated ones once; its `notes` tell what was left out.

    Raises
    ------
    InputError
        A file is missing, is no navigation file, or all files together hold no ephemeris.
    """
    files = [Path(paths)] if isinstance(paths, str | Path) else [Path(p) for p in paths]
    if not files:
        raise InputError("no navigation file given", hint="Give at least one RINEX navigation file")
    notes: list[str] = []
    kepler: list[Any] = []
    glonass: list[Any] = []
    klobuchar: dict[str, Klobuchar] = {}
    leap: float | None = None
    sources: list[str] = []
    for path in files:
        text = read_text(path)
        _check_kind(text, path)
        text = with_decimal_version(text)
        k, g = _records(text, path, notes)
        kepler += k
        glonass += g
        klobuchar = _klobuchar(text) | klobuchar
        leap = _leap_seconds(text) if leap is None else leap
        sources.append(_source(path, Navigation(tuple(k), tuple(g))))
    if not kepler and not glonass:
        why = "; ".join(notes) or "the file holds none"
        raise InputError(
            f"no ephemeris can be used ({why})",
            path=files[0],
            hint="Give another navigation file of that day",
        )
    return Navigation(
        kepler=tuple({_identity(r): r for r in kepler}.values()),
        glonass=tuple({(r.satellite, r.toe_gpst_j2000_s): r for r in glonass}.values()),
        klobuchar=klobuchar,
        leap_seconds=leap,
        sources=tuple(sources),
        notes=tuple(notes),
    )


def _identity(r: Any) -> tuple[Any, ...]:
    return (
        r.satellite,
        r.message.label,
        r.toe_week,
        r.toe_tow_s,
        r.toc_tow_s,
        r.issue,
        r.transmission_time_sow,
    )


def _check_kind(text: str, path: Path) -> None:
    hint = "Give a RINEX navigation file: the station's own, or the daily BRDC file of IGS"
    first = rinex_first_line(text, path, hint)
    if first[20:21].upper() not in "NGHLJQCB" or "OBS" in first[20:40].upper():
        raise InputError(
            f"this RINEX file holds {first[20:40].strip()!r}, not navigation messages",
            path=path,
            line=1,
            hint="Give the navigation file here and the observation file as observations",
        )


def _records(text: str, path: Path, notes: list[str]) -> tuple[list[Any], list[Any]]:
    try:
        parsed = sidereon.parse_rinex_nav_lenient(text)
        glonass = list(sidereon.parse_rinex_glonass_records(text))
    except _REFUSED as error:
        raise InputError(
            f"cannot be read ({str(error)[:120]})", path=path, hint="Download the navigation file again"
        ) from None
    for block in parsed.skipped[:5]:
        notes.append(f"{path.name} line {block.line}: {block.satellite} dropped ({block.message})")
    if parsed.skipped_count > 5:
        notes.append(f"{path.name}: {parsed.skipped_count - 5} more ephemerides dropped")
    lost = Counter(b.kind for b in parsed.other)["glonass"] - len(glonass)
    if lost > 0:
        notes.append(f"{path.name}: {lost} GLONASS ephemerides dropped, they cannot be read")
    return _possible(list(parsed.records), path, notes), _possible(glonass, path, notes)


def _possible(records: list[Any], path: Path, notes: list[str]) -> list[Any]:
    """Return the records that can describe a satellite's orbit and clock, noting the others.

    Where most messages of a system are impossible (a writer's wrong unit), the rest of that system is not
    trusted.
    """
    possible = [is_possible(r) for r in records]
    total = Counter(r.satellite[0] for r in records)
    wrong = Counter(r.satellite[0] for r, p in zip(records, possible, strict=True) if not p)
    worst = {s for s, n in wrong.items() if 2 * n > total[s]}
    good = [r for r, p in zip(records, possible, strict=True) if p and r.satellite[0] not in worst]
    bad = (
        [r for r, p in zip(records, possible, strict=True) if not p or r.satellite[0] in worst]
        if wrong
        else []
    )
    if bad:
        sats = sorted({r.satellite for r in bad})
        names = ", ".join(sats[:6]) + (", ..." if len(sats) > 6 else "")
        of_all = f"; all of {', '.join(WORDS[s] for s in sorted(worst))}" if worst else ""
        notes.append(
            f"{path.name}: {len(bad)} ephemerides dropped, orbit or clock impossible ({names}{of_all})"
        )
    odd = sum(1 for r in records if r.satellite[0] == "E" and sisa_is_index(r))
    if odd:
        notes.append(
            f"{path.name}: {odd} Galileo accuracies are written as an index, not in metres; read as such"
        )
    return good


def _source(path: Path, nav: Navigation) -> str:
    if not len(nav.kepler) and not len(nav.glonass):
        return f"{path.name} (no ephemeris)"
    first, last = (to_iso(t)[:16].replace("T", " ") for t in nav.coverage_ns)
    return f"{path.name} ({nav.systems}, {first} to {last})"


def _leap_seconds(text: str) -> float | None:
    try:
        return sidereon.parse_rinex_leap_seconds(text)
    except _REFUSED:
        return None


def _klobuchar(text: str) -> dict[str, Klobuchar]:
    """Return the coefficients of the header, or of the first ``ION`` records of RINEX 4."""
    found: dict[str, dict[str, tuple[float, ...]]] = {}
    header = text[: max(text.find("END OF HEADER"), 0)]
    for line in header.splitlines():
        label = line[60:].strip()
        if label == "IONOSPHERIC CORR" and line[:4] in IONO_LABELS:
            values = _numbers(line[4:60])
            found.setdefault(IONO_LABELS[line[:4]], {}).setdefault(line[3], values)
        elif label in ("ION ALPHA", "ION BETA"):
            found.setdefault("G", {})["A" if label == "ION ALPHA" else "B"] = _numbers(line[:60])
    out = {}
    for letter, pair in found.items():
        a, b = pair.get("A", ()), pair.get("B", ())
        if len(a) >= 4 and len(b) >= 4 and any(a):
            out[letter] = Klobuchar((a[0], a[1], a[2], a[3]), (b[0], b[1], b[2], b[3]))
    return out


def _numbers(text: str) -> tuple[float, ...]:
    """Return the numbers of a line; by their looks, since writers disagree about the columns."""
    return tuple(float(n.upper().replace("D", "E")) for n in _NUMBER.findall(text))
