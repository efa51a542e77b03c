"""gnss_lib_py: `solve_wls` and its greedy residual exclusion (`solve_fde`), fed by ours.

Its satellite states come from files that it downloads, its solver has one receiver clock, and it does not
model the troposphere. So it is handed pseudoranges that need nothing more: satellite clocks, atmosphere and
inter-system offsets are taken off with the values of our clean fix, which favours it.
"""

from __future__ import annotations

import warnings
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.tools import Fix
from benchmarks.workload import FAULT_M, FAULTED, Workload
from pntegrity.estimators.spp import Spp
from pntegrity.records import State, group_of
from pntegrity.run import options_for
from pntegrity.sensors.ranges import geometry

_SYSTEMS = {"G": "gps", "R": "glonass", "E": "galileo", "C": "beidou"}


class GnssLibPy:
    """Weighted least squares and `fde_greedy_residual` with its default threshold."""

    name = "gnss_lib_py"
    given = "satellite states, atmosphere and inter-system offsets, from ours"

    def __init__(self, work: Workload, reading_epochs: int = 20) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import gnss_lib_py

        self._g: Any = gnss_lib_py
        self.version = version("gnss-lib-py")
        self.work = work
        self._estimator = Spp(options_for(work.config(), work.loaded))
        self._beginning, self._reading_epochs = _cut(work.obs, reading_epochs), reading_epochs
        self._keys: tuple[str, ...] = ()

    def read_observations(self) -> int:
        """Read the first epochs of the observation file."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            self._g.RinexObs(str(self._beginning))
        return self._reading_epochs

    def prepare(self, k: int, faulted: bool) -> tuple[Any, tuple[str, ...]]:
        """Return an epoch as the tool's table, and the satellites of its columns."""
        epoch = self.work.loaded.epochs[k]
        update = self._estimator.correct(self._estimator.predict(State.empty(), epoch), epoch)
        code = epoch.sensor("code")
        assert code is not None
        place = {key: i for i, key in enumerate(code.keys)}
        rows = [i for i, key in enumerate(update.keys) if key in place]
        sv = code.aux["sv_pos_m"][[place[update.keys[i]] for i in rows]]
        left = (update.nu - update.H @ (update.posterior.mean - update.prior.mean))[rows]
        groups = tuple(group_of(update.keys[i]) for i in rows)
        clock = update.posterior.mean[update.posterior.layout.block("clk")[0]]
        corrected = geometry(update.posterior.mean[:3], sv).range_m + clock + left
        table = self._g.NavData()
        table["gps_millis"] = np.full(len(rows), epoch.t_ns / 1e6)
        table["gnss_id"] = np.array([_SYSTEMS[g[0]] for g in groups])
        table["sv_id"] = np.array([int(g[1:]) for g in groups])
        table["x_sv_m"], table["y_sv_m"], table["z_sv_m"] = sv.T
        table["b_sv_m"] = np.zeros(len(rows))
        table["corr_pr_m"] = corrected + FAULT_M * np.array([faulted and g in FAULTED for g in groups])
        table["weight"] = 1.0 / np.diag(update.R)[rows]
        return table, groups

    def fix(self, prepared: tuple[Any, tuple[str, ...]]) -> Fix:
        """Return the weighted least-squares position."""
        return Fix(self._solved(prepared[0]))

    def fix_excluding(self, prepared: tuple[Any, tuple[str, ...]]) -> Fix:
        """Return the position after greedy residual exclusion."""
        table, groups = prepared
        tested = self._g.solve_fde(table, method="residual")
        flags = np.atleast_1d(tested["fault_residual"])
        kept = tested.where("fault_residual", 0)
        out = tuple(sorted(groups[i] for i in np.flatnonzero(flags == 1)))
        return Fix(self._solved(kept), out)

    def _solved(self, table: Any) -> Any:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            state = self._g.solve_wls(table, weight_type="weight")
        return np.array([float(state[f"{axis}_rx_wls_m"]) for axis in "xyz"])


def _cut(obs: Path, epochs: int) -> Path:
    """Write the first epochs of a RINEX 3 file beside it."""
    lines = obs.read_text().splitlines(keepends=True)
    starts = [i for i, line in enumerate(lines) if line.startswith(">")]
    out = obs.with_name("beginning.rnx")
    out.write_text("".join(lines[: starts[epochs]]))
    return out
