"""Campaign ``city-tst``: the real log of Tsim Sha Tsui, an IMU simulated on its truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pntegrity.scenarios._city_runs import EKF, EXACT, LSR, OURS, PUBLISHED, SPECS, Drive, drives
from pntegrity.scenarios._city_tables import (
    HORIZONTAL,
    Found,
    error_rows,
    median_row,
    rmse,
    subset_rows,
    use_row,
    wrong_row,
)
from pntegrity.scenarios._real_logs import Row, row, skipped
from pntegrity.scenarios._urban_logs import missing

__all__ = ["tst"]

NAME = "city-tst"
IMU_SEEDS = tuple(range(1, 11))
#: What the horizontal error of ours may be: per cent of the EKF's, and m.
SHARE, LARGEST_M = 30.0, 5.0


def tst(data: Path) -> list[Row]:
    """Return what each method makes of the log, with seeds of both IMUs."""
    if lost := missing(data):
        return skipped(NAME, lost)
    return [r for spec in SPECS for r in _rows(drives(Drive(data, "tst", SPECS[spec]), IMU_SEEDS), spec)]


def _rows(found: Found, spec: str) -> list[Row]:
    ours, ekf = rmse(found[OURS], HORIZONTAL), rmse(found[EKF], HORIZONTAL)
    share, size = 100.0 * float(ours.mean() / ekf.mean()), float(ours.mean())
    spread = f"seeds of the IMU {ours.min():.2f} to {ours.max():.2f} m; EKF {ekf.mean():.1f} m"
    return [
        row(NAME, f"{spec}: horizontal RMSE of *ours* in that of the EKF, %", f"at most {SHARE:g}",
            f"{share:.1f}", share <= SHARE),
        row(NAME, f"{spec}: horizontal RMSE of *ours*, m", f"at most {LARGEST_M:g}", f"{size:.2f}",
            bool(np.all(ours <= LARGEST_M)), note=spread),
        *error_rows(NAME, found, spec), median_row(NAME, found, spec), use_row(NAME, found, spec),
        wrong_row(NAME, found, spec),
        *(subset_rows(NAME, found, spec, (PUBLISHED, EXACT, LSR)) if spec == next(iter(SPECS)) else ()),
    ]  # fmt: skip
