"""Writing tables of an inertial measurement unit: CSV, plain or gzip, of increments in body axes."""

from __future__ import annotations

import gzip
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import IO, Any

import numpy.typing as npt
import polars as pl

from pntegrity.formats.atomic import atomically
from pntegrity.records import Inertial

__all__ = ["write_imu"]


def write_imu(path: Path | str, imu: Inertial, remark: str = "") -> None:
    """Write increments, body axes, as a table that `imu_table.read_imu` reads; whole or not at all.

    Parameters
    ----------
    path : Path or str
        CSV; gzip where its name ends in ``.gz``.
    imu : Inertial
        Without gaps.
    remark : str
        Lines that stand on top as comments.

    Raises
    ------
    InputError
        Where it cannot be written.
    """
    columns: dict[str, npt.NDArray[Any]] = {"t_ns": imu.t_ns}
    for kind, unit, rows in (("dtheta", "rad", imu.angle_rad), ("dv", "mps", imu.velocity_mps)):
        columns |= {f"{kind}_{axis}_{unit}": rows[:, i] for i, axis in enumerate("xyz")}
    head = "".join(f"# {line}\n" for line in remark.splitlines()).encode("ascii", "replace")
    with atomically(path) as temporary, open(temporary, "wb") as raw, _packed(path, raw) as file:
        file.write(head)
        pl.DataFrame(columns).write_csv(file, float_scientific=True, float_precision=10)


def _packed(path: Path | str, raw: IO[bytes]) -> AbstractContextManager[IO[bytes]]:
    """Return what packs a file whose name ends in .gz, the same bytes for the same content."""
    if not str(path).endswith(".gz"):
        return nullcontext(raw)
    return gzip.GzipFile(fileobj=raw, mode="wb", filename="", mtime=0, compresslevel=4)  # type: ignore[return-value]
