"""Protection levels of PPP-RTK in the paper's four cases: white and lasting errors, beside a prototype."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from pntegrity.bounds.ism import Ism
from pntegrity.evaluate.linear_risk import fresh_share
from pntegrity.monitors.separation import Separation
from pntegrity.physics.frames import enu_rotation
from pntegrity.records import Bound, FloatArray, State, Update
from pntegrity.scenarios._real_logs import Row, row, skipped
from pntegrity.scenarios._rtk_simulated import Sky, estimator, facts, isms, model, sky

__all__ = ["Span", "cases", "in_order", "span_of", "submetre_s"]

NAME = "rtk-cases"
TIMES_S = (0, 60, 600, 3600)
#: Levels of cases may differ by this much of themselves the wrong way: rounding of the root.
ROUNDING = 1e-9
#: Epochs are counted from here: the filter has converged to decimetres.
SETTLED_S = 600.0
#: Standard deviations of an error whose probability is 1e-7.
LARGE = 5.3267


@dataclass(frozen=True, eq=False)
class Span:
    """Levels of one filter over a time; shapes (cases, epochs), and (cases, epochs, 3) of east, north, up.

    `independent` is what an hour of epochs from `SETTLED_S` on is worth, east, north and up: how often an
    error of `LARGE` standard deviations begins anew, over how probable it is.
    """

    label: str
    step_s: float
    level_m: FloatArray
    sigma_m: FloatArray
    smallest_m: FloatArray
    satellites: tuple[int, int]
    independent: FloatArray

    @property
    def hpl_m(self) -> FloatArray:
        """Horizontal levels."""
        return np.asarray(np.hypot(self.level_m[..., 0], self.level_m[..., 1]))

    @property
    def vpl_m(self) -> FloatArray:
        """Vertical levels."""
        return np.asarray(self.level_m[..., 2])

    def at(self, time_s: int) -> list[list[float]]:
        """Return HPL and VPL of each case at a time, to 1 cm."""
        k = round(time_s / self.step_s)
        pairs = zip(self.hpl_m[:, k].tolist(), self.vpl_m[:, k].tolist(), strict=True)
        return [[_rounded(h), _rounded(v)] for h, v in pairs]


def _rounded(value: float) -> float:
    return round(value, 2 if value < 10.0 else 1)


def span_of(where: Sky, name: str, split: str, epochs: int | None = None) -> Span:
    """Return the levels of a span of ``ppp_rtk.toml``; `epochs`: only the first."""
    kind, step_s, n = facts()["spans"][name]
    noise, rng = model(kind), np.random.default_rng(facts()["seeds"]["simulated"])
    one, state = estimator(noise), State.empty()
    monitors = [_Levels(ism) for ism in isms(split).values()]
    axes, last = enu_rotation(where.place_m), None
    counts, fresh = [], []
    for epoch in where.epochs(noise, step_s, epochs or n, rng):
        update = one.correct(one.predict(state, epoch), epoch)
        state = update.posterior
        for monitor in monitors:
            monitor.push(update)
        counts.append(sum(len(g) == 3 for g in update.groups()))
        if last is not None and (len(counts) - 1) * step_s >= SETTLED_S:
            fresh.append(fresh_share(last, update, axes, LARGE))
        last = update
    table = np.array([[_numbers(b) for b in m.bounds] for m in monitors])
    worth = np.mean(fresh, axis=0) * 3600.0 / step_s if fresh else np.full(3, np.nan)
    return Span(
        name, step_s, table[:, :, :3], table[:, :, 3:6], table[:, :, 6:], (min(counts), max(counts)), worth
    )


class _Levels:
    """Protection levels of one integrity support message, epoch by epoch."""

    def __init__(self, ism: Ism) -> None:
        self._monitor = Separation(p_fa=ism.p_fa, ism=ism, pairs=False)
        self._memory: Any = self._monitor.start()
        self.bounds: list[Bound] = []

    def push(self, update: Update) -> None:
        """Take one update."""
        verdict, self._memory = self._monitor.step(self._memory, update)
        if verdict.bound is None:
            raise RuntimeError(f"no protection level: {verdict.reason}")
        self.bounds.append(verdict.bound)


def _numbers(b: Bound) -> list[float]:
    return [b.east_m, b.north_m, b.up_m, *b.sigma_m, *b.smallest_m]


def submetre_s(level_m: FloatArray, step_s: float, limit_m: float) -> float | None:
    """Return from when on a level stays below a limit; None: at the end it does not."""
    above = np.flatnonzero(~(level_m < limit_m))
    first = int(above[-1]) + 1 if len(above) else 0
    return first * step_s if first < len(level_m) else None


def in_order(span: Span) -> int:
    """Return at how many epochs the levels fall from one case to the next."""
    falls = np.diff(span.level_m, axis=0) < -ROUNDING * span.level_m[1:]
    return int(falls.any(axis=(0, 2)).sum())


@lru_cache(maxsize=16)
def _known(data: Path, name: str, split: str) -> Span:
    return span_of(sky(data), name, split)


def cases(data: Path) -> list[Row]:
    """Return the levels of the four cases: when, in which order, how tight, and what epochs are worth."""
    g = facts()["geometry"]
    if not (data / g["folder"] / g["sp3"]).is_file():
        return skipped(NAME, f"{g['folder']}/{g['sp3']} is not here")
    wanted = [(n, s) for n in facts()["spans"] for s in ("araim", "even") if s == "even" or n in _printed()]
    spans = [(_known(data, n, s), s) for n, s in wanted]
    rows = [r for span, split in spans if split == "araim" for r in _beside(span)]
    even = [span for span, split in spans if split == "even"]
    rows += [r for span in even for r in _even(span)]
    rows += [_order_row(span, split) for span, split in spans]
    rows += [_submetre_row(span) for span in even]
    rows += [_tightness_row(span, split) for span, split in spans]
    return rows + [_independent_row(span) for span in even]


def _printed() -> dict[str, Any]:
    """Return the prototype's levels by span."""
    found: dict[str, Any] = facts()["prototype"]
    return found


