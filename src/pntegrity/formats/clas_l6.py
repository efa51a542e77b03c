"""Raw QZSS L6 messages of CLAS -> `ClasCorrections`, decoded by cssrlib (an optional extra).

The file holds the messages of 250 bytes as they were sent, one a second, error-corrected, without time tags:
archives of the service and loggers of L6 write it. What is returned is what a receiver at one place had at
hand when each sub-frame of five seconds was complete.
"""

from __future__ import annotations

import importlib
import io
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from pntegrity.errors import InputError
from pntegrity.formats._source import read_bytes
from pntegrity.formats.clas import Row, read_clas, series, unknown_in_words
from pntegrity.physics.ssr_corrections import ClasCorrections
from pntegrity.physics.tables import SignalTable
from pntegrity.physics.time import WEEK_NS, from_week_tow, to_week_tow

__all__ = ["EXTRA", "corrections_for", "read_l6"]

EXTRA = "pip install 'pntegrity[clas]'"
FRAME, PREAMBLE = 250, b"\x1a\xcf\xfc\x1d"
SUBFRAME_S, SUBFRAME_FRAMES, WEEK_S = 5, 5, 604_800
ALERT = 0x80
"""First bit after preamble, satellite number and message type: do not use."""


def corrections_for(
    table: SignalTable, paths: Sequence[Path | str], grid: Path | str | None = None,
    receiver_m: npt.ArrayLike | None = None,
) -> ClasCorrections:  # fmt: skip
    """Read the corrections for a log, decoded files or one raw file, told by content.

    Parameters
    ----------
    table : SignalTable
        Tells week and end of the log, and where the receiver is.
    paths : sequence of Path
        Decoded CSV files, or one file of L6 messages.
    grid : Path, optional
        Definition of the grid points, needed with a raw file.
    receiver_m : array, shape (3,), optional
        ECEF, good to a kilometre; the position in the log's header where not given.

    Raises
    ------
    InputError
        As `clas.read_clas` and `read_l6`; a raw file with others, without the grid or a position.
    """
    raw = [p for p in paths if read_bytes(p).find(PREAMBLE, 0, 2 * FRAME) >= 0]
    if not raw:
        return read_clas(paths)
    place = table.approx_position_m if receiver_m is None else receiver_m
    if len(paths) > 1:
        raise InputError("a file of L6 messages goes alone", path=raw[0], hint="Join raw files end to end")
    if grid is None:
        raise InputError(
            "raw L6 messages need the grid's definition",
            path=raw[0],
            hint="Give clas_grid.def of the service",
        )
    if place is None:
        raise InputError(
            "the log does not tell where the receiver is",
            path=table.source,
            hint="Give a position good to a kilometre",
        )
    week = to_week_tow(int(table.t_ns[0]))[0]
    return read_l6(raw[0], grid, week, place, end_ns=int(table.t_ns[-1]))


@dataclass
class _Decoded:
    """Rows by satellite and time, zenith delays by time, and what was left out."""

    satellites: dict[str, dict[int, Row]] = field(default_factory=dict)
    troposphere: dict[int, tuple[float, float]] = field(default_factory=dict)
    dropped: Counter[str] = field(default_factory=Counter)


def read_l6(
    path: Path | str, grid: Path | str, week: int, receiver_m: npt.ArrayLike, end_ns: int | None = None
) -> ClasCorrections:
    """Decode a file of L6 messages for one place.

    Parameters
    ----------
    path : Path
        Messages of one satellite and signal (L6D), plain or gzip.
    grid : Path
        Definition of CLAS's grid points (``clas_grid.def``), plain.
    week : int
        GPS week of the first message, which the messages do not tell.
    receiver_m : array, shape (3,)
        ECEF, good to a kilometre: network and grid points are chosen by it.
    end_ns : int, optional
        Nothing after it is decoded, ns of GPS time. An hour takes about 20 s.

    Returns
    -------
    ClasCorrections
        As `clas.read_clas` reads them of decoded files.

    Raises
    ------
    InputError
        cssrlib is not installed, a file is missing or of another kind, no message can be used, or the place
        is in none of CLAS's networks.
    """
    path, place = Path(path), np.asarray(receiver_m, dtype=np.float64)
    if not 0 <= week < 10_000:
        raise ValueError(f"`week` must be a full GPS week number, not {week}")
    if place.shape != (3,) or not np.isfinite(place).all():
        raise ValueError("`receiver_m` must be an ECEF position of shape (3,)")
    library = _library()
    data = read_bytes(path)
    decoder = _decoder(library, Path(grid), week, place)
    found = _Decoded()
    with redirect_stdout(io.StringIO()):  # it reports to the terminal
        for t_ns in _subframes(decoder, data, path, week, found.dropped):
            if end_ns is not None and t_ns > end_ns:
                break
            _take(decoder, library, t_ns, found)
    return _corrections(decoder, path, found)


def _library() -> Any:
    """Return cssrlib's modules, joined."""
    try:
        parts = [importlib.import_module(f"cssrlib.{name}") for name in ("cssrlib", "gnss")]
    except ImportError as error:
        raise InputError(
            f"raw L6 messages are decoded by cssrlib, which is not here ({error})",
            hint=f"Install it ({EXTRA}), or give decoded CSV files",
        ) from None
    return parts


