"""What a fault looks like on the rows of an epoch: which rows it touches, and how it grows.

A row that measures the rate of its group (range rate beside range) has a key whose signal starts with ``D``
(``"G05:D1C"``); every other row measures a level. A fault of a whole group or family that grows on the levels
is a constant on the rates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


def is_rate(key: str) -> bool:
    """Tell whether a row measures a rate."""
    return key.partition(":")[2].startswith("D")


def is_carrier(key: str) -> bool:
    """Tell whether a row measures a carrier phase."""
    return key.partition(":")[2].startswith("L")


def family_of(key: str) -> str:
    """Return what shares a clock with a group: its leading letters (``"G05:C1C"`` -> ``"G"``)."""
    group = key.partition(":")[0]
    return group.rstrip("0123456789") or group


@dataclass(frozen=True)
class Signature:
    """A fault of unit size.

    Parameters
    ----------
    groups : tuple of str
        Who is at fault.
    kind : str
        ``"bias"`` or ``"ramp"``.
    level, rate : tuple of str
        Keys of the rows it touches. A bias is 1 on both; a ramp is the time since its onset on `level` and 1
        on `rate`.
    """

    groups: tuple[str, ...]
    kind: str
    level: tuple[str, ...]
    rate: tuple[str, ...] = ()


@lru_cache(maxsize=256)
def catalogue(keys: tuple[str, ...], kind: str) -> tuple[Signature, ...]:
    """Return the faults of one kind worth looking for among `keys`: single rows, whole groups, whole
    families.

    Of a group with code and carrier levels (signals ``C..`` and ``L..``), a bias is looked for on each row
    and a ramp on all together: a filter that estimates the carrier's ambiguity cannot tell a ramp of the
    carrier from one of the satellite, its carrier row sees nearly all of a common jump, and a ramp of the
    code alone is a code bias to it. The order of `keys` does not matter: a fault is the same hypothesis from
    epoch to epoch, however its rows come.
    """
    keys = tuple(sorted(keys))
    levels, rates = _by_group([k for k in keys if not is_rate(k)]), _by_group([k for k in keys if is_rate(k)])
    mixed = {g for g, ks in levels.items() if len({is_carrier(k) for k in ks}) > 1}
    found = [
        Signature((g,), kind, (k,))
        for g, ks in levels.items()
        for k in ks
        if kind == "bias" or g not in mixed
    ]
    if kind == "bias":
        found += [Signature((g,), kind, (), (k,)) for g, ks in rates.items() for k in ks]
    for g, ks in levels.items():
        wide_rate = tuple(rates.get(g, ())) if kind == "ramp" else ()
        if (len(ks) > 1 or wide_rate) and (kind == "ramp" or g not in mixed):
            found.append(Signature((g,), kind, tuple(ks), wide_rate))
    return tuple(found) + _families(keys, kind)


def _families(keys: tuple[str, ...], kind: str) -> tuple[Signature, ...]:
    members: dict[str, list[str]] = {}
    for k in keys:
        members.setdefault(family_of(k), []).append(k)
    found = []
    for ks in members.values():
        groups = tuple(dict.fromkeys(k.partition(":")[0] for k in ks))
        level = tuple(k for k in ks if not is_rate(k))
        rate = tuple(k for k in ks if is_rate(k)) if kind == "ramp" else ()
        if len(groups) > 1 and level:
            found.append(Signature(groups, kind, level, rate))
    return tuple(found)


def _by_group(keys: Sequence[str]) -> dict[str, list[str]]:
    out: dict[str, list[str]] = {}
    for k in keys:
        out.setdefault(k.partition(":")[0], []).append(k)
    return out


@lru_cache(maxsize=256)
def masks(signatures: tuple[Signature, ...], keys: tuple[str, ...]) -> tuple[FloatArray, FloatArray]:
    """Return where signatures touch rows: `growing` (times the time since onset) and `constant`, shapes (m,
    s).
    """
    row = {k: i for i, k in enumerate(keys)}
    growing = np.zeros((len(keys), len(signatures)))
    constant = np.zeros((len(keys), len(signatures)))
    for c, s in enumerate(signatures):
        target = growing if s.kind == "ramp" else constant
        target[[row[k] for k in s.level if k in row], c] = 1.0
        constant[[row[k] for k in s.rate if k in row], c] = 1.0
    growing.flags.writeable = False
    constant.flags.writeable = False
    return growing, constant


@lru_cache(maxsize=256)
def rows_touched(keys: tuple[str, ...], kind: str) -> tuple[FloatArray, FloatArray]:
    """Return the `masks` of the whole `catalogue` of one kind."""
    return masks(catalogue(keys, kind), keys)
