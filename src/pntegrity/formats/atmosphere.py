"""Products of the atmosphere: CSV, plain or gzip, or Parquet <-> `AtmosphereProducts`.

Columns: ``time`` (GPS time, ISO), ``quantity`` (``stec``, ``zwd`` or ``ztd``), ``satellite`` (``G05``; empty
for the troposphere), ``value`` and ``sigma`` (TECU, or metres for the troposphere). Lines ``# name = value``
at the top of a CSV file, or the metadata of a Parquet file, hold ``source``, ``self_derived``, ``latency_s``
and ``interval_s``.
"""

from __future__ import annotations

import gzip
import io
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np
import polars as pl

from pntegrity.errors import InputError
from pntegrity.formats._source import read_bytes, read_text, without_cut_line
from pntegrity.formats.atomic import atomically
from pntegrity.physics.atmosphere_products import AtmosphereProducts, Kind, Samples
from pntegrity.physics.time import from_iso, to_iso

__all__ = ["COLUMNS", "read_atmosphere", "write_atmosphere"]

COLUMNS = ("time", "quantity", "satellite", "value", "sigma")
PARQUET_MAGIC = b"PAR1"
HINT = f"Columns are {','.join(COLUMNS)}; see the page on products of the atmosphere"
LATEST_NS = 2**62
_SATELLITE = re.compile(r"[GRECJIS]\d\d")
_TRUE, _FALSE = ("true", "yes", "1"), ("false", "no", "0", "")


# --- reading ----------------------------------------------------------------------------------------------


@dataclass(eq=False)
class _Table:
    """Rows read so far, by product; numbers of the lines that were dropped, by cause; further notes."""

    path: Path
    samples: dict[str, list[tuple[int, float, float]]] = field(default_factory=dict)
    bad: dict[str, list[int]] = field(default_factory=dict)
    told: list[str] = field(default_factory=list)
    kind: str = ""

    def add(self, line: int, cells: Sequence[str]) -> None:
        """Take the cells of a row, in the order of `COLUMNS`.

        Raises
        ------
        InputError
            Zenith delays of the other kind than before.
        """
        time, quantity, sat, value, sigma = cells
        quantity = quantity.lower()
        reason = _wrong(quantity, sat)
        if not reason:
            try:
                sample = _time(time), float(value), float(sigma)
            except ValueError:
                reason = "time, value or sigma cannot be read"
            else:
                reason = "" if np.isfinite(sample[1]) else "value is not finite"
                reason = reason or ("" if 0.0 < sample[2] < np.inf else "sigma is not finite and above 0")
        if reason:
            self.bad.setdefault(reason, []).append(line)
            return
        self._check_kind(line, quantity)
        self.samples.setdefault(sat, []).append(sample)

    def _check_kind(self, line: int, quantity: str) -> None:
        if quantity == "stec":
            return
        if self.kind and quantity != self.kind:
            raise InputError(
                f"zenith delays of two kinds: {self.kind} before, here {quantity}",
                path=self.path, line=line, hint="Give the wet delay (zwd) or the total one (ztd), not both",
            )  # fmt: skip
        self.kind = quantity

    def notes(self) -> list[str]:
        """Return what was dropped: counts, causes, first lines."""
        out = [f"{self.path.name}: {note}" for note in self.told]
        for reason, lines in self.bad.items():
            first = ", ".join(map(str, lines[:3])) + (", ..." if len(lines) > 3 else "")
            out.append(f"{self.path.name}: {len(lines)} lines dropped: {reason}; line {first}")
        return out


def _wrong(quantity: str, sat: str) -> str:
    if quantity == "stec":
        return "" if _SATELLITE.fullmatch(sat) else "no such satellite"
    if quantity not in ("zwd", "ztd"):
        return "unknown quantity (stec, zwd and ztd are known)"
    return "zenith delay with a satellite" if sat else ""


@lru_cache(maxsize=4096)
def _time(text: str) -> int:
    t_ns = from_iso(text)
    if not 0 <= t_ns < LATEST_NS:
        raise ValueError("time before 1980 or absurd")
    return t_ns


def read_atmosphere(path: Path | str) -> AtmosphereProducts:
    """Read products of the atmosphere.

    Parameters
    ----------
    path : Path or str
        CSV, plain or gzip, or Parquet: told by content, not by name.

    Returns
    -------
    AtmosphereProducts
        Lines that cannot be used are dropped; its notes count them by cause and name the first.

    Raises
    ------
    InputError
        No such file, other columns, zenith delays of both kinds, or nothing that can be used.
    """
    path = Path(path)
    data = read_bytes(path)
    table = _Table(path)
    facts = _read_parquet(table, data) if data.startswith(PARQUET_MAGIC) else _read_csv(table)
    return _products(table, facts)


def _read_csv(table: _Table) -> Mapping[str, str]:
    """Fill the table, return what the comments say."""
    text = without_cut_line(read_text(table.path), table.told)
    facts: dict[str, str] = {}
    pick: list[int] = []
    mark, width = ",", 0
    for number, line in enumerate(text.splitlines(), 1):
        if line.startswith("#"):
            name, _, value = line.lstrip("# ").partition("=")
            facts[name.strip()] = value.strip()
        elif line.strip() and not pick:
            mark = max(",;\t", key=line.count)
            names = line.split(mark)
            pick, width = _columns(names, table.path, number), len(names)
        elif line.strip():
            cells = [c.strip().strip('"') for c in line.split(mark)]
            if len(cells) == width:
                table.add(number, [cells[i] for i in pick])
            else:
                table.bad.setdefault(f"{width} cells expected", []).append(number)
    if not pick:
        raise InputError("the file holds nothing but comments", path=table.path, hint=HINT)
    return facts