def _decoder(library: Any, grid: Path, week: int, place: npt.NDArray[np.float64]) -> Any:
    messages, gnss = library
    decoder = messages.cssr()
    decoder.week = week
    _check_grid(grid)
    decoder.read_griddef(str(grid))
    geodetic = gnss.ecef2pos(place)
    decoder.find_grid_index(geodetic)
    near = decoder.grid[decoder.grid["nid"] == decoder.inet_ref]
    away = np.hypot(near["lat"] - math.degrees(geodetic[0]), near["lon"] - math.degrees(geodetic[1])).min()
    if away > 1.0:  # grid points are 60 km apart
        raise InputError(
            f"the receiver is {away:.0f} degrees away from the next grid point",
            path=grid,
            hint="CLAS serves Japan; check the receiver's position",
        )
    decoder.offset_deg = decoder.get_dpos(geodetic)
    return decoder


def _check_grid(path: Path) -> None:
    head = read_bytes(path)[:200].decode("ascii", "replace")
    rows = head.splitlines()
    if len(rows) < 2 or "GRID" not in rows[0].upper() or len(rows[1].split()) != 5:
        raise InputError(
            "this is no grid definition of CLAS", path=path, line=1, hint="Give clas_grid.def, unpacked"
        )


def _subframes(decoder: Any, data: bytes, path: Path, week: int, dropped: Counter[str]) -> Iterator[int]:
    """Feed messages; yield the time at which each whole sub-frame was there, ns of GPS time."""
    last = -1
    for frame in _frames(data, path, dropped):
        whole = _fed(decoder, frame)
        if whole is False:
            dropped["sub-frame cannot be decoded"] += 1
        if not whole:
            continue
        t_ns = int(from_week_tow(week, decoder.tow + SUBFRAME_S))
        while t_ns < last - WEEK_NS // 2:
            t_ns += WEEK_NS
        if t_ns > last:
            last = t_ns
            yield t_ns


def _fed(decoder: Any, frame: bytes) -> bool | None:
    """Feed a message; return True with a whole sub-frame, None within one, False where it is damaged.

    Damaged messages can break the decoder anywhere; all kinds of corrections must then come anew.
    """
    try:
        decoder.decode_l6msg(frame, 0)
        if decoder.fcnt != SUBFRAME_FRAMES:
            return None
        if decoder.decode_cssr(decoder.buff, 0) != 0 and 0 <= decoder.tow < WEEK_S:
            return True
    except Exception:  # KeyError, IndexError, its bit reader's own
        decoder.fcnt = -1
    for part in decoder.lc:
        part.cstat = 0
    return False


def _frames(data: bytes, path: Path, dropped: Counter[str]) -> Iterator[bytes]:
    """Yield messages from one preamble to the next; those with the alert flag are left out."""
    at = data.find(PREAMBLE)
    if at < 0:
        raise InputError(
            "no L6 message in this file (no preamble 1ACFFC1D)",
            path=path,
            hint="Give messages of 250 bytes each",
        )
    while 0 <= at <= len(data) - FRAME:
        frame = data[at : at + FRAME]
        if frame[6] & ALERT:
            dropped["message with the alert flag"] += 1
        else:
            yield frame
        following = data.find(PREAMBLE, at + FRAME)
        if following > at + FRAME:
            dropped["bytes between messages"] += following - at - FRAME
        at = following


def _take(decoder: Any, library: Any, t_ns: int, found: _Decoded) -> None:
    """Add what the decoder holds of the network's satellites, where nothing is missing."""
    if not decoder.chk_stat():
        found.dropped["sub-frame before all kinds of corrections were there"] += 1
        return
    local, common = decoder.lc[decoder.inet_ref], decoder.lc[0]
    found.troposphere[t_ns] = tuple(float(v) for v in decoder.get_trop(*decoder.offset_deg))  # type: ignore[assignment]
    contents = dict(zip(local.sat_n, decoder.get_stec(*decoder.offset_deg).tolist(), strict=True))
    for number, stec in contents.items():
        if number not in common.dorb or number not in common.dclk or number not in common.iode:
            continue
        name = library[1].sat2id(number)
        numbers = (*common.dorb[number], common.dclk[number], decoder.ura.get(number, math.nan), stec)
        quality = local.stec_quality.get(number, math.nan)
        code, phase = (_biases(common, local, kind, number) for kind in ("cbias", "pbias"))
        row = Row(int(common.iode[number]), tuple(float(v) for v in (*numbers, quality)), code, phase)
        found.satellites.setdefault(name, {})[t_ns] = row


def _biases(common: Any, local: Any, kind: str, number: int) -> Mapping[str, float]:
    """Return the biases of a satellite by signal, those of the network on top of the common ones."""
    total: dict[str, float] = {}
    for part in (common, local):
        for signal, value in ((getattr(part, kind) or {}).get(number) or {}).items():
            name = str(signal)[-2:]
            total[name] = total.get(name, 0.0) + float(value)
    return total


def _corrections(decoder: Any, path: Path, found: _Decoded) -> ClasCorrections:
    if not found.satellites:
        why = ", ".join(f"{what}: {n}" for what, n in found.dropped.items()) or "no whole sub-frame"
        raise InputError(
            f"no corrections could be decoded ({why})",
            path=path,
            hint="At least 30 s of one signal are needed",
        )
    satellites = {sat: series(rows) for sat, rows in sorted(found.satellites.items())}
    times = np.array(sorted(found.troposphere), dtype=np.int64)
    delays = np.array([found.troposphere[t] for t in times.tolist()])
    notes = [f"{path.name}: {what}: {n}" for what, n in found.dropped.items()]
    return ClasCorrections(
        satellites, times, delays[:, 0], delays[:, 1], int(decoder.inet_ref), (path.name,),
        (*notes, *unknown_in_words(satellites)),
    )  # fmt: skip
