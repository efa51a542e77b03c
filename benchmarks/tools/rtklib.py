"""RTKLIB through `pyrtklib`: `readrnx`, `satposs` and `pntpos`, with and without its RAIM option."""

from __future__ import annotations

from importlib.metadata import version
from typing import Any

import numpy as np

from benchmarks.tools import Fix
from benchmarks.workload import FAULT_M, FAULTED, Workload


class Rtklib:
    """Single-frequency single point positioning with broadcast ephemerides, Saastamoinen, 10 degrees mask."""

    name = "RTKLIB"
    given = ""

    def __init__(self, work: Workload, ionosphere: bool) -> None:
        import pyrtklib

        self._r: Any = pyrtklib
        self.version = f"pyrtklib {version('pyrtklib')}"
        self.work = work
        self._nav = self._navigation()
        self._obs = self._observations()
        self._option = self._options(ionosphere)
        seconds = [self._obs.data[i].time.time for i in range(self._obs.n)]
        self._starts = [0, *(i for i in range(1, len(seconds)) if seconds[i] != seconds[i - 1]), len(seconds)]
        n = pyrtklib.MAXSAT
        self._azel, self._status, self._message = (
            pyrtklib.Arr1Ddouble(2 * n), pyrtklib.Arr1Dssat_t(n), pyrtklib.Arr1Dchar(256),
        )  # fmt: skip
        self._space = [pyrtklib.Arr1Ddouble(6 * 64), pyrtklib.Arr1Ddouble(2 * 64), pyrtklib.Arr1Ddouble(64)]
        self._health = pyrtklib.Arr1Dint(64)
        self._faulted = {pyrtklib.satid2no(s): s for s in FAULTED}
        self._names = {pyrtklib.satid2no(f"{s}{i:02d}"): f"{s}{i:02d}" for s in "GREC" for i in range(1, 64)}

    def _observations(self) -> Any:
        obs, sta = self._r.obs_t(), self._r.sta_t()
        if self._r.readrnx(str(self.work.obs), 1, "", obs, self._r.nav_t(), sta) != 1:
            raise RuntimeError("RTKLIB could not read the observation file")
        self._r.sortobs(obs)
        return obs

    def _navigation(self) -> Any:
        nav, sta = self._r.nav_t(), self._r.sta_t()
        if self._r.readrnx(str(self.work.nav), 1, "", self._r.obs_t(), nav, sta) != 1:
            raise RuntimeError("RTKLIB could not read the navigation file")
        self._r.uniqnav(nav)
        return nav

    def _options(self, ionosphere: bool) -> Any:
        r, o = self._r, self._r.prcopt_default
        o.mode, o.nf, o.elmin = r.PMODE_SINGLE, 1, float(np.deg2rad(10.0))
        o.navsys = r.SYS_GPS | r.SYS_GLO | r.SYS_GAL | r.SYS_CMP
        o.ionoopt, o.tropopt = r.IONOOPT_BRDC if ionosphere else r.IONOOPT_OFF, r.TROPOPT_SAAS
        return o

    def read_observations(self) -> int:
        """Read the observation file."""
        obs = self._observations()
        n = len(self._starts) - 1
        self._r.freeobs(obs)
        return n

    def read_navigation(self) -> object:
        """Read the navigation file."""
        return self._navigation()

    def prepare(self, k: int, faulted: bool) -> tuple[int, int]:
        """Return first row and number of rows of an epoch, the faults added to its code or taken off
        again.
        """
        a, b = self._starts[k], self._starts[k + 1]
        for i in range(a, b):
            row = self._obs.data[i]
            if row.sat in self._faulted:
                clean = self.__dict__.setdefault("_clean", {}).setdefault(i, row.P[0])
                row.P[0] = clean + (FAULT_M if faulted else 0.0)
        return a, b - a

    def states(self, prepared: tuple[int, int]) -> object:
        """Compute satellite positions and clocks."""
        a, n = prepared
        row = self._obs.data[a]
        self._r.satposs(row.time, row, n, self._nav, self._r.EPHOPT_BRDC, *self._space, self._health)
        return self._space

    def fix(self, prepared: tuple[int, int]) -> Fix:
        """Return the position without RAIM."""
        return self._pntpos(prepared, 0)

    def fix_excluding(self, prepared: tuple[int, int]) -> Fix:
        """Return the position with RAIM fault detection and exclusion."""
        return self._pntpos(prepared, 1)

    def _pntpos(self, prepared: tuple[int, int], raim: int) -> Fix:
        r, (a, n) = self._r, prepared
        self._option.posopt[4] = raim
        sol = r.sol_t()
        found = r.pntpos(
            self._obs.data[a], n, self._nav, self._option, sol, self._azel, self._status[0], self._message
        )
        if not found:
            return Fix(None, (), "no solution: the residual test failed")
        return Fix(np.array([sol.rr[i] for i in range(3)]))

    def left_out(self, prepared: tuple[int, int]) -> tuple[str, ...]:
        """Return who was not in the last fix but is in one without RAIM."""
        with_raim = self._used()
        self.fix(prepared)
        return tuple(sorted(self._used() - with_raim))

    def _used(self) -> frozenset[str]:
        return frozenset(name for no, name in self._names.items() if no and self._status[no - 1].vs)