def _columns(names: Sequence[str], path: Path, line: int | None = None) -> list[int]:
    """Return where the columns stand."""
    plain = [n.strip().strip('"').lower() for n in names]
    missing = [n for n in COLUMNS if n not in plain]
    if missing:
        raise InputError(
            f"no column {', '.join(missing)} among {', '.join(plain)[:120]}", path=path, line=line, hint=HINT
        )
    return [plain.index(n) for n in COLUMNS]


def _read_parquet(table: _Table, data: bytes) -> Mapping[str, str]:
    """Fill the table, return the metadata; `line` in what is told is the row, from 1."""
    try:
        frame = pl.read_parquet(io.BytesIO(data))
        facts = pl.read_parquet_metadata(io.BytesIO(data))
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError, ValueError) as error:
        reason = str(error).partition("\n")[0][:120]
        raise InputError(
            f"the Parquet file is damaged ({reason})", path=table.path, hint="Download or make it again"
        ) from None
    chosen = frame.select([frame.columns[i] for i in _columns(frame.columns, table.path)])
    texts = [_as_text(column) for column in chosen.get_columns()]
    for number, cells in enumerate(zip(*texts, strict=True), 1):
        table.add(number, cells)
    return facts


def _as_text(column: pl.Series) -> list[str]:
    if column.dtype.is_temporal():
        column = column.dt.strftime("%Y-%m-%dT%H:%M:%S%.f")
    return ["" if v is None else str(v).strip() for v in column.to_list()]


def _products(table: _Table, facts: Mapping[str, str]) -> AtmosphereProducts:
    notes = table.notes()
    if not table.samples:
        why = f" ({notes[0].partition(': ')[2]})" if notes else ""
        raise InputError(f"no line can be used{why}", path=table.path, hint=HINT)
    series = {sat: _series(rows) for sat, rows in table.samples.items()}
    troposphere = series.pop("", Samples.none())
    kind: Kind = "ZTD" if table.kind == "ztd" else "ZWD"
    interval, latency = (_fact(table, facts, f"{n}_s", _seconds, notes) for n in ("interval", "latency"))
    self_derived = _fact(table, facts, "self_derived", _flag, notes)
    return AtmosphereProducts(
        series, troposphere, kind, interval or 0.0, facts.get("source") or table.path.name,
        bool(self_derived), latency or 0.0, tuple(notes),
    )  # fmt: skip


def _series(rows: Sequence[tuple[int, float, float]]) -> Samples:
    times = np.array([r[0] for r in rows], dtype=np.int64)
    numbers = np.array([r[1:] for r in rows])
    return Samples(times, numbers[:, 0], numbers[:, 1])


def _fact(
    table: _Table, facts: Mapping[str, str], name: str, read: Callable[[str], float], notes: list[str]
) -> float | None:
    """Return what the file says of itself, None where it does not or cannot be understood."""
    if name not in facts:
        return None
    try:
        return read(facts[name])
    except ValueError:
        notes.append(f"{table.path.name}: `{name} = {facts[name]}` cannot be understood: ignored")
        return None


def _flag(text: str) -> bool:
    if text.lower() not in (*_TRUE, *_FALSE):
        raise ValueError(text)
    return text.lower() in _TRUE


def _seconds(text: str) -> float:
    value = float(text)
    if not 0.0 <= value < np.inf:
        raise ValueError(text)
    return value


# --- writing ----------------------------------------------------------------------------------------------


def write_atmosphere(path: Path | str, products: AtmosphereProducts) -> None:
    """Write products of the atmosphere so that a reader sees the old file or the new one, never a part.

    Parameters
    ----------
    path : Path or str
        ``.parquet``: Parquet; ``.gz``: CSV, compressed; else CSV.
    products : AtmosphereProducts

    Raises
    ------
    InputError
        Where the file cannot be written.
    """
    path = Path(path)
    frame = _frame(products)
    with atomically(path) as temporary:
        if path.suffix.lower() == ".parquet":
            frame.write_parquet(temporary, metadata=_facts(products))
            return
        text = "".join(f"# {name} = {value}\n" for name, value in _facts(products).items())
        raw = (text + frame.write_csv(quote_style="never")).encode("ascii", "replace")
        temporary.write_bytes(gzip.compress(raw, mtime=0) if path.suffix.lower() == ".gz" else raw)


def _facts(products: AtmosphereProducts) -> dict[str, str]:
    return {
        "source": " ".join(products.source.split()),
        "self_derived": str(products.self_derived).lower(),
        "latency_s": f"{products.latency_s:g}",
        "interval_s": f"{products.interval_s:g}",
    }


def _frame(products: AtmosphereProducts) -> pl.DataFrame:
    """Return all samples in the order of time, the troposphere first."""
    parts = [(products.troposphere_kind.lower(), "", products.troposphere)]
    parts += [("stec", sat, samples) for sat, samples in products.ionosphere.items()]
    lengths = [len(s[0]) for _, _, s in parts]
    t_ns, value, sigma = (np.concatenate([s[i] for _, _, s in parts]) for i in range(3))
    iso = {t: to_iso(t) for t in np.unique(t_ns).tolist()}
    columns = {
        "time": [iso[t] for t in t_ns.tolist()],
        "quantity": np.repeat([q for q, _, _ in parts], lengths).tolist(),
        "satellite": np.repeat([sat for _, sat, _ in parts], lengths).tolist(),
        "value": value,
        "sigma": sigma,
    }
    return pl.DataFrame(columns)[np.argsort(t_ns, kind="stable")]
