"""RINEX 2, 3 and 4 observation files, plain, CRINEX (Hatanaka) or gzip -> `SignalTable`.

Parsing is sidereon's (which also renames RINEX 2 codes: C1 -> C1C, P2 -> C2W). Its reader refuses a whole
file for one bad line; what it refuses is cut at the epoch headers and the bad pieces are left out, each with
a note (`_salvage`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pntegrity.errors import InputError
from pntegrity.formats._salvage import decode_crinex, parse_observations
from pntegrity.formats._source import read_text, rinex_first_line, with_decimal_version, without_cut_line
from pntegrity.physics.tables import SignalTable
from pntegrity.physics.time import BDT_OFFSET_NS, SECOND_NS, civil_to_ns, leap_seconds, to_iso

__all__ = ["SignalTable", "read_observations"]

EVENTS = {
    1: "power failure before the epoch",
    2: "antenna starts to move",
    3: "new site",
    4: "header records",
    5: "external event",
    6: "cycle slip records",
}
MAX_JUMP_NS = 366 * 86_400 * SECOND_NS
"""A time tag more than a year after the one before is taken as damaged."""
LAST_NS = 2**62
"""Later time tags (year 2126) are damaged."""
KINDS = "CLDS"
NO_TIME = "no such time"
MISFIT = "their values do not fit the header's list of types"


class _Epoch(NamedTuple):
    """One epoch as it is read: `values` and `lli` are those of each code of each satellite."""

    t_ns: int
    sats: list[str]
    values: npt.NDArray[np.float64]
    lli: npt.NDArray[np.float64]


@dataclass(frozen=True)
class _Block:
    """Epochs under one header segment: `sats` with `counts` an epoch, a value for each code of each."""

    t_ns: npt.NDArray[np.int64]
    counts: npt.NDArray[np.int64]
    sats: npt.NDArray[np.str_]
    values: npt.NDArray[np.float64]
    lli: npt.NDArray[np.float64]
    codes: dict[str, list[str]]


def read_observations(path: Path | str) -> SignalTable:
    """Read a RINEX observation file.

    Parameters
    ----------
    path : Path or str
        RINEX 2, 3 or 4, or CRINEX 1 or 3; gzip or plain, whatever the name says.

    Returns
    -------
    SignalTable
        Its `notes` tell everything that was dropped or repaired.

    Raises
    ------
    InputError
        No such file, not an observation file, or nothing usable in it.
    """
    path = Path(path)
    text = read_text(path)
    notes: list[str] = []
    text = without_cut_line(text, notes)
    if "CRINEX VERS" in text[:400]:
        text = decode_crinex(text, path, notes)
    _check_kind(text, path)
    text = with_decimal_version(text)
    pieces = parse_observations(text, path, notes)
    blocks = [b for obs in pieces for b in _blocks(obs, notes)]
    _note_orphans(text, pieces, notes)
    return _table(blocks, pieces[0].header, path, notes)


def _check_kind(text: str, path: Path) -> None:
    hint = "Give a RINEX 2, 3 or 4 observation file, for instance one made by RTKLIB's convbin"
    first = rinex_first_line(text, path, hint)
    if first[20:21].upper() != "O":
        raise InputError(
            f"this RINEX file holds {first[20:40].strip() or 'an unknown kind of data'!r}, not observations",
            path=path,
            line=1,
            hint="Give the observation file here and the navigation file as navigation",
        )


# --- from sidereon's product to blocks ----------------------------------------------------------------------


def _blocks(obs: Any, notes: list[str]) -> list[_Block]:
    if obs.skipped_records:
        notes.append(f"{obs.skipped_records} records that cannot be read were skipped")
    shift = _time_shift(obs.header)
    _note_events(obs.epochs, notes)
    segments = obs.header_timeline().segments()
    starts = [i for i, _ in segments] + [obs.epoch_count]
    return [
        _block(obs, range(starts[k], starts[k + 1]), h, shift, notes) for k, (_, h) in enumerate(segments)
    ]


def _block(obs: Any, indices: range, header: Any, shift: tuple[str, int], notes: list[str]) -> _Block:
    codes = {s.letter: header.obs_codes(s) for s in header.systems}
    width = {letter: len(c) for letter, c in codes.items()}
    bad: Counter[str] = Counter()
    read = [_epoch(obs, i, width, shift, bad) for i in indices]
    epochs = [e for e in read if e is not None]
    notes += [f"{bad[why]} epochs dropped: {why}" for why in (NO_TIME, MISFIT) if bad[why]]
    return _Block(
        np.array([e.t_ns for e in epochs], dtype=np.int64),
        np.array([len(e.sats) for e in epochs], dtype=np.int64),
        np.array([s for e in epochs for s in e.sats], dtype="<U3"),
        np.concatenate([e.values for e in epochs]) if epochs else np.zeros(0),
        np.concatenate([e.lli for e in epochs]) if epochs else np.zeros(0),
        codes,
    )


def _epoch(
    obs: Any, i: int, width: Mapping[str, int], shift: tuple[str, int], bad: Counter[str]
) -> _Epoch | None:
    """Return the i-th epoch; None where it is an event, or cannot be used: counted in `bad`."""
    epoch = obs.epoch(i)
    if epoch.flag > 1 or epoch.epoch is None:
        return None
    names, series = epoch.satellites, obs.observation_values(i)
    if len(series.values) != sum(width.get(s[0], 0) for s in names):
        bad[MISFIT] += 1
        return None
    t_ns = _epoch_ns(epoch.epoch, shift)
    if not 0 <= t_ns < LAST_NS:
        bad[NO_TIME] += 1
        return None
    return _Epoch(t_ns, names, series.values, series.lli)


def _time_shift(header: Any) -> tuple[str, int]:
    """Return the file's time scale and, for a fixed offset, what turns it into GPS time, ns."""
    first = header.time_of_first_obs
    letters = {s.letter for s in header.systems}
    default = {"R": "UTC", "C": "BDT"}.get("".join(letters), "GPST")
    scale = default if first is None else first[1].abbrev
    return scale, BDT_OFFSET_NS if scale == "BDT" else 0


