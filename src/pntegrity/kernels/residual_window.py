"""Residuals of the last epochs, satellite by satellite, and the sigma they give: a value that steps on.

A step costs as much however long the window is: sums are carried on, and what the epochs said is kept in
blocks that later memories share with earlier ones.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

__all__ = ["FactorMemory"]

#: Epochs of a block.
BLOCK = 32
#: What one epoch said: rows by number, squared residuals, what each counts.
_Entry = tuple[IntArray, FloatArray, FloatArray]
_Block = tuple[_Entry, ...]


@lru_cache(maxsize=256)
def _places(keys: tuple[str, ...]) -> dict[str, int]:
    return {key: i for i, key in enumerate(keys)}


def _none() -> FloatArray:
    return np.zeros(0)


@dataclass(frozen=True, eq=False)
class FactorMemory:
    """A window of squared residuals, and the present sigma of each row.

    Parameters
    ----------
    keys : tuple of str
        Rows that were ever in the window.
    square, count : ndarray, shape (k,)
        Sums over the window: of squared residuals, and of what they count.
    present : ndarray, shape (k,)
        Sigma of each row, or its ratio to the noise model's; nan where none was set.
    epochs : int
        Epochs in the window.
    """

    keys: tuple[str, ...] = ()
    square: FloatArray = field(default_factory=_none)
    count: FloatArray = field(default_factory=_none)
    present: FloatArray = field(default_factory=_none)
    epochs: int = 0
    blocks: tuple[_Block, ...] = ()
    recent: tuple[_Entry, ...] = ()
    passed: int = 0

    @property
    def where(self) -> dict[str, int]:
        """Place of each row."""
        return _places(self.keys)

    def places(self, keys: tuple[str, ...]) -> IntArray:
        """Return where rows stand, -1 for those that never were in the window."""
        where = self.where
        return np.array([where.get(key, -1) for key in keys], dtype=np.int64)

    def sums(self, keys: tuple[str, ...]) -> tuple[FloatArray, FloatArray]:
        """Return the sums of some rows: squares and counts, 0 where there are none."""
        return self._of(self.square, keys, 0.0), self._of(self.count, keys, 0.0)

    def sigmas(self, keys: tuple[str, ...], otherwise: float) -> FloatArray:
        """Return the present sigma of some rows, `otherwise` where none was set."""
        out = self._of(self.present, keys, np.nan)
        return np.where(np.isfinite(out), out, otherwise)

    def _of(self, values: FloatArray, keys: tuple[str, ...], otherwise: float) -> FloatArray:
        at = self.places(keys)
        return np.where(at >= 0, np.append(values, otherwise)[at], otherwise)

    def pushed(
        self, keys: tuple[str, ...], square: FloatArray, count: FloatArray, window: int
    ) -> FactorMemory:
        """Return the memory after one more epoch; the one that leaves the window is taken away.

        Parameters
        ----------
        keys : tuple of str
            Rows of the epoch.
        square, count : ndarray, shape (n,)
            Squared residuals, and what each counts.
        window : int
            Epochs that the window may hold.
        """
        wide = self._with(keys)
        entry = (wide.places(keys), square, count)
        sums = wide.square.copy(), wide.count.copy()
        _add(sums, entry, 1.0)
        blocks, recent, passed = wide.blocks, (*wide.recent, entry), wide.passed
        if len(recent) == BLOCK:
            blocks, recent = (*blocks, recent), ()
        if self.epochs == window:
            _add(sums, (blocks[0] if blocks else recent)[passed], -1.0)
            blocks, recent, passed = _advanced(blocks, recent, passed)
        kept = np.maximum(sums[1], 0.0) > 1e-9  # what is left of sums of nothing is rounding
        return FactorMemory(
            wide.keys, np.where(kept, np.maximum(sums[0], 0.0), 0.0), np.where(kept, sums[1], 0.0),
            wide.present, min(self.epochs + 1, window), blocks, recent, passed,
        )  # fmt: skip

    def _with(self, keys: tuple[str, ...]) -> FactorMemory:
        where = self.where
        new = tuple(k for k in keys if k not in where)
        if not new:
            return self
        more = np.zeros(len(new))
        return FactorMemory(
            (*self.keys, *new), np.append(self.square, more), np.append(self.count, more),
            np.append(self.present, more + np.nan), self.epochs, self.blocks, self.recent, self.passed,
        )  # fmt: skip


def _add(sums: tuple[FloatArray, FloatArray], entry: _Entry, sign: float) -> None:
    at, square, count = entry
    sums[0][at] += sign * square
    sums[1][at] += sign * count


def _advanced(
    blocks: tuple[_Block, ...], recent: _Block, passed: int
) -> tuple[tuple[_Block, ...], _Block, int]:
    """Return the window without its oldest epoch: of the oldest block, `passed` epochs are gone."""
    if not blocks:
        return (), recent[1:], 0
    return (blocks[1:], recent, 0) if passed + 1 == BLOCK else (blocks, recent, passed + 1)
