"""What sentences of the story are made of: their kinds, times of day, lists of names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from pntegrity.physics.time import to_iso

__all__ = ["OFTEN", "Kind", "Sentence", "clock_time", "kind_words", "names", "span_text"]

Kind = Literal["start", "event", "excluded", "alert", "unavailable", "gap", "end"]
OFTEN = 3
"""What happens more often than this gets one sentence for all of it."""


@dataclass(frozen=True)
class Sentence:
    """One thing that happened: when, of which kind, and in words (the time included)."""

    start_ns: int
    end_ns: int
    kind: Kind
    text: str


def clock_time(t_ns: int, date: bool = False) -> str:
    """Return the time of day (GPS time), to 0.1 s where it has decimals; `date` puts the date in front."""
    tenth = 100_000_000
    text = to_iso((t_ns + tenth // 2) // tenth * tenth)
    return text.replace("T", " ") if date else text[11:]


def span_text(start_ns: int, end_ns: int, date: bool = False) -> str:
    """Return ``06:22:10-06:24:31``, or one time where both are the same."""
    start, end = clock_time(start_ns, date), clock_time(end_ns, date)
    return start if start == end else f"{start}-{end}"


def kind_words(of_sensors: bool) -> tuple[str, str, str]:
    """Return what code, carrier and rate are called; `of_sensors`: where the rows are those of any sensor."""
    return ("Measurement", "Carrier", "Rate") if of_sensors else ("Code", "Carrier", "Range rate")


def names(groups: Sequence[str], most: int = 6) -> str:
    """Return ``G05, G07 and E11``; a long list is cut, with its length."""
    groups = list(dict.fromkeys(groups))
    if len(groups) > most:
        return f"{', '.join(groups[: most - 1])} and {len(groups) - most + 1} more"
    return " and ".join(filter(None, [", ".join(groups[:-1]), groups[-1]])) if groups else "none"