def _epoch_ns(e: Any, shift: tuple[str, int]) -> int:
    """Return ns of GPS time, -1 where there is no such time."""
    try:
        t_ns = civil_to_ns(e.year, e.month, e.day, e.hour, e.minute, e.second) + shift[1]
    except (ValueError, OverflowError):
        return -1
    if shift[0] in ("UTC", "GLONASST"):  # RINEX: GLO tags are UTC, not Moscow time
        t_ns += leap_seconds(e.year, e.month, e.day) * SECOND_NS
    return t_ns


def _note_events(epochs: Sequence[Any], notes: list[str]) -> None:
    flags = [e.flag for e in epochs]
    for flag in sorted(set(flags) - {0}):
        n = flags.count(flag)
        kept = "noted" if flag == 1 else "skipped"
        notes.append(f"{n} event{'s' * (n > 1)} {kept}: {EVENTS.get(flag, f'unknown epoch flag {flag}')}")


def _note_orphans(text: str, pieces: Sequence[Any], notes: list[str]) -> None:
    """Note satellite lines that no epoch counts: sidereon passes them over in silence."""
    if pieces[0].header.version < 3 or len(pieces) > 1:
        return
    start = text.find("END OF HEADER")
    lines = sum(text.count("\n" + letter, start) for letter in "GRECJIS")
    epochs = pieces[0].epochs
    events = sum(len(e.special_records) + e.cycle_slip_count for e in epochs)
    orphans = lines - events - sum(e.satellite_count for e in epochs)
    if orphans > 0:
        notes.append(f"{orphans} satellite lines skipped: the count on their epoch line is too low")


# --- from blocks to the table -------------------------------------------------------------------------------


