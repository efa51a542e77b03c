"""What every monitor checks of its options when it is built."""

from __future__ import annotations

from numbers import Integral, Real

EITHER = ("exact", "published")


def check_test(p_fa: float, factor: float, variant: str, variants: tuple[str, ...] = EITHER) -> None:
    """Refuse a false-alarm probability, a threshold factor or a variant that cannot be.

    Raises
    ------
    ValueError
        Naming the field, the value and what is allowed.
    """
    if not (isinstance(p_fa, Real) and 0.0 < p_fa < 0.5):
        raise ValueError(f"`p_fa` must be a probability above 0 and below 0.5, not {p_fa!r}")
    if not (isinstance(factor, Real) and 0.0 < factor < float("inf")):
        raise ValueError(f"`factor` must be a finite number above 0, not {factor!r}")
    if variant not in variants:
        raise ValueError(f"`variant` must be {' or '.join(map(repr, variants))}, not {variant!r}")


def check_epochs(name: str, value: int, least: int) -> None:
    """Refuse a number of epochs that is not whole or too small."""
    if not isinstance(value, Integral) or isinstance(value, bool) or value < least:
        raise ValueError(f"`{name}` must be a whole number of at least {least} epochs, not {value!r}")


def check_block(block: str) -> None:
    """Refuse what is no name of states."""
    if not isinstance(block, str):
        raise ValueError(f"`block` must be a name of states such as 'pos', not {block!r}")
