"""RINEX 2, 3 and 4 observation files, plain, CRINEX (Hatanaka) or gzip -> `SignalTable`.

Parsing is sidereon's. Its reader refuses a file for one bad line; what it refuses is cut at the epoch headers and the
bad pieces are left out, each with a note (see ``_salvage``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import sidereon

from pntegrity.errors import InputError
from pntegrity.formats._salvage import decode_crinex_prefix, parse_pieces
from pntegrity.formats._source import read_text
from pntegrity.physics.signals import rinex2_signal
from pntegrity.physics.tables import SignalTable
from pntegrity.physics.time import BDT_OFFSET_NS, civil_to_ns, leap_seconds, to_iso

__all__ = ["SignalTable", "read_observations"]

EVENTS = {
    2: "antenna starts to move",
    3: "new site",
    4: "header records",
    5: "external event",
    6: "cycle slip records",
}
MAX_STEP_NS = 10 * 365 * 86_400 * 10**9
"""A time tag that jumps by more than ten years is damaged."""
KINDS = "CLDS"


def read_observations(path: Path | str) -> SignalTable:
    """Read a RINEX observation file.

    Parameters
    ----------
    path : Path or str
        RINEX 2, 3 or 4, or CRINEX 1 or 3; gzip or plain, whatever the name says.

    Returns
    -------
    SignalTable
        With `notes` on everything that was dropped.

    Raises
    ------
    InputError
        No such file, not an observation file, or nothing usable in it.
    """
    path = Path(path)
    text = read_text(path)
    notes: list[str] = []
    if "CRINEX VERS" in text[:400]:
        text = decode_crinex_prefix(text, path, notes)
    _check_kind(text, path)
    pieces = _parse(text, path, notes)
    return _table(pieces, path, notes)


def _check_kind(text: str, path: Path) -> None:
    first = text[:81].split("\n", 1)[0]
    if "RINEX VERSION / TYPE" not in first:
        raise InputError(
            "this is not a RINEX file (its first line lacks 'RINEX VERSION / TYPE')",
            path=path,
            line=1,
            hint="Give a RINEX 2, 3 or 4 observation file, e.g. made with RTKLIB's convbin",
        )
    if first[20:21].upper() != "O" and "OBS" not in first[:40].upper():
        raise InputError(
            f"this RINEX file holds {first[20:40].strip().lower() or 'something'}, not observations",
            path=path,
            line=1,
            hint="Give the observation file here and the navigation file as navigation",
        )


def _parse(text: str, path: Path, notes: list[str]) -> list[Any]:
    try:
        obs = sidereon.parse_rinex_obs(text)
    except sidereon.SidereonError as error:
        return parse_pieces(text, path, notes, str(error))
    if obs.skipped_records:
        notes.append(f"{obs.skipped_records} lines that hold no readable observation were skipped")
    return [obs]


@dataclass(frozen=True)
class _Block:
    """Values of one header segment: rows of all systems side by side."""

    t_ns: npt.NDArray[np.int64]
    sats: list[list[str]]
    values: npt.NDArray[np.float64]
    lli: npt.NDArray[np.float64]
    header: Any


def _table(pieces: Sequence[Any], path: Path, notes: list[str]) -> SignalTable:
    blocks = [b for obs in pieces for b in _blocks(obs, path, notes)]
    if not any(len(b.t_ns) for b in blocks):
        raise InputError(
            "no epoch with observations in this file", path=path, hint="Is the log empty, or cut off after the header?"
        )
    counts = np.cumsum([0] + [len(b.t_ns) for b in blocks])
    t_all = np.concatenate([b.t_ns for b in blocks])
    keep = _forward(t_all, notes)
    new_index = np.cumsum(keep) - 1
    parts = [_columns(b, first) for b, first in zip(blocks, counts, strict=False)]
    columns = {name: np.concatenate([p[name] for p in parts]) for name in parts[0]}
    used = keep[columns["epoch"]] & _holds_something(columns)
    columns = {name: values[used] for name, values in columns.items()}
    columns["epoch"] = new_index[columns["epoch"]].astype(np.int32)
    return _assemble(t_all[keep], columns, blocks[0].header, path, notes)


def _holds_something(columns: dict[str, Any]) -> npt.NDArray[np.bool_]:
    given: npt.NDArray[np.bool_] = ~np.isnan(columns["C"]) | ~np.isnan(columns["L"]) | ~np.isnan(columns["D"])
    return given


def _assemble(
    t_ns: npt.NDArray[np.int64], columns: dict[str, Any], header: Any, path: Path, notes: list[str]
) -> SignalTable:
    if not len(columns["epoch"]):
        raise InputError("no observation in this file is a number other than zero", path=path, hint="Log it again")
    order = np.lexsort((columns["signal"], columns["sat"], columns["epoch"]))
    c = {name: values[order] for name, values in columns.items()}
    return SignalTable(
        t_ns=t_ns,
        epoch=c["epoch"],
        sat=c["sat_names"],
        signal=c["signal_names"],
        pseudorange_m=c["C"],
        carrier_cycles=c["L"],
        doppler_hz=c["D"],
        cn0_dbhz=c["S"],
        lli=c["lli"],
        **_header_facts(header, t_ns),
        notes=tuple(notes),
    )