def _table(blocks: Sequence[_Block], header: Any, path: Path, notes: list[str]) -> SignalTable:
    t_ns, c = _joined(blocks, path, notes)
    keep = _rising(t_ns, notes)
    c = _sorted(c, keep, path)
    return SignalTable(
        t_ns=t_ns[keep],
        epoch=(np.cumsum(keep) - 1)[c["epoch"]].astype(np.int32),
        sat=_names(c["sat"], (16, 8, 0)),
        signal=_names(c["signal"], (8, 0)),
        pseudorange_m=c["C"],
        carrier_cycles=c["L"],
        doppler_hz=c["D"],
        cn0_dbhz=c["S"],
        lli=c["lli"].astype(np.int8),
        **_header_facts(header, t_ns[keep]),
        notes=tuple(notes),
        source=str(path),
    )


def _joined(
    blocks: Sequence[_Block], path: Path, notes: list[str]
) -> tuple[npt.NDArray[np.int64], dict[str, npt.NDArray[Any]]]:
    """Return the times of all blocks, and their rows as columns.

    Raises
    ------
    InputError
        No epochs, or nothing in them.
    """
    first = np.cumsum([0] + [len(b.t_ns) for b in blocks])
    if not first[-1]:
        raise InputError(
            "no epoch with observations in this file", path=path,
            hint="Is it cut off after its header? Log it again",
        )  # fmt: skip
    parts = [p for b, i in zip(blocks, first, strict=False) for p in _columns(b, int(i), notes)]
    if not parts:
        raise InputError(
            "every observation in this file is blank or zero, or of an unknown type", path=path,
            hint="Check the receiver's logging set-up and the header's TYPES records",
        )  # fmt: skip
    t_ns = np.concatenate([b.t_ns for b in blocks])
    return t_ns, {name: np.concatenate([p[name] for p in parts]) for name in parts[0]}


def _sorted(
    columns: Mapping[str, npt.NDArray[Any]], keep: npt.NDArray[np.bool_], path: Path
) -> dict[str, npt.NDArray[Any]]:
    """Return the rows of epochs to keep, by epoch, satellite and signal (InputError: there are none)."""
    used = np.flatnonzero(keep[columns["epoch"]])
    if not len(used):
        raise InputError("no epoch with both a time and observations", path=path, hint="Log it again")
    # Sorting by small integers: (epoch, satellite, signal) in one key.
    epoch, sat, signal = (columns[name][used] for name in ("epoch", "sat", "signal"))
    order = used[np.argsort((epoch << 40) | (sat << 16) | signal, kind="stable")]
    return {name: values[order] for name, values in columns.items()}


def _columns(block: _Block, first_epoch: int, notes: list[str]) -> list[dict[str, npt.NDArray[Any]]]:
    """Return for each system and signal of a block the rows that hold something, as columns."""
    epoch = first_epoch + np.repeat(np.arange(len(block.counts)), block.counts)
    points = block.sats.view(np.uint32).reshape(-1, 3).astype(np.int64)
    sat = (points[:, 0] << 16) | (points[:, 1] << 8) | points[:, 2]
    width = np.zeros(128, dtype=np.int64)
    for letter, codes in block.codes.items():
        width[ord(letter)] = len(codes)
    ends = np.cumsum(width[points[:, 0]])
    out: list[dict[str, npt.NDArray[Any]]] = []
    for letter, codes in block.codes.items():
        rows = np.flatnonzero(points[:, 0] == ord(letter))
        if not len(rows) or not codes:
            continue
        index = (ends[rows] - len(codes))[:, None] + np.arange(len(codes))
        grid, lli = block.values[index], block.lli[index]
        out += _signals(letter, codes, grid, lli, epoch[rows], sat[rows], notes)
    return out


