"""sidereon's own snapshot solver and its fault detection and exclusion."""

from __future__ import annotations

from importlib.metadata import version
from typing import Any

import numpy as np

from benchmarks.tools import Fix
from benchmarks.workload import FAULT_M, FAULTED, Workload


class Sidereon:
    """`solve_broadcast` and `fde_broadcast`."""

    name = "sidereon"
    given = "a position 170 m off to start from (the others start at the Earth's centre)"

    def __init__(self, work: Workload, p_fa: float = 1e-6, most: int = 8) -> None:
        import sidereon

        self._s: Any = sidereon
        self.version = version("sidereon")
        self.work, self._p_fa, self._most = work, p_fa, most
        self._nav = sidereon.parse_rinex_nav(work.nav.read_text())
        obs = sidereon.parse_rinex_obs(work.obs.read_text())
        guess = [*(work.truth_m[0] + 100.0).tolist(), 0.0]
        klobuchar = work.loaded.klobuchar
        self._corrections = sidereon.SppCorrections(ionosphere=klobuchar is not None, troposphere=True)
        options = sidereon.RinexSppOptions(obs, corrections=self._corrections, initial_guess=guess)
        self._inputs = sidereon.spp_inputs_from_rinex_obs(self._nav, obs, options)
        self._klobuchar = klobuchar and sidereon.SppKlobucharCoeffs(
            list(klobuchar.alpha), list(klobuchar.beta)
        )

    def read_observations(self) -> int:
        """Read the observation file."""
        return int(self._s.parse_rinex_obs(self.work.obs.read_text()).epoch_count)

    def read_navigation(self) -> object:
        """Read the navigation file."""
        return self._s.parse_rinex_nav(self.work.nav.read_text())

    def prepare(self, k: int, faulted: bool) -> object:
        """Return the solver's input of an epoch."""
        e, s = self._inputs[k], self._s
        observations = [
            s.SppObservation(
                o.satellite_id, o.pseudorange_m + FAULT_M * (faulted and o.satellite_id in FAULTED)
            )
            for o in e.observations
        ]
        return s.SppConfig(
            observations, e.t_rx_j2000_s, e.t_rx_second_of_day_s, e.day_of_year, e.initial_guess,
            self._corrections,
            self._klobuchar, self._nav.glonass_frequency_channels,
        )  # fmt: skip

    def fix(self, prepared: object) -> Fix:
        """Return the least-squares position."""
        return Fix(np.asarray(self._s.solve_broadcast(self._nav, prepared).position))

    def fix_excluding(self, prepared: object) -> Fix:
        """Return the position after residual RAIM and exclusion."""
        try:
            found = self._s.fde_broadcast(self._nav, prepared, self._p_fa, self._most)
        except self._s.FdeFaultUnresolvedError:
            return Fix(None, (), "no solution: the fault is unresolved")
        return Fix(np.asarray(found.position), tuple(sorted(found.excluded)))
