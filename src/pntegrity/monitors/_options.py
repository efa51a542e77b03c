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


def check_epochs(name: str, value: object, least: int) -> None:
    """Refuse a number of epochs that is not whole or too small."""
    if not isinstance(value, Integral) or isinstance(value, bool) or value < least:
        raise ValueError(f"`{name}` must be a whole number of at least {least} epochs, not {value!r}")


def window_lengths(window: object) -> int | tuple[int, ...]:
    """Return a window length, or several in ascending order, after a check."""
    if not isinstance(window, list | tuple):
        check_epochs("window", window, 1)
        return int(window)  # type: ignore[call-overload, no-any-return]
    for length in window:
        check_epochs("window", length, 1)
    if not window or len(set(window)) < len(window):
        raise ValueError(f"`window` must be one length or several different ones, not {window!r}")
    return tuple(sorted(int(length) for length in window))


def check_block(block: str) -> None:
    """Refuse what is no name of states, and no names joined by ``+``."""
    if not isinstance(block, str) or (block and not all(block.split("+"))):
        raise ValueError(f"`block` must be a name of states such as 'pos', or 'pos+amb', not {block!r}")


def check_sets(name: str, most: object, p_identify: float) -> None:
    """Refuse a largest set of faults that is not 1, 2 or 3, or a probability of not finding them that is
    none.

    Raises
    ------
    ValueError
        Naming the option and the value.
    """
    if not isinstance(most, int) or not 1 <= most <= 3:
        raise ValueError(f"`{name}` must be a whole number from 1 to 3, not {most!r}")
    if not 0.0 < p_identify < 0.5:
        raise ValueError(f"`p_identify` must be a probability below 0.5, not {p_identify!r}")
