"""Profiles of the speed of sound: a table of depth and speed, CSV or blanks, plain or gzip ->
`SoundSpeed`.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from pntegrity.errors import InputError
from pntegrity.formats._source import read_text
from pntegrity.physics.acoustics import SoundSpeed

__all__ = ["read_profile"]

HINT = "Two columns, depth (m) and sound speed (m/s); a header, if there is one, names depth first"
#: What Sea-Bird's software writes for a bad value.
BAD = -9.99e-29
DEPTHS = ("depth", "depth_m", "z", "z_m")


def read_profile(
    path: Path | str, *, reach_m: float | None = None, extend: bool = False, notes: list[str] | None = None
) -> SoundSpeed:
    """Read a profile of the speed of sound.

    Parameters
    ----------
    path : Path or str
        Two columns, depth (m, positive down or all negative) and speed (m/s), separated by comma, semicolon
        or blanks; lines that begin with ``#`` and one header line are skipped. Rows are sorted by depth; of
        rows at one depth the first counts.
    reach_m : float, optional
        Depth that it must reach.
    extend : bool
        Whether a profile that ends above goes on with the gradient of its last 100 m.
    notes : list of str, optional
        Gets how many rows that Sea-Bird's bad value marks were dropped.

    Raises
    ------
    InputError
        No such file, a line that is no pair of numbers, speeds that are not those of water, or a profile that
        does not reach `reach_m`, with both depths.
    """
    path = Path(path)
    rows = _pairs(read_text(path), path)
    bad = (rows == BAD).any(axis=1)
    if bad.any() and notes is not None:
        notes.append(f"{path.name}: {int(bad.sum())} rows marked as bad dropped")
    rows = rows[~bad]
    z, first = np.unique(np.abs(rows[:, 0]) if (rows[:, 0] <= 0.0).all() else rows[:, 0], return_index=True)
    try:
        profile = SoundSpeed(z, rows[first, 1])
        if reach_m is not None:
            profile = profile.extended(reach_m) if extend else profile
            profile.check(reach_m, "what must be reached")
    except ValueError as error:
        raise InputError(str(error), path=path, hint=HINT) from None
    return profile


def _pairs(text: str, path: Path) -> np.ndarray:
    out: list[list[float]] = []
    seen = False
    for number, line in enumerate(text.splitlines(), 1):
        cells = [c for c in re.split(r"[,;\s]+", line.strip()) if c]
        if not cells or line.lstrip().startswith("#"):
            continue
        header, seen = not seen, True
        try:
            out.append([float(c) for c in cells[:2]])
            if len(cells) < 2 or not np.isfinite(out[-1]).all():
                raise ValueError("not two numbers")
        except ValueError:
            if header and re.match(r"[A-Za-z]", cells[0]):
                _check_header(cells, path, number)
                continue
            raise InputError(
                f"{line.strip()[:60]!r} is no depth and sound speed", path=path, line=number, hint=HINT
            ) from None
    if not out:
        raise InputError("no row with a depth and a sound speed", path=path, hint=HINT)
    return np.array(out)


def _check_header(cells: list[str], path: Path, line: int) -> None:
    name = re.sub(r"\(.*", "", cells[0]).lower()
    if name not in DEPTHS:
        raise InputError(f"the first column is called {cells[0]!r}", path=path, line=line, hint=HINT)
