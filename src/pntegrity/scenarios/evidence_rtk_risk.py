"""Misleading information of PPP-RTK where errors last longer than the filter assumes, and faults happen."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from pntegrity.evaluate.intervals import binomial_interval
from pntegrity.scenarios._real_logs import Row, row, skipped
from pntegrity.scenarios._rtk_risk_runs import (
    COUNTED_P_FA,
    ONSETS,
    SHAPES,
    SIZES,
    Campaign,
    Figures,
    campaign,
)
from pntegrity.scenarios._rtk_simulated import facts, isms, sky

__all__ = ["risk"]

NAME = "rtk-risk"
#: So many trials count as one in intervals: pairings and neighbouring epochs of a run have the same noise.
ALIKE = 10
#: Filters: span of ``ppp_rtk.toml``, epochs, runs, truths.
FILTERS = (
    ("white, 1 Hz", 601, 400, ("assumed",)),
    ("default, 30 s", 121, 1500, ("assumed", "slower", "harsher")),
    ("default, 1 Hz", 121, 500, ("slower", "harsher")),
)
WORDS = {"white": "published filter", "default": "default filter"}


def risk(data: Path) -> list[Row]:
    """Return the figures of the published and the default filter under lasting errors and faults."""
    g = facts()["geometry"]
    if not (data / g["folder"] / g["sp3"]).is_file():
        return skipped(NAME, f"{g['folder']}/{g['sp3']} is not here")
    found = [campaign(sky(data), *f) for f in FILTERS]
    return [r for c in found for truth in c.figures for r in _rows(c, truth)]


def _rows(c: Campaign, truth: str) -> Iterator[Row]:
    f, must = c.figures[truth], not c.label.startswith("white")
    t = facts()["truth"][truth]
    who = WORDS[c.label.partition(",")[0]]
    label = (
        f"{who}, {c.label.partition(', ')[2]}, code and carrier {t['correlated_tau_s']:g} s, products "
        f"{t['product_tau_s'] / 60:g} min"
    )
    minutes = (len(c.bounds) - 1) * c.step_s / 60.0
    yield _ratio_row(f, label, truth, must, c.step_s)
    yield _left_row(f, label, minutes, must)
    yield _hidden_row(c, f, label, must)
    if must:
        yield _worst_row(c, f, label)
    yield _alert_row(f, label, c, must and truth == "assumed")


def _ratio_row(f: Figures, label: str, truth: str, must: bool, step_s: float) -> Row:
    ratio = np.array(f.ratio)
    start = ratio[1 : max(round(60.0 / step_s), 2)]
    last = ratio[len(ratio) // 2 :]
    text = f"{last.min():.2f}-{last.max():.2f}"
    held = bool(last.min() >= 0.9 and last.max() <= 1.1)
    return row(
        NAME, f"{label}: true over stated sigma", "0.9 to 1.1" if truth == "assumed" and must else "stated",
        text, held if truth == "assumed" and must else None,
        note=f"second half of the span; in the first minute {start.min():.2f}-{start.max():.2f}; exact",
    )  # fmt: skip


def _left_row(f: Figures, label: str, minutes: float, must: bool) -> Row:
    n = len(f.now)
    end, ever = int(f.now.sum()), int(f.outside.sum())
    return row(
        NAME, f"{label}: runs outside the case 4 level after {minutes:g} min, no fault",
        "none" if must else "stated", f"{end} of {n}", end == 0 if must else None,
        interval=binomial_interval(end, n),
        note=f"{ever} of {n} at some epoch; beyond a level and no alert at {f.misled} of {f.tests} epochs; "
        f"exact probability at the worst epoch {max(f.beyond):.2g}",
    )  # fmt: skip


def _hidden_row(c: Campaign, f: Figures, label: str, must: bool) -> Row:
    """Weigh what was counted of drawn faults by the probabilities of their modes."""
    rate = np.divide(f.hits, f.trials, out=np.zeros_like(f.hits), where=f.trials > 0)
    clean = max(f.beyond) if must else f.misled / f.tests
    value = float(c.probability @ rate) + clean
    hits, trials = f.hits.sum() / ALIKE, f.trials.sum() / ALIKE
    low, high = binomial_interval(int(np.ceil(hits)), int(trials))
    total = float(c.probability.sum())
    interval = [
        total * low + clean,
        total * high + (clean if must else binomial_interval(f.misled, f.tests)[1]),
    ]
    return row(
        NAME, f"{label}: P(error > level and no alert), drawn faults", f"at most {c.allowed:.2g}" if must else
        "stated", value, interval[1] <= c.allowed if must else None, interval=interval,
        note=f"{f.hits.sum():.0f} hidden in {f.trials.sum():.0f} faults of {len(f.hits)} modes, sizes "
        f"{SIZES[0]:g} to {SIZES[1]:g} of what the own test allows; weight {total:.2g}, and "
        f"{clean:.2g} without a fault ({'exact' if must else 'counted'})",
    )  # fmt: skip


def _worst_row(c: Campaign, f: Figures, label: str) -> Row:
    value = max(f.risk)
    return row(
        NAME, f"{label}: the same, every fault of the worst size", f"at most {c.allowed:.2g}",
        value, value <= c.allowed,
        note=f"exact covariances, worst of {len(SHAPES) * ONSETS} shapes and onsets a mode, own tests only "
        f"(a bound); worst of {len(f.risk)} epochs, median {np.median(f.risk):.2g}",
    )  # fmt: skip


def _alert_row(f: Figures, label: str, c: Campaign, must: bool) -> Row:
    hours = f.tests * c.step_s / 3600.0
    counted, begun = f.counted / f.tests, f.begun / hours
    stated, union, mean = isms("even")["case4"].p_fa, max(f.union), float(np.mean(f.union))
    return row(
        NAME, f"{label}: false alerts an epoch, all tests together, mean",
        f"at most {stated:g}" if must else "stated",
        mean, mean <= stated if must else None,
        note=f"sum of all tests, exact, worst epoch {union:.2g}; {f.alerts} of {f.tests} epochs; at a P_FA "
        f"of {COUNTED_P_FA:g}: {counted:.2g} an epoch, {begun:.2g} alerts begin an hour, which is "
        f"{begun / COUNTED_P_FA:.0f} independent epochs",
    )  # fmt: skip
