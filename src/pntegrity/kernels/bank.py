"""A bank of fault hypotheses carried through a filter: signatures x onsets, each a running matched filter.

For a hypothesis whose unit fault moves the innovation mean by ``g_k`` (see `windows.respond`), the
log-likelihood ratio is ``num^2 / (2 den)`` with ``num = sum g_k^T S_k^-1 nu_k`` and ``den = sum g_k^T S_k^-1
g_k``; ``num / sqrt(den)`` is a unit normal without a fault. Correlations of hypotheses are sums of the same
kind, so that the threshold on the largest of them is exact enough to hold its false-alarm rate (see
`tails.effective_tests`). Everything but ``num`` is free of data: a `Bank` is carried once, and any number of
runs of ``num`` beside it (see `MaximumTest`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from pntegrity.kernels.linear import inverse_lower
from pntegrity.kernels.signatures import Signature
from pntegrity.kernels.sparse import Sparse, left, nonzeros

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

CHUNK = 16
"""Signatures that are carried through an epoch together."""
LEAST = 1e-9
"""Least ``den`` of a hypothesis that is tested: what moves the innovations less, nobody sees."""


@dataclass(frozen=True)
class Schedule:
    """Which onsets are kept: every `step`-th, thinned by octaves of age, from `youngest` to `oldest`."""

    step: int
    youngest: int
    oldest: int

    def keep(self, onset: IntArray, count: int) -> npt.NDArray[np.bool_]:
        """Tell which of the onset counters are kept at epoch counter `count`."""
        age = count - onset
        octave = np.floor(np.log2(np.maximum(age, 1) / (2 * self.step)))
        spacing = self.step * 2.0 ** np.maximum(octave, 0.0)
        return np.asarray((age <= self.oldest) & (np.mod(onset, spacing) == 0))

    def tested(self, onset: IntArray, count: int) -> npt.NDArray[np.bool_]:
        """Tell which onsets are old enough to be tested."""
        return np.asarray(count - onset >= self.youngest)


@dataclass(frozen=True, eq=False)
class Bank:
    """The data-free part of one kind of fault; shapes: s signatures, o onsets, n states.

    Parameters
    ----------
    signatures : tuple of Signature
    onset, onset_ns : ndarray, shape (o,)
        Epoch counter and time at which each hypothesis starts (a ramp is zero one interval before).
    E : ndarray, shape (n, s, o)
        State error of a unit fault.
    gram : ndarray, shape (s, o, o)
        ``sum g_a^T S^-1 g_b`` of the onsets of one signature.
    """

    signatures: tuple[Signature, ...]
    onset: IntArray
    onset_ns: IntArray
    E: FloatArray
    gram: FloatArray

    @property
    def den(self) -> FloatArray:
        """``sum g^T S^-1 g``, shape (s, o): the diagonal of `gram`."""
        return np.asarray(np.diagonal(self.gram, axis1=1, axis2=2))


@dataclass(frozen=True, eq=False)
class MaximumTest:
    """One epoch of a bank, without data: what becomes of ``num``, and the threshold of its squares.

    Hypotheses are flat, shape (h,): bank after bank, signature after signature, onset after onset.

    Parameters
    ----------
    banks : tuple of Bank
        The banks after the epoch.
    source : ndarray of int, shape (h,)
        Where each hypothesis stood in the epoch before, -1 for one that begins now.
    response : ndarray, shape (h, m)
        Whitened innovation mean of the unit fault.
    inverse : ndarray, shape (h,)
        ``1 / den``, 0 where the hypothesis is not tested now.
    rho : ndarray, shape (tested,)
        Correlation of each tested hypothesis with its parent (see `tails.effective_tests`).
    threshold, p_fa : float
        Threshold on the largest ``num^2 / den``, and the false-alarm probability that it stands for.
    reason : str
        Why no test is possible, where none is.
    """

    banks: tuple[Bank, ...]
    source: IntArray
    response: FloatArray
    inverse: FloatArray
    rho: FloatArray
    threshold: float = float("inf")
    p_fa: float = 0.0
    reason: str = ""

    @staticmethod
    def impossible(reason: str) -> MaximumTest:
        """Return the test of an epoch without rows."""
        none = np.zeros(0)
        return MaximumTest((), np.zeros(0, dtype=np.int64), np.zeros((0, 0)), none, none, reason=reason)

    @property
    def overlap(self) -> int:
        """Epochs since the oldest onset that is carried."""
        ages = [int(b.onset.max() - b.onset.min()) + 1 for b in self.banks if len(b.onset)]
        return max(ages, default=1)

    def carry(self, num: FloatArray, white: FloatArray) -> FloatArray:
        """Return ``num`` after the epoch, shape (h,) or (h, runs), from that before and the whitened rows."""
        none = np.zeros((1, *num.shape[1:]))
        return np.asarray(np.concatenate((num, none))[self.source] + self.response @ white)

    def hypothesis(self, index: int) -> tuple[Signature, int]:
        """Return the signature and the onset (ns) of a flat hypothesis."""
        for bank in self.banks:
            s, o = len(bank.signatures), len(bank.onset)
            if index < s * o:
                return bank.signatures[index // o], int(bank.onset_ns[index % o])
            index -= s * o
        raise IndexError(f"no hypothesis {index} in the bank")


def empty_bank() -> Bank:
    """Return a bank without hypotheses."""
    none = np.zeros(0, dtype=np.int64)
    return Bank((), none, none, np.zeros((0, 0, 0)), np.zeros((0, 0, 0)))


def rearrange(
    bank: Bank, signatures: tuple[Signature, ...], schedule: Schedule, count: int, start_ns: int
) -> tuple[Bank, IntArray]:
    """Return the bank with onsets thinned, one begun at `count` where it is due, and rows for `signatures`.

    The second value is where each hypothesis stood before (flat, shape (s * o,)), -1 for those begun now.
    """
    stood = np.flatnonzero(schedule.keep(bank.onset, count))
    onset, onset_ns = bank.onset[stood], bank.onset_ns[stood]
    if count % schedule.step == 0:
        stood, onset, onset_ns = np.append(stood, -1), np.append(onset, count), np.append(onset_ns, start_ns)
    was = _matching(bank.signatures, signatures)
    if (
        len(stood) == len(bank.onset)
        and np.array_equal(stood, np.arange(len(stood)))
        and bank.signatures is signatures
    ):
        return bank, np.arange(len(signatures) * len(onset))
    E, gram, source = _gather(bank.E, bank.gram, was, stood)
    return Bank(signatures, onset, onset_ns, E, gram), source


def _matching(old: tuple[Signature, ...], new: tuple[Signature, ...]) -> IntArray:
    """Return where each of `new` stands in `old`, -1 for a new one."""
    if old is new:
        return np.arange(len(new))
    where = {s: i for i, s in enumerate(old)}
    return np.array([where.get(s, -1) for s in new], dtype=np.int64)


@njit(cache=True, nogil=True)
def _gather(
    E: FloatArray, gram: FloatArray, was: IntArray, stood: IntArray
) -> tuple[FloatArray, FloatArray, IntArray]:
    n, old, s, o = E.shape[0], E.shape[2], len(was), len(stood)
    E_new, gram_new = np.zeros((n, s, o)), np.zeros((s, o, o))
    source = np.full(s * o, -1, dtype=np.int64)
    for i in range(s):
        for a in range(o):
            if was[i] < 0 or stood[a] < 0:
                continue
            source[i * o + a] = was[i] * old + stood[a]
            for k in range(n):
                E_new[k, i, a] = E[k, was[i], stood[a]]
            for b in range(o):
                if stood[b] >= 0:
                    gram_new[i, a, b] = gram[was[i], stood[a], stood[b]]
    return E_new, gram_new, source


BankStep = tuple[Sparse, Sparse, FloatArray, int]
"""What the banks need of an update: `F` and `H` by their non-zeros, ``L^-1`` over the gain, states before."""


def step_of(F: FloatArray, H: FloatArray, L: FloatArray, K: FloatArray) -> BankStep:
    """Return what all banks need of an update, made once."""
    return nonzeros(F), nonzeros(H), np.concatenate((np.tril(inverse_lower(L)), K)), F.shape[1]


def advance(
    bank: Bank, t_ns: int, touched: tuple[FloatArray, FloatArray], step: BankStep
) -> tuple[Bank, FloatArray]:
    """Return the bank after one update and the whitened responses, shape (s * o, m), of its hypotheses.

    `touched` holds the rows that grow with time and the rows that jump, each (m, s) (see `signatures.masks`).
    """
    (F, H, both, before), m = step, len(touched[0])
    s, o = len(bank.signatures), len(bank.onset)
    E = bank.E if len(bank.E) == before else np.zeros((before, s, o))
    E, gram, response = _carried(E, bank.gram, F, H, both, *touched, _since(bank, t_ns), len(both) - m)
    return Bank(bank.signatures, bank.onset, bank.onset_ns, E, gram), response


def _since(bank: Bank, t_ns: int) -> FloatArray:
    return np.asarray((t_ns - bank.onset_ns) * 1e-9, dtype=np.float64)


@njit(cache=True, nogil=True)
def _carried(
    E: FloatArray, gram: FloatArray, F: Sparse, H: Sparse, both: FloatArray,
    growing: FloatArray, constant: FloatArray, tau: FloatArray, n: int,
) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
    """Take all hypotheses through an epoch, a few signatures at a time so that they stay in the cache."""
    s, o, m = gram.shape[0], gram.shape[1], len(growing)
    E_new, gram_new, response = np.empty((n, s, o)), gram.copy(), np.empty((s * o, m))
    for first in range(0, s, CHUNK):
        few = min(CHUNK, s - first)
        prior = left(F, E[:, first : first + few].copy().reshape(len(E), few * o))
        g = -left(H, prior)
        for i in range(m):
            for k in range(few):
                grows, jumps = growing[i, first + k], constant[i, first + k]
                if grows != 0.0 or jumps != 0.0:
                    for a in range(o):
                        g[i, k * o + a] += grows * tau[a] + jumps
        both_g = np.dot(both, g)
        E_new[:, first : first + few] = (prior + both_g[m:]).reshape(n, few, o)
        response[first * o : (first + few) * o] = both_g[:m].T
        for k in range(few):
            own = response[(first + k) * o : (first + k + 1) * o]
            gram_new[first + k] += np.dot(own, own.T)
    return E_new, gram_new, response


def stack_sources(sources: Sequence[IntArray], sizes: Sequence[int]) -> IntArray:
    """Return flat sources of banks that stand one after another; `sizes`: their hypotheses before."""
    offsets = np.concatenate(([0], np.cumsum(sizes)[:-1]))
    moved = [np.where(source < 0, source, source + at) for source, at in zip(sources, offsets, strict=True)]
    return np.concatenate(moved).astype(np.int64)


@njit(cache=True, nogil=True)
def parents(gram: FloatArray, tested: npt.NDArray[np.bool_]) -> FloatArray:
    """Return each tested hypothesis' largest correlation with an earlier onset; -1 where untested."""
    s, o = gram.shape[0], gram.shape[1]
    rho = np.full((s, o), -1.0)
    for i in range(s):
        for b in range(o):
            if not tested[b] or gram[i, b, b] <= LEAST:
                continue
            best = 0.0
            for a in range(b):
                if tested[a] and gram[i, a, a] > LEAST:
                    r = abs(gram[i, a, b]) / np.sqrt(gram[i, a, a] * gram[i, b, b])
                    best = max(best, r)
            rho[i, b] = best
    return rho
