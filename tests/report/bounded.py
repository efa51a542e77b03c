"""Protection levels put into the verdicts of a run, by hand."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

from pntegrity.pipeline import Outcome
from pntegrity.records import Bound, Verdict

INF = math.inf
SIGMA = (0.3, 0.4, 0.8)
PROMISE = {
    "p_sat": 1e-5, "p_constellation": 1e-4, "p_trop": 0.0, "satellites": {"G05": 1e-3},
    "constellations": {"E": {"p_sat": 2e-5, "p_constellation": 0.0}}, "p_hmi": 1e-7, "exposure_s": 3600.0,
    "independent_epochs": 50.0, "split": [0.25, 0.25, 0.5], "p_fa": 1e-6, "fa_split": [0.25, 0.25, 0.5],
    "unmonitored_share": 0.8, "max_modes": 300, "b_code_m": 0.5, "hal_m": 10.0, "val_m": 15.0, "noise": {},
}  # fmt: skip
"""What an integrity support message tells."""
Give = Callable[[int], Bound | None]


def bound(east: float = 3.0, north: float = 4.0, up: float = 8.0, **facts: object) -> Bound:
    """Return a bound: 5 m horizontal, 8 m vertical."""
    given: dict[str, object] = {"dominant": ("G05", "", "trop"), "smallest_m": (1.5, 2.0, 8.0), "modes": 20}
    return Bound(east, north, up, SIGMA, **(given | facts))  # type: ignore[arg-type]


def verdict(o: Outcome, given: Bound | None, monitor: str = "separation") -> Verdict:
    """Return a verdict with a bound for an epoch."""
    return Verdict(monitor, "exact", o.t_ns, "ok", 1.0, 5.0, 1e-6, 1, bound=given)


def with_bounds(outcomes: Sequence[Outcome], *monitors: Give) -> list[Outcome]:
    """Return the outcomes with one more monitor for each function that gives the bound of epoch k."""
    out = []
    for k, o in enumerate(outcomes):
        more = tuple(verdict(o, give(k), f"separation{i or ''}") for i, give in enumerate(monitors))
        out.append(replace(o, verdicts=o.verdicts + more, first=o.first + more))
    return out
