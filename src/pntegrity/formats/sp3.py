"""SP3 files (a to d) -> `PreciseOrbits`: several days, and centres, joined; with their clock columns."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import sidereon

from pntegrity.errors import InputError
from pntegrity.formats._source import read_text
from pntegrity.physics.products import PreciseClocks, PreciseOrbits, most_frequent_step_s
from pntegrity.physics.time import (
    BDT_OFFSET_NS,
    DAY_NS,
    SECOND_NS,
    from_j2000_s,
    leap_seconds,
    to_iso,
    to_j2000_s,
)

__all__ = ["PreciseOrbits", "civil_to_gps_ns", "clock_series", "read_orbits"]

_REFUSED = (sidereon.SidereonError, ValueError)
_HINT = "Give an SP3 file of orbits: a final or rapid product of IGS or one of its centres"
_TAI_OFFSET_NS = -19 * SECOND_NS
IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class _File:
    """One file: samples in GPS time by (satellite, time), clocks likewise, and jumps of the clocks."""

    name: str
    agency: str
    frame: str
    interval_s: float
    samples: dict[tuple[str, int], Any]
    clocks: dict[tuple[str, int], float]
    jumps: set[tuple[str, int]]

    @property
    def span(self) -> tuple[int, int]:
        times = [t for _, t in self.samples]
        return min(times), max(times)


def read_orbits(paths: Sequence[Path | str] | Path | str) -> PreciseOrbits:
    """Read one or several SP3 files into one store; of an epoch in two files the later file's record counts.

    Parameters
    ----------
    paths : sequence of Path
        Plain or gzip, in any order. Days may be missing: nothing is interpolated across.

    Returns
    -------
    PreciseOrbits
        Positions and clocks in GPS time; its `notes` tell what was left out.

    Raises
    ------
    InputError
        A file is missing, cut off or no SP3 file, or all files together hold no position.
    """
    files = [Path(paths)] if isinstance(paths, str | Path) else [Path(p) for p in paths]
    if not files:
        raise InputError("no orbit file given", hint=_HINT)
    notes: list[str] = []
    parts = [_read(path, notes) for path in files]
    parts = sorted((p for p in parts if p.samples), key=lambda p: p.span)
    if not parts:
        raise InputError("no satellite has a position", path=files[0], hint="Give another SP3 file")
    notes += _differences(parts)
    return _joined(parts, tuple(notes))


def _read(path: Path, notes: list[str]) -> _File:
    text = read_text(path)
    if not re.match(r"#[a-d][PV]", text):
        raise InputError("this is not an SP3 file (it begins otherwise)", path=path, line=1, hint=_HINT)
    try:
        product = sidereon.load_sp3(text.encode("ascii"))
    except _REFUSED as error:
        raise InputError(
            f"cannot be read ({str(error)[:160]})",
            path=path,
            line=_line_of(text, str(error)),
            hint="The file is damaged or cut off: download it again",
        ) from None
    notes += _completeness(text, product, path)
    header = product.header
    shift = _to_gps(product.epochs_j2000_seconds, header.time_system)
    samples, clocks, jumps = _samples(product, shift)
    interval = float(header.epoch_interval_s)
    return _File(
        path.name,
        header.agency.strip(),
        header.coordinate_system.strip(),
        interval,
        samples,
        clocks,
        jumps,
    )


def _line_of(text: str, message: str) -> int | None:
    """Return the line that a message of sidereon quotes."""
    quoted = re.search(r'in "(.{20,})"', message)
    at = text.find(quoted[1]) if quoted else -1
    return text.count("\n", 0, at) + 1 if at >= 0 else None


def _completeness(text: str, product: Any, path: Path) -> list[str]:
    """Return notes about lost and predicted records.

    Raises
    ------
    InputError
        The file ends early.
    """
    ended = text.rstrip().endswith("EOF")
    if product.epoch_count < product.declared_epoch_count and not ended:
        raise InputError(
            f"the file is cut off: {product.epoch_count} of {product.declared_epoch_count} epochs, no 'EOF'",
            path=path,
            hint="Download it again",
        )
    notes = [] if ended else [f"{path.name}: no 'EOF' line, the last epoch may lack satellites"]
    if product.epoch_count != product.declared_epoch_count:
        counts = f"{product.epoch_count} epochs, {product.declared_epoch_count} announced"
        notes.append(f"{path.name}: {counts}")
    if product.skipped_records:
        notes.append(f"{path.name}: {product.skipped_records} records of unknown satellites left out")
    predicted = [e for e in product.prediction_summary().epochs if e.orbit_predicted_satellites]
    if predicted:
        notes.append(f"{path.name}: orbits at {len(predicted)} of {product.epoch_count} epochs are predicted")
    return notes


def civil_to_gps_ns(t_ns: int, label: str) -> int:
    """Return what to add to a time of another scale, its calendar read as GPS time, to get GPS time, ns.

    Parameters
    ----------
    t_ns : int
        The calendar time as ns since 1980-01-06.
    label : str
        ``"GPS"``, ``"GAL"``, ``"QZS"``, ``"BDT"``/``"BDS"``, ``"TAI"``, or ``"UTC"``/``"GLO"`` (both UTC).

    Raises
    ------
    ValueError
        Another scale.
    """
    fixed = {"GPS": 0, "GAL": 0, "QZS": 0, "IRN": 0, "TAI": _TAI_OFFSET_NS}
    fixed |= {"BDT": BDT_OFFSET_NS, "BDS": BDT_OFFSET_NS}
    if label in fixed:
        return fixed[label]
    if label not in ("UTC", "GLO"):
        raise ValueError(f"unknown time scale {label!r}")
    year, month, day = (int(n) for n in to_iso(t_ns // DAY_NS * DAY_NS)[:10].split("-"))
    return leap_seconds(year, month, day) * SECOND_NS


def _to_gps(epochs_j2000_s: Any, label: str) -> dict[int, int]:
    """Return GPS time of each epoch of a file by its calendar time, both in ns."""
    civil = from_j2000_s(epochs_j2000_s).tolist()
    return {t: t + civil_to_gps_ns(t, label) for t in civil}


def _samples(
    product: Any, gps: dict[int, int]
) -> tuple[dict[tuple[str, int], Any], dict[tuple[str, int], float], set[tuple[str, int]]]:
    """Return positions, clocks (also of records without a position) and jumps, by satellite and time."""
    samples, clocks, jumps = {}, {}, set()
    given = product.precise_ephemeris_samples()
    # sidereon's seconds come from a day's fraction and are off by up to 0.1 us: rounded, then given back.
    times = from_j2000_s([s.epoch_j2000_seconds for s in given]).tolist()
    for s, t in zip(given, times, strict=True):
        key = s.satellite, gps[t]
        samples[key] = _in_gps_time(s, key)
        if s.clock_s is not None:
            clocks[key] = s.clock_s
        if s.clock_event:
            jumps.add(key)
    for k, t in enumerate(from_j2000_s(product.epochs_j2000_seconds).tolist()):
        for sat, record in product.clock_records_at(k).items():
            clocks[sat, gps[t]] = record.clock_s
            if record.clock_event:
                jumps.add((sat, gps[t]))
    return samples, clocks, jumps


def _in_gps_time(sample: Any, key: tuple[str, int]) -> Any:
    return sidereon.PreciseEphemerisSample(
        key[0], float(to_j2000_s(key[1])), sample.position_ecef_m, sample.clock_s
    )


def _differences(parts: Sequence[_File]) -> list[str]:
    """Return notes about files of different centres, frames or intervals, and doubled epochs."""
    notes = []
    for a, b in pairwise(parts):
        if (a.agency, a.frame) != (b.agency, b.frame):
            notes.append(
                f"{a.name} is of {a.agency} in {a.frame}, {b.name} of {b.agency} in {b.frame}: "
                f"their datum may differ by cm, and their clocks by more"
            )
        if a.interval_s != b.interval_s:
            notes.append(
                f"{a.name} has {a.interval_s:g} s between epochs, {b.name} {b.interval_s:g} s: "
                f"nothing is interpolated in the coarser file"
            )
        double = len({t for _, t in a.samples} & {t for _, t in b.samples})
        if double > 1:
            notes.append(f"{a.name} and {b.name} share {double} epochs: those of {b.name} are taken")
    return notes


def _joined(parts: Sequence[_File], notes: tuple[str, ...]) -> PreciseOrbits:
    samples = {k: v for p in parts for k, v in p.samples.items()}
    clocks = {k: v for p in parts for k, v in p.clocks.items()}
    jumps = {k: 1.0 for p in parts for k in p.jumps}
    ordered = sorted(samples)
    nodes = {sat: t for sat, (t, _) in clock_series(dict.fromkeys(ordered, 0.0)).items()}
    series = clock_series(clocks)
    agency = "/".join(dict.fromkeys(p.agency for p in parts))
    sources = tuple(_source(p) for p in parts)
    without = sorted(set(nodes) - set(series))
    if without:
        notes += (f"no clock at all for {', '.join(without)}",)
    t_ns = np.unique(np.array([t for _, t in ordered], dtype=np.int64))
    return PreciseOrbits(
        interpolant=sidereon.PreciseEphemerisInterpolant.from_samples([samples[k] for k in ordered]),
        sats=tuple(sorted(nodes)),
        t_ns=t_ns,
        nodes=nodes,
        clocks=PreciseClocks(
            series=series,
            interval_s=most_frequent_step_s(t for t, _ in series.values()),
            kind="SP3",
            agency=agency,
            sources=sources,
            notes=notes,
            breaks={sat: t for sat, (t, _) in clock_series(jumps).items()},
        ),
        interval_s=most_frequent_step_s(nodes.values()),
        agency=agency,
        frame="/".join(dict.fromkeys(p.frame for p in parts)),
        sources=sources,
        notes=notes,
    )


def clock_series(values: dict[tuple[str, int], float]) -> dict[str, tuple[IntArray, npt.NDArray[np.float64]]]:
    """Return times and values of each satellite, rising in time, from values by satellite and time."""
    rows: dict[str, list[tuple[int, float]]] = {}
    for (sat, t), value in sorted(values.items()):
        rows.setdefault(sat, []).append((t, value))
    return {
        sat: (np.array([t for t, _ in pairs], dtype=np.int64), np.array([v for _, v in pairs]))
        for sat, pairs in rows.items()
    }


def _source(part: _File) -> str:
    first, last = (to_iso(t)[:16].replace("T", " ") for t in part.span)
    systems = "".join(sorted({sat[0] for sat, _ in part.samples}, key=lambda s: ("GRECJ".find(s) % 99, s)))
    return f"{part.name} ({part.agency}, {systems}, {first} to {last})"
