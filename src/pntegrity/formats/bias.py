"""Code biases -> `CodeBiases`: Bias-SINEX (absolute and differential) and CODE's monthly .DCB files."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import sidereon

from pntegrity.errors import InputError
from pntegrity.formats._source import read_text
from pntegrity.physics.products import CodeBiases
from pntegrity.physics.time import DAY_NS, SECOND_NS, civil_to_ns, to_iso

__all__ = ["CodeBiases", "read_biases"]

_REFUSED = (sidereon.SidereonError, ValueError)
_HINT = "Give a Bias-SINEX file (.BIA, .BSX) or a monthly .DCB file of CODE"
_SATELLITE = re.compile(r"[GRECJIS]\d\d")
_LENIENT: Any = sidereon.BiasReadPolicy.LENIENT


def read_biases(paths: Sequence[Path | str] | Path | str, t_ns: int) -> CodeBiases:
    """Read the satellites' code biases that hold at one time; of a bias in two files the later file's counts.

    Parameters
    ----------
    paths : sequence of Path
        Plain or gzip. The content tells Bias-SINEX from CODE's table, whose title gives month and signals.
    t_ns : int
        A time of the log, ns of GPS time (the files' own scale, GPS time or UTC, is not told apart).

    Returns
    -------
    CodeBiases
        Biases of satellites; those of stations and of phases are left out.

    Raises
    ------
    InputError
        A file is missing or of another kind, or no file holds a bias for that time.
    """
    files = [Path(paths)] if isinstance(paths, str | Path) else [Path(p) for p in paths]
    if not files:
        raise InputError("no bias file given", hint=_HINT)
    notes: list[str] = []
    osb: dict[tuple[str, str], float] = {}
    dsb: dict[tuple[str, str, str], float] = {}
    reference: dict[str, tuple[str, str]] = {}
    sources = []
    for path in files:
        product = _parse(path, notes)
        records = _of_satellites(product, path, t_ns, notes)
        for r in records:
            if r.kind == "OSB":
                osb[r.target, r.obs1[1:]] = float(r.value)
            else:
                dsb[r.target, r.obs1[1:], r.obs2[1:]] = float(r.value)
        reference |= _clock_reference(product)
        sources.append(f"{path.name} ({len(records)} code biases)")
    if not osb and not dsb:
        raise InputError(
            f"no code bias of a satellite holds at {to_iso(t_ns)[:16].replace('T', ' ')}"
            f" ({'; '.join(notes) or 'the file holds none'})",
            path=files[0],
            hint="Give the file of that day or month",
        )
    return CodeBiases(osb, dsb, t_ns, reference, tuple(sources), tuple(notes))


def _parse(path: Path, notes: list[str]) -> Any:
    text = read_text(path)
    head = text[:400].upper()
    data = text.encode("ascii")
    try:
        if head.startswith("%=BIA"):
            parsed = sidereon.parse_bias_sinex_lossy(data, _LENIENT)
        elif "DCB SOLUTION" in head:
            parsed = sidereon.parse_code_dcb_lossy(data, None, _LENIENT)
        else:
            raise InputError("this is no file of code biases", path=path, line=1, hint=_HINT)
    except InputError:
        raise
    except _REFUSED as error:
        raise InputError(
            f"cannot be read ({str(error)[:120]})", path=path, hint="Download the bias file again"
        ) from None
    notes += [f"{path.name}: {n}" for n in _warnings(parsed, text)]
    return parsed.value


def _warnings(parsed: Any, text: str) -> list[str]:
    """Return notes about dropped records and an end that is missing."""
    notes = []
    if parsed.skip_count:
        notes.append(f"{parsed.skip_count} records dropped, they cannot be read")
    if text.startswith("%=BIA") and "%=ENDBIA" not in text[-400:].upper():
        notes.append("no '%=ENDBIA' line: the file may be cut off")
    return notes


def _of_satellites(product: Any, path: Path, t_ns: int, notes: list[str]) -> list[Any]:
    """Return the code biases of satellites that hold at a time, those that begin later last."""
    ours = [r for r in product.records if _SATELLITE.fullmatch(r.target)]
    code = [r for r in ours if not r.is_phase and r.unit == "ns"]
    valid = [r for r in code if _holds(r, t_ns)]
    if code and not valid:
        notes.append(f"{path.name}: all its biases are of another time ({_validity(code[0])})")
    if len(ours) > len(code):
        notes.append(f"{path.name}: {len(ours) - len(code)} phase biases left out")
    if any(r.slope for r in valid):
        notes.append(f"{path.name}: the biases' slopes are left out")
    return sorted(valid, key=lambda r: r.valid_from or (0, 0, 0))


def _day_ns(instant: tuple[int, int, int]) -> int:
    year, day_of_year, second = instant
    return civil_to_ns(year, 1, 1) + (day_of_year - 1) * DAY_NS + second * SECOND_NS


def _holds(record: Any, t_ns: int) -> bool:
    begin, end = record.valid_from, record.valid_until
    return (begin is None or _day_ns(begin) <= t_ns) and (end is None or t_ns <= _day_ns(end))


def _validity(record: Any) -> str:
    return " to ".join(
        to_iso(_day_ns(i))[:10] if i else "open" for i in (record.valid_from, record.valid_until)
    )


def _clock_reference(product: Any) -> dict[str, tuple[str, str]]:
    """Return the signals to which the clocks refer, by system letter."""
    letters = {
        "GPS": "G", "GLONASS": "R", "GALILEO": "E", "BEIDOU": "C", "QZSS": "J", "NAVIC": "I",
    }  # fmt: skip
    known = {sidereon.GnssSystem.__dict__[name]: letter for name, letter in letters.items()}
    return {
        known[system]: (a[1:], b[1:])
        for system, a, b in product.clock_reference
        if system in known and a and b
    }
