"""What faults explain of a window's data: of each alone, of some sources or sensors together at best."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pntegrity.kernels.bank import LEAST
from pntegrity.monitors._sources import Evidence, IntArray, sensors_in, sources_in
from pntegrity.records import FloatArray

__all__ = ["Gains"]

#: Of a shift's strongest direction so much is rounding.
ROUNDING = 1e-12

Columns = slice | IntArray


@dataclass(frozen=True, eq=False)
class Gains:
    """What the faults that a window may have explain of its whitened innovations.

    Parameters
    ----------
    evidence : Evidence
    white : ndarray, shape (D, runs)
    """

    evidence: Evidence
    white: FloatArray

    @cached_property
    def explained(self) -> FloatArray:
        """What each fault explains, shape (h, runs)."""
        return np.asarray(self._dots**2)

    @cached_property
    def _dots(self) -> FloatArray:
        """Each fault's size in standard deviations."""
        return self._along(slice(None), self.white)

    def _along(self, columns: Columns, white: FloatArray) -> FloatArray:
        means = self.evidence.faults[1].means.T[columns]
        return np.asarray((means @ white) * self.evidence.scale[columns, None])

    def of_sources(self, names: Sequence[str]) -> FloatArray:
        """Return what faults of some sources explain of each run at best: one fault of each, or all as if the
        position were elsewhere; less 2 for each parameter beyond the first.
        """
        each: list[list[Columns]] = [[*self.evidence.columns.get((name,), [])] for name in names]
        return np.maximum(self._in_turn(each), self._shifted(names))

    def of_sensors(self, source: str, names: Sequence[str]) -> FloatArray:
        """Return what a fault of each of some sensors of a source explains together at best."""
        named, faults = self.evidence.faults
        one = [sensors_in(s) if sources_in(s) == (source,) else () for _, s in named]
        each: list[list[Columns]] = [
            [np.flatnonzero(np.array([sensors == (name,) for sensors in one])[faults.signature])]
            for name in names
        ]
        return self._in_turn(each)

    def _in_turn(self, each: Sequence[Sequence[Columns]]) -> FloatArray:
        """Return what the best fault of each of some lists explains, one after the other."""
        left, total = self.white, -2.0 * (len(each) - 1) + np.zeros(self.white.shape[1])
        means, scale, begun = self.evidence.faults[1].means, self.evidence.scale, False
        every = np.arange(len(scale))
        for own in each:
            at = np.concatenate([every[:0], *(every[c] for c in own)])
            if not len(at):
                continue
            dots = np.concatenate([self._along(c, left) if begun else self._dots[c] for c in own])
            best = np.abs(dots).argmax(axis=0)
            size = np.take_along_axis(dots, best[None], axis=0)[0]
            total = total + size**2
            left, begun = left - means[:, at[best]] * (scale[at[best]] * size), True
        return np.asarray(total)

    def _shifted(self, names: Sequence[str]) -> FloatArray:
        """Return what a shift of some sources together explains, in any direction."""
        there = [self.evidence.shifts[name] for name in names if name in self.evidence.shifts]
        if not there:
            return np.zeros(self.white.shape[1])
        means = self.evidence.faults[1].means.T
        moved = sum((means[at] for at in there[1:]), means[there[0]])
        size, way = np.linalg.eigh(moved @ moved.transpose(0, 2, 1))
        seen = size > np.maximum(LEAST, ROUNDING * size[:, -1:])
        dots = way.transpose(0, 2, 1) @ (moved @ self.white)
        gained = np.divide(dots**2, size[:, :, None], out=np.zeros_like(dots), where=seen[:, :, None])
        paid = 2.0 * np.maximum(seen.sum(axis=1) - 1, 0)
        return np.asarray((gained.sum(axis=1) - paid[:, None]).max(axis=0, initial=0.0))