def _signals(
    letter: str,
    codes: Sequence[str],
    grid: npt.NDArray[np.float64],
    lli: npt.NDArray[np.float64],
    epoch: npt.NDArray[np.int64],
    sat: npt.NDArray[np.int64],
    notes: list[str],
) -> list[dict[str, npt.NDArray[Any]]]:
    grid[grid == 0.0] = np.nan
    column = {_modern(letter, c): i for i, c in enumerate(codes)}
    out = []
    for signal in dict.fromkeys(c[1:] for c in column if len(c) == 3 and c[0] in KINDS):
        at = {k: column.get(k + signal) for k in KINDS}
        values = {k: np.full(len(epoch), np.nan) if i is None else grid[:, i] for k, i in at.items()}
        held = np.flatnonzero(~np.isnan(values["C"]) | ~np.isnan(values["L"]) | ~np.isnan(values["D"]))
        if not len(held):
            continue
        marks = np.zeros(len(held)) if at["L"] is None else np.nan_to_num(lli[held, at["L"]])
        code = (ord(signal[0]) << 8) | ord(signal[1])
        ids = {"epoch": epoch[held], "sat": sat[held], "signal": np.full(len(held), code, dtype=np.int64)}
        out.append(ids | {k: v[held] for k, v in values.items()} | {"lli": marks})
    odd = [c for c in codes if len(c) != 3 and np.any(~np.isnan(grid[:, column[c]]))]
    if odd:
        notes.append(f"{letter}: {', '.join(odd)} dropped, no such RINEX 3 signal is known for this system")
    return out


def _modern(letter: str, code: str) -> str:
    """Return the name of today: B1I was ``1I`` in RINEX 3.02, and is ``2I`` before and after."""
    return f"{code[0]}2{code[2]}" if letter == "C" and code[1:] in ("1I", "1Q") else code


def _names(codes: npt.NDArray[np.int64], shifts: tuple[int, ...]) -> npt.NDArray[np.str_]:
    """Return strings of character codes packed in integers."""
    points = np.stack([(codes >> s) & 0xFF for s in shifts], axis=1).astype(np.uint32)
    return np.ascontiguousarray(points).view(f"<U{len(shifts)}").reshape(-1)


def _rising(t_ns: npt.NDArray[np.int64], notes: list[str]) -> npt.NDArray[np.bool_]:
    """Return which epochs come later than all kept before them, and not absurdly later; note the others."""
    keep = np.ones(len(t_ns), dtype=bool)
    steps = np.diff(t_ns)
    if len(steps) and not np.all((steps > 0) & (steps < MAX_JUMP_NS)):
        last = int(np.median(t_ns)) - MAX_JUMP_NS
        for i, t in enumerate(t_ns.tolist()):
            keep[i] = last < t < last + 2 * MAX_JUMP_NS
            last = t if keep[i] else last
    dropped = np.flatnonzero(~keep)
    if len(dropped):
        at = to_iso(int(t_ns[dropped[0]]))
        notes.append(f"{len(dropped)} epochs dropped: their time repeats, goes back or jumps, first at {at}")
    return keep


def _header_facts(header: Any, t_ns: npt.NDArray[np.int64]) -> dict[str, Any]:
    position, delta = header.approx_position_m, header.antenna_delta_hen_m
    usable = (
        position is not None and bool(np.all(np.isfinite(position))) and float(np.linalg.norm(position)) > 1e6
    )
    interval = header.interval_s
    if not interval and len(t_ns) > 1:
        steps, n = np.unique(np.diff(t_ns), return_counts=True)
        interval = float(steps[np.argmax(n)]) / SECOND_NS
    return {
        "version": float(header.version),
        "marker": (header.marker_name or "").strip(),
        "receiver": (header.receiver_type or "").strip(),
        "antenna": (header.antenna_type or "").strip(),
        "approx_position_m": np.asarray(position, dtype=np.float64) if usable else None,
        "antenna_delta_hen_m": np.zeros(3) if delta is None else np.asarray(delta, dtype=np.float64),
        "interval_s": float(interval) if interval else None,
        "glonass_channels": {f"R{slot:02d}": channel for slot, channel in header.glonass_slots},
    }
