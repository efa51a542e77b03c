"""BLQ files of ocean loading -> `OceanLoading` of one station.

Our own parser: sidereon takes a block of one station, and refuses the centre-of-mass table that many files
begin with.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from pntegrity.errors import InputError
from pntegrity.formats._source import read_text
from pntegrity.physics.products import OceanLoading

__all__ = ["OceanLoading", "read_blq"]

_HINT = "Give a BLQ file of the ocean loading service (holt.oso.chalmers.se/loading)"
_NUMBERS = re.compile(r"\s*[-+]?\d*\.\d+(\s+[-+]?\d*\.\d*)+\s*")
_TIDES = ["M2", "S2", "N2", "K2", "K1", "O1", "P1", "Q1", "MF", "MM", "SSA"]
Block = tuple[str, int, list[str]]


def read_blq(path: Path | str, station: str) -> tuple[OceanLoading | None, tuple[str, ...]]:
    """Read the ocean loading of a station.

    Parameters
    ----------
    path : Path
        Plain or gzip.
    station : str
        Its name; case does not count, and of a nine-character name (``"ESBC00DNK"``) the first four do where
        the whole is not there.

    Returns
    -------
    loading : OceanLoading or None
        None where the file does not hold the station.
    notes : tuple of str
        Says so.

    Raises
    ------
    InputError
        The file is missing, holds no station, or the station's block is cut off or damaged.
    """
    path = Path(path)
    text = read_text(path)
    _check_columns(text, path)
    blocks = {name: (line, rows) for name, line, rows in reversed(_blocks(text))}
    if not any(rows for _, rows in blocks.values()):
        raise InputError("the file holds no station's ocean loading", path=path, hint=_HINT)
    wanted = station.strip().upper()
    name = next((n for n in (wanted, wanted[:4]) if n and n in blocks), None)
    if name is None:
        return None, (f"{path.name} holds no ocean loading for {station.strip()}",)
    table = _table(blocks[name][1], path, blocks[name][0])
    return OceanLoading(name, table[:3], table[3:]), ()


def _check_columns(text: str, path: Path) -> None:
    order = re.search(r"COLUMN ORDER:?((?:\s+\w+)+)", text[:5000].upper())
    if order and order[1].split()[:11] != _TIDES:
        raise InputError(f"its columns are {order[1].split()}, not {_TIDES}", path=path, hint=_HINT)


def _blocks(text: str) -> list[Block]:
    """Return name, line and rows of numbers of each station: rows follow a line with a name alone."""
    found: list[Block] = []
    for number, line in enumerate(text.splitlines(), start=1):
        if line.startswith("$$") or not line.strip():
            continue
        if _NUMBERS.fullmatch(line):
            if found:
                found[-1][2].append(line)
        elif line[0].isspace() and len(line.split()) <= 2:
            found.append((line.split()[0].upper(), number, []))
    return [block for block in found if block[2]]


def _table(rows: list[str], path: Path, line: int) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    values = [row.split() for row in rows[:6]]
    if [len(v) for v in values] != [11] * 6:
        raise InputError(
            "the station's block has not six rows of eleven numbers",
            path=path,
            line=line,
            hint="The file is damaged or cut off: get it again",
        )
    return np.array(values, dtype=np.float64)
