"""A bank of fault hypotheses carried through a filter: signatures x onsets, each a running matched filter.

For a hypothesis whose unit fault moves the innovation mean by ``g_k`` (see `windows.respond`), the log-likelihood ratio
is ``num^2 / (2 den)`` with ``num = sum g_k^T S_k^-1 nu_k`` and ``den = sum g_k^T S_k^-1 g_k``; ``num / sqrt(den)`` is a
unit normal without a fault. Correlations of hypotheses are sums of the same kind, so that the threshold on the largest
of them is exact enough to hold its false-alarm rate (see `tails.effective_tests`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from pntegrity.kernels.linear import whiten
from pntegrity.kernels.signatures import Signature, masks
from pntegrity.kernels.sparse import left

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Schedule:
    """Which onsets are kept: every `step`-th epoch, thinned by octaves of age, from `youngest` to `oldest` epochs."""

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
    """The running sums of one kind of fault; shapes: s signatures, o onsets, n states.

    Parameters
    ----------
    signatures : tuple of Signature
    onset, onset_ns : ndarray, shape (o,)
        Epoch counter and time at which each hypothesis starts (a ramp is zero one interval before).
    E : ndarray, shape (n, s, o)
        State error of a unit fault.
    num, den : ndarray, shape (s, o)
    gram : ndarray, shape (s, o, o)
        ``sum g_a^T S^-1 g_b`` of the onsets of one signature.
    """

    signatures: tuple[Signature, ...]
    onset: IntArray
    onset_ns: IntArray
    E: FloatArray
    num: FloatArray
    den: FloatArray
    gram: FloatArray


def empty_bank() -> Bank:
    """Return a bank without hypotheses."""
    none = np.zeros(0, dtype=np.int64)
    return Bank((), none, none, np.zeros((0, 0, 0)), np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((0, 0, 0)))


def rearrange(
    bank: Bank, signatures: tuple[Signature, ...], schedule: Schedule, count: int, start_ns: int
) -> Bank:
    """Return the bank with onsets thinned, one begun at `count` where it is due, and rows for `signatures`."""
    kept = np.flatnonzero(schedule.keep(bank.onset, count))
    fresh = count % schedule.step == 0
    onset = np.append(bank.onset[kept], count) if fresh else bank.onset[kept]
    onset_ns = np.append(bank.onset_ns[kept], start_ns) if fresh else bank.onset_ns[kept]
    old, new = _matching(bank.signatures, signatures)
    s, o, k = len(signatures), len(onset), len(kept)
    E = np.zeros((bank.E.shape[0], s, o))
    num, den, gram = np.zeros((s, o)), np.zeros((s, o)), np.zeros((s, o, o))
    if k and len(old):
        E[:, new, :k] = bank.E[:, old][:, :, kept]
        num[new, :k], den[new, :k] = bank.num[old][:, kept], bank.den[old][:, kept]
        gram[new, :k, :k] = bank.gram[old][:, kept][:, :, kept]
    return Bank(signatures, onset, onset_ns, E, num, den, gram)


def _matching(old: tuple[Signature, ...], new: tuple[Signature, ...]) -> tuple[IntArray, IntArray]:
    if old is new or old == new:
        every = np.arange(len(new))
        return every, every
    where = {s: i for i, s in enumerate(old)}
    pairs = [(where[s], i) for i, s in enumerate(new) if s in where]
    both = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    return both[:, 0], both[:, 1]


def advance(
    bank: Bank, t_ns: int, keys: tuple[str, ...], F: FloatArray, H: FloatArray, L: FloatArray, K: FloatArray, white: FloatArray
) -> Bank:
    """Return the bank after one update (see `windows.respond`; `white` is ``L^-1 nu``)."""
    s, o = bank.num.shape
    growing, constant = masks(bank.signatures, keys)
    tau = (t_ns - bank.onset_ns) * 1e-9
    E = bank.E.reshape(-1, s * o) if bank.E.shape[0] == F.shape[1] else np.zeros((F.shape[1], s * o))
    prior = left(F, E)
    g = np.multiply.outer(growing, tau) + constant[:, :, None]
    g = g.reshape(len(keys), s * o)
    g -= left(H, prior)
    w = whiten(L, g)
    num, den, gram = _accumulate(w.reshape(len(keys), s, o), white, bank.num, bank.den, bank.gram)
    return Bank(bank.signatures, bank.onset, bank.onset_ns, (prior + K @ g).reshape(-1, s, o), num, den, gram)


def _accumulate(
    w: FloatArray, white: FloatArray, num: FloatArray, den: FloatArray, gram: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    by_signature = np.ascontiguousarray(w.transpose(1, 2, 0))
    inner = by_signature @ by_signature.transpose(0, 2, 1)
    return num + by_signature @ white, den + np.einsum("soo->so", inner), gram + inner


@njit(cache=True, nogil=True)
def parents(gram: FloatArray, tested: npt.NDArray[np.bool_]) -> FloatArray:
    """Return each tested hypothesis' largest correlation with an earlier onset of its signature (0: none), -1 where untested."""
    s, o = gram.shape[0], gram.shape[1]
    rho = np.full((s, o), -1.0)
    for i in range(s):
        for b in range(o):
            if not tested[b] or gram[i, b, b] <= 1e-12:
                continue
            best = 0.0
            for a in range(b):
                if tested[a] and gram[i, a, a] > 1e-12:
                    r = abs(gram[i, a, b]) / np.sqrt(gram[i, a, a] * gram[i, b, b])
                    best = max(best, r)
            rho[i, b] = best
    return rho
