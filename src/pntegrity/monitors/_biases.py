"""Nominal biases of rows, and what they make of the members of a bank."""

from __future__ import annotations

import numpy as np

from pntegrity.bounds.ism import Ism
from pntegrity.kernels.separation import Subfilters
from pntegrity.records import FloatArray, group_of

__all__ = ["with_nominal"]

PRODUCTS = ("iono:", "trop:")


def with_nominal(
    ism: Ism, bank: Subfilters, old: tuple[str, ...], keys: tuple[str, ...], groups: tuple[str, ...]
) -> tuple[tuple[str, ...], Subfilters, FloatArray]:
    """Return the rows with a nominal bias, the bank with theirs, and what they add to the rows, (c, m).

    Those of groups that are forgotten go.

    Parameters
    ----------
    ism : Ism
    bank : Subfilters
        With the biases of `old`.
    old : tuple of str
        Rows whose biases the bank carries.
    keys : tuple of str
        Rows of the epoch.
    groups : tuple of str
        Those in view or not yet forgotten.
    """
    nominal = _nominal(ism, keys)
    here = {k: (i, b) for i, (k, b) in enumerate(zip(keys, nominal.tolist(), strict=True)) if b}
    stay = [k for k in old if group_of(k) in groups]
    biased = (*stay, *(k for k in here if k not in stay))
    if not biased:
        return (), bank, np.zeros((0, len(keys)))
    out = np.zeros((len(biased), len(keys)))
    for c, key in enumerate(biased):
        if key in here:
            out[c, here[key][0]] = here[key][1]
    stood = np.array([old.index(k) if k in old else -1 for k in biased], dtype=np.intp)
    return biased, bank.with_biases(stood), out


def _nominal(ism: Ism, keys: tuple[str, ...]) -> FloatArray:
    """Return the nominal bias of each row, m, shape (m,)."""
    sizes, product = {"C": ism.b_code_m, "L": ism.b_carrier_m}, ism.b_product_m
    if not (product or any(sizes.values())):
        return np.zeros(len(keys))
    return np.array(
        [product if k.startswith(PRODUCTS) else sizes.get(k.partition(":")[2][:1], 0.0) for k in keys]
    )
