"""Sentences about what an INS bridged, and what a filter's own fault detection left out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from pntegrity.estimators._ins_solution import solution_of
from pntegrity.pipeline import Outcome
from pntegrity.report.columns import is_vehicle
from pntegrity.report.inertial import Outage, outages
from pntegrity.report.screening import screening_numbers
from pntegrity.report.sentences import OFTEN, Sentence, names, span_text
from pntegrity.report.units import length

__all__ = ["bridged", "screened"]

TOLD_S = 5.0
"""A shorter stretch without GNSS gets no sentence."""
MOST = 3
"""How many satellites and reasons a sentence names."""


def bridged(outcomes: Sequence[Outcome], date: bool) -> Iterator[Sentence]:
    """Yield the stretches that an INS went through without GNSS; of many, the longest and how many."""
    if not any(solution_of(o.update.posterior) is not None for o in (*outcomes[-1:], *outcomes[:1])):
        return
    found = [o for o in outages(outcomes) if o.seconds >= TOLD_S]
    what = "any source" if is_vehicle(outcomes) else "GNSS"
    worst = max(found, key=lambda o: o.seconds, default=None)
    for o in found if len(found) <= OFTEN else [w for w in [worst] if w is not None]:
        more = f"; {len(found) - 1} shorter ones" if len(found) > OFTEN else ""
        yield Sentence(
            o.start_ns,
            o.end_ns,
            "gap",
            f"{span_text(o.start_ns, o.end_ns, date)}: {_bridged(o, what)}{more}.",
        )


def _bridged(o: Outage, what: str) -> str:
    a, b = o.sigma_m
    grew = f": horizontal sigma grew from {length(a)} to {length(b)}" if np.isfinite([a, b]).all() else ""
    return f"{o.seconds:.4g} s without {what}, bridged by the INS{grew}" + (
        "" if o.ended else "; it lasts to the end"
    )


def screened(outcomes: Sequence[Outcome], date: bool) -> Iterator[Sentence]:
    """Yield what the estimator's own fault detection left out, and the epochs that it did not use."""
    s = screening_numbers(outcomes)
    if s is None:
        return
    first, last = outcomes[0].t_ns, outcomes[-1].t_ns
    text = (
        f"{span_text(first, last, date)}: fault detection before the filter ({s['method']}, {s['variant']}) "
    )
    yield Sentence(
        first, last, "excluded" if s["dropped"]["rows"] else "end", f"{text}{_dropped(s)}{_unused(s)}."
    )


def _dropped(s: Mapping[str, Any]) -> str:
    d = s["dropped"]
    if not d["rows"]:
        return "left out no row"
    who = names([f"{r['satellite']} ({r['rows']})" for r in d["satellites"][:MOST]])
    often = f", most often of {who}" if len(d["satellites"]) > MOST else f", of {who}"
    return f"left out {d['rows']} rows at {d['epochs']} of {s['epochs']} epochs{often}"


def _unused(s: Mapping[str, Any]) -> str:
    unused = s["epochs"] - s["used"]["epochs"]
    why = "; ".join(f"{r} ({n})" for r, n in list(s["reasons"].items())[:MOST])
    return f"; {unused} epochs were not used: {why}" if unused else ""