def _beside(span: Span) -> list[Row]:
    """Return levels with ARAIM's split beside those of the prototype."""
    printed = _printed()[span.label]
    few, most = span.satellites
    note = f"cases 1 to 4, HPL/VPL; beside: the prototype, 17-18 satellites; here {few}-{most}"
    return [
        row(NAME, f"{span.label}, split 1:1:98, {_when(t)}", _pairs(printed.get(str(t), [])) or "stated",
            _pairs(span.at(t)), note=note)
        for t in TIMES_S if t % span.step_s == 0 and str(t) in printed
    ]  # fmt: skip


def _even(span: Span) -> list[Row]:
    return [
        row(NAME, f"{span.label}, split 1/4, 1/4, 1/2, {_when(t)}", "stated", _pairs(span.at(t)),
            note="cases 1 to 4, HPL/VPL")
        for t in TIMES_S if t % span.step_s == 0
    ]  # fmt: skip


def _when(time_s: int) -> str:
    return "start" if not time_s else f"{time_s // 60} min"


def _pairs(levels: Sequence[Sequence[float]]) -> str:
    return ", ".join(f"{p[0]:g}/{p[1]:g}" if p else "-" for p in levels)


def _order_row(span: Span, split: str) -> Row:
    wrong = in_order(span)
    text = f"{span.level_m.shape[1] - wrong} of {span.level_m.shape[1]} epochs"
    return row(
        NAME, f"{span.label}, split {SPLITS[split]}: case 1 <= 2 <= 3 <= 4, each direction", "every epoch",
        text, wrong == 0,
    )  # fmt: skip


SPLITS = {"araim": "1:1:98", "even": "1/4, 1/4, 1/2"}


def _submetre_row(span: Span) -> Row:
    limit = facts()["published"]["level_m"]
    found = [
        "/".join(_since(submetre_s(level[k], span.step_s, limit)) for level in (span.hpl_m, span.vpl_m))
        for k in range(len(span.level_m))
    ]
    return row(
        NAME, f"{span.label}: HPL/VPL stay below {limit:g} m from", "stated", ", ".join(found),
        note="cases 1 to 4, s after the start; split 1/4, 1/4, 1/2",
    )  # fmt: skip


def _since(time_s: float | None) -> str:
    return "never" if time_s is None else f"{time_s:g}"


def _tightness_row(span: Span, split: str) -> Row:
    """Return how far levels are above the least that any formula could give for the same tests."""
    k = round(60.0 / span.step_s)
    over = span.level_m[:, k:] / span.smallest_m[:, k:] - 1.0
    multiple = np.median(span.level_m[:, k:] / span.sigma_m[:, k:], axis=(1, 2))
    least = np.median(span.smallest_m[:, k:] / span.sigma_m[:, k:], axis=(1, 2))
    text = ", ".join(f"{a:.2f} ({b:.2f})" for a, b in zip(multiple, least, strict=True))
    middle, top = 100.0 * float(np.median(over[-1])), 100.0 * float(over.max())
    return row(
        NAME, f"{span.label}, split {SPLITS[split]}: median level / sigma (least possible), cases 1 to 4",
        "stated", text,
        note=f"after 1 min, all directions; case 4 above the least: median {middle:.1f} %, "
        f"any case at most {top:.1f} %",
    )  # fmt: skip


def _independent_row(span: Span) -> Row:
    e, n, u = span.independent.tolist()
    apart = ", ".join(f"{3600.0 / v:.0f}" for v in (e, n, u))
    return row(
        NAME, f"{span.label}: independent epochs an hour, east, north, up", "stated",
        ", ".join(f"{v:.0f}" for v in (e, n, u)),
        note=f"how often an error of {LARGE:.1f} sigma begins anew, over its probability, from 10 min; one "
        f"every {apart} s; in the filter's model",
    )  # fmt: skip
