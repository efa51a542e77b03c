"""Which errors of a library each satellite has in a street, drawn in blocks."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from pntegrity.records import FloatArray
from pntegrity.simulate.error_library import CLEAN_M, ErrorLibrary, rms
from pntegrity.simulate.urban_scenario import CHALLENGING, DENIED, Section, UrbanScenario, mask_rad

__all__ = ["CLEAN", "LOST", "Plan", "Sky"]

IntArray = npt.NDArray[np.int64]
#: A satellite of the library is tracked in a block where it is there for this share of it.
TRACKED = 0.5
#: Share of the library's seconds that a block may come from: those of a speed most like the vehicle's.
ALIKE = 0.25
#: What became of a satellite: no error of the library, not received.
CLEAN, LOST = -1, -2


@dataclass(frozen=True, eq=False)
class Sky:
    """Elevation and azimuth relative to the vehicle, shape (n, m); nan where a satellite is not tracked."""

    sats: tuple[str, ...]
    el_rad: FloatArray
    relative_rad: FloatArray


class Plan:
    """What becomes of each satellite at each epoch."""

    def __init__(
        self, scenario: UrbanScenario, share: float, t_s: FloatArray, sky: Sky, library: ErrorLibrary
    ) -> None:
        self.scenario, self.share, self.sky, self.library = scenario, share, sky, library
        self.section = scenario.section_at(t_s)
        self.block = max(1, round(scenario.block_s * scenario.rate_hz))
        self.stagger = round(scenario.stagger_s * scenario.rate_hz)
        self.values = np.stack([library.code_m, library.rate_mps, library.cn0_dbhz], axis=1)
        if len(library.t_ns) < self.block + 2 * self.stagger:
            raise ValueError(
                f"the error library has {len(library.t_ns)} epochs, fewer than a block of {self.block} and "
                f"its staggered ends of {self.stagger}"
            )

    def draw(self, speed: FloatArray, rng: np.random.Generator) -> tuple[IntArray, FloatArray]:
        """Return fates (n, m), and errors of code and range rate and C/N0 (n, 3, m), nan: as they were."""
        n, m = self.sky.el_rad.shape
        fate = np.full((n, m), CLEAN, dtype=np.int64)
        errors = np.full((n, 3, m), np.nan)
        for number, section in enumerate(self.scenario.sections):
            at = np.flatnonzero(self.section == number)
            if section.kind == DENIED:
                fate[at] = LOST
            elif section.kind == CHALLENGING and len(at):
                self._street(section, int(at[0]), int(at[-1]) + 1, speed, fate, errors, rng)
        return fate, errors

    def _street(
        self, section: Section, first: int, end: int, speed: FloatArray, fate: IntArray,
        errors: FloatArray, rng: np.random.Generator,
    ) -> None:  # fmt: skip
        m = len(self.sky.sats)
        edges = [*range(first, end, self.block), end]
        late = np.zeros(m, dtype=np.int64)
        for i, j in pairwise(edges):
            start = self._start(float(speed[i:j].mean()), rng)
            fates = self._fates(section, i, j, start, rng)
            until = rng.integers(-self.stagger, self.stagger + 1, m) if j < end else np.zeros(m, np.int64)
            for s in range(m):
                rows = slice(max(i + int(late[s]), first), min(j + int(until[s]), end))
                self._fill(s, rows, start - i, int(fates[s]), fate, errors)
            late = until

    def _fill(self, s: int, rows: slice, shift: int, column: int, fate: IntArray, errors: FloatArray) -> None:
        """Give a satellite its fate, and the errors of a satellite of the library `shift` epochs away."""
        if column < 0:
            fate[rows, s] = column
            return
        taken = self.values[rows.start + shift : rows.stop + shift, :, column]
        errors[rows, :, s] = taken
        fate[rows, s] = np.where(np.isfinite(taken[:, 0]), column, LOST)

    def _start(self, speed: float, rng: np.random.Generator) -> int:
        """Draw the epoch of the library that a block begins with."""
        n = len(self.library.t_ns) - self.block - 2 * self.stagger + 1
        total = np.append(0.0, np.cumsum(self.library.speed_mps))
        begin = self.stagger + np.arange(n)
        mean = (total[begin + self.block] - total[begin]) / self.block
        alike = np.argsort(np.abs(mean - speed), kind="stable")[: max(1, round(ALIKE * n))]
        return int(begin[rng.choice(alike)])

    def _fates(self, section: Section, i: int, j: int, start: int, rng: np.random.Generator) -> IntArray:
        """Return the column of the library whose errors each satellite has in a block, `CLEAN` or `LOST`.

        Those behind the houses take reflected errors first; no more are received than the library's receiver
        tracked.
        """
        mid = (i + j) // 2
        el, relative = self.sky.el_rad[mid], self.sky.relative_rad[mid]
        seen = np.flatnonzero(np.isfinite(el))
        behind = el < mask_rad(section, relative)
        heard = rng.permutation(seen[~behind[seen] | (rng.random(len(seen)) < self.scenario.reflected)])
        heard = heard[np.argsort(behind[heard], kind="stable")]  # in sight first
        clean, rest = np.split(heard, [round(self.share * len(heard))])
        columns = self._columns(start, j - i, rng)
        rest = rest[: len(columns)][::-1]  # behind the houses first
        fates = np.full(len(el), LOST, dtype=np.int64)
        fates[clean], fates[rest] = CLEAN, columns[: len(rest)]
        return fates

    def _columns(self, start: int, n: int, rng: np.random.Generator) -> npt.NDArray[np.intp]:
        """Return the satellites that the library tracked, those with reflected signals first."""
        code = self.library.code_m[start : start + n]
        tracked = rng.permutation(np.flatnonzero(np.isfinite(code).mean(axis=0) >= TRACKED))
        return tracked[np.argsort(rms(code[:, tracked], axis=0) < CLEAN_M, kind="stable")]
