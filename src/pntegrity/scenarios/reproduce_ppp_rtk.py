"""The PPP-RTK integrity paper's figures again: accuracy, protection levels of four cases, a clock fault.

The paper's log and products are not public: the receiver is simulated, under the real orbits of another day
where the data folder is given. `white` is the paper's filter on errors as it takes them, `default` is this
package's on errors that last as it takes them.

References
----------
Wang et al. (2022), Integrity monitoring of PPP-RTK based on multiple hypothesis solution separation.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import special

from pntegrity.estimators.ppp_rtk import PppRtk
from pntegrity.evaluate.intervals import binomial_interval
from pntegrity.exclusion import Policy
from pntegrity.monitors.separation import Separation
from pntegrity.physics.frames import enu_rotation
from pntegrity.pipeline import Checkpoint, Outcome, Pipeline
from pntegrity.records import Epoch, State, Update
from pntegrity.scenarios._rtk_simulated import (
    Sky,
    errors_m,
    estimator,
    facts,
    isms,
    model,
    sky,
    updates_of,
)
from pntegrity.scenarios.evidence_rtk_cases import Span, in_order, span_of, submetre_s
from pntegrity.scenarios.reproduce_sraime_spp import Result, Row, row
from pntegrity.simulate.faults import apply_faults, parse_fault

__all__ = ["ClockFault", "Named", "clock_faults", "named", "reproduce"]

MODELS = ("white", "default")
WORDS = {"white": "white errors", "default": "lasting errors"}
P_FA = 1e-6
#: Epochs of 1 s: of accuracy and levels, of a clock fault (and of the time after it), before a blame.
ACCURACY, LEVELS, FAULT, BEFORE = 301, 1201, 150, 50
#: Faults whose blame is counted, m on code and carrier.
SIZES_M = (0.1, 0.2, 0.5, 1.0, 5.0)
#: When levels are told, s.
TIMES_S = (0, 60, 600, 1200)
#: Seeds of the runs that take longest.
MOST_SEEDS = 5


def reproduce(seeds: int = 3, *, data: Path | None = None) -> Result:
    """Run the experiment.

    Parameters
    ----------
    seeds : int
        Noise realisations; no more than 5 are used, and one for the clock faults, which go to every
        satellite.
    data : Path, optional
        Folder of the real logs; with it the orbits are real.
    """
    if seeds < 1:
        raise ValueError(f"`seeds` must be at least 1, not {seeds}")
    where, seeds = sky(data), min(seeds, MOST_SEEDS)
    rows = [row("geometry", None, where.label, None, "observations and products are simulated, 1 Hz")]
    rows += [_accuracy_row(where, name, seeds) for name in MODELS]
    for name in MODELS:
        span = span_of(where, f"{name}, 1 Hz", "even", LEVELS)
        rows += [*_case_rows(span, name), _false_alert_row(span, name)]
        rows += _misprint_rows(span) if name == "white" else []
    for name in MODELS:
        rows += _fault_rows(clock_faults(where, name), name)
        rows += _named_rows([named(where, name, seed) for seed in range(seeds)], name)
    return Result(tuple(rows), "PPP-RTK, solution separation")


def _epochs(where: Sky, name: str, n: int, seed: int) -> tuple[Epoch, ...]:
    rng = np.random.default_rng([facts()["seeds"]["simulated"], seed])
    return where.epochs(model(name), 1.0, n, rng)


def _accuracy_row(where: Sky, name: str, seeds: int) -> Row:
    printed = facts()["published"]
    limits = printed["horizontal_m"], printed["vertical_m"]
    runs = [updates_of(_epochs(where, name, ACCURACY, s), model(name)) for s in range(seeds)]
    e = np.array([errors_m(r, where.place_m) for r in runs])
    found = np.hypot(e[..., 0], e[..., 1]), np.abs(e[..., 2])
    since = [submetre_s(f.max(axis=0), 1.0, limit) for f, limit in zip(found, limits, strict=True)]
    rms = [float(np.sqrt((f[:, -60:] ** 2).mean())) for f in found]
    note = f"largest error of {seeds} runs of 5 min; rms of the last minute {rms[0]:.3f} m, {rms[1]:.3f} m"
    measured = {"horizontal, s": since[0], "vertical, s": since[1]}
    label = f"errors stay below {limits[0]:g} m horizontally, {limits[1]:g} m vertically from: {WORDS[name]}"
    return row(label, "soon after the start", measured, None not in since, note)


# --- protection levels --------------------------------------------------------------------------------------


def _case_rows(span: Span, name: str) -> Iterator[Row]:
    limit = facts()["published"]["level_m"]
    for k, case in enumerate(facts()["cases"]):
        since = [submetre_s(v[k], span.step_s, limit) for v in (span.hpl_m, span.vpl_m)]
        times = [t for t in TIMES_S if t < span.level_m.shape[1] * span.step_s]
        at = "; ".join(f"{t} s {span.at(t)[k][0]:g}/{span.at(t)[k][1]:g}" for t in times)
        yield row(
            f"HPL and VPL stay below {limit:g} m from, s: {case}, {WORDS[name]}", "submeter",
            {"HPL": since[0], "VPL": since[1]}, None not in since, f"HPL/VPL, m: {at}",
        )  # fmt: skip
    wrong = in_order(span)
    yield row(
        f"levels are lower when probabilities are lower: {WORDS[name]}", "every epoch",
        f"{span.level_m.shape[1] - wrong} of {span.level_m.shape[1]} epochs", wrong == 0,
        "case 1 <= 2 <= 3 <= 4 in each direction",
    )  # fmt: skip


def _misprint_rows(span: Span) -> Iterator[Row]:
    """Say what (13) would mean as it is printed: the risk of an error *below* the level."""
    share = isms("even")["case4"].split[2]
    z = span.level_m[-1, -1, 2] / span.sigma_m[-1, -1, 2]
    beyond, risk = 2.0 * float(special.ndtr(-z)), share * facts()["published"]["p_hmi_per_h"]
    yield row(
        "(13) as printed, P(error < PL), without a fault, up", risk, 1.0 - beyond, False,
        f"a misprint: the risk is that of an error beyond the level, here {beyond:.1g} at most {risk:.1g}",
    )  # fmt: skip


def _false_alert_row(span: Span, name: str) -> Row:
    worth = float(span.independent.max())
    measured = P_FA * worth if np.isfinite(worth) else None
    note = (
        f"(12) has no time: per epoch it is {P_FA:g}; an hour of 3600 epochs counted as independent would be "
        f"{3600 * P_FA:.2g}; independent are {worth:.0f} (how often large errors begin anew, from 10 min on)"
    )
    return row(f"false alerts an hour that (12) amounts to: {WORDS[name]}", None, measured, None, note)


# --- a clock fault ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ClockFault:
    """What became of a 5 m clock fault of one satellite.

    Parameters
    ----------
    satellite : str
    alarm_s : int or None
        First alarm, s after the onset.
    right : bool
        Only this satellite was left out at that epoch.
    inside : bool
        No error beyond a level at any epoch that had no alert, before, during and after the fault.
    worst : float
        Largest error over its level, in any direction.
    back_s : int or None
        When it was used again, s after the onset.
    wrong : tuple of str
        Others that were left out at any time.
    """

    satellite: str
    alarm_s: int | None
    right: bool
    inside: bool
    worst: float
    back_s: int | None
    wrong: tuple[str, ...]


def clock_faults(where: Sky, name: str, satellites: Sequence[str] | None = None) -> list[ClockFault]:
    """Put the paper's fault on each satellite in turn (or on some), through the whole pipeline."""
    first, last = facts()["published"]["fault_s"]
    epochs = _epochs(where, name, FAULT, 100)
    pipeline = _pipeline(name)
    before = [pipeline.push(e) for e in epochs[: first - 5]]
    chosen = satellites or sorted(g for g in before[-1].update.groups() if len(g) == 3)
    start = pipeline.checkpoint
    return [_one_fault(where, name, s, epochs, start, before, first, last) for s in chosen]


def _pipeline(name: str, checkpoint: Checkpoint | None = None) -> Pipeline:
    monitor = Separation(p_fa=P_FA, ism=isms("even")["case4"])
    policy = Policy(p_fa=P_FA, **PppRtk.policy)
    return Pipeline(estimator(model(name)), (monitor,), policy, checkpoint)


def _one_fault(
    where: Sky, name: str, sat: str, epochs: Sequence[Epoch], start: Checkpoint, before: list[Outcome],
    first: int, last: int,
) -> ClockFault:  # fmt: skip
    size = facts()["published"]["fault_m"]
    fault = parse_fault(f"{sat}:* bias {size:g} m {first}:{last}")
    pipeline = _pipeline(name, start)
    faulty = list(apply_faults(epochs, [fault]))
    outcomes = [*before, *(pipeline.push(e) for e in faulty[len(before) :])]
    out = [{e.group for e in o.exclusions} for o in outcomes]
    after = range(first, len(outcomes))
    at = next((k for k in after if any(v.status == "alert" for v in outcomes[k].first)), None)
    back = next((k - first for k in after if sat in outcomes[k].readmitted), None)
    worst = max(_over(o, where) for o in outcomes)
    return ClockFault(
        sat, None if at is None else at - first, at is not None and out[at] == {sat}, worst <= 1.0, worst,
        back, tuple(sorted(set().union(*out) - {sat})),
    )  # fmt: skip


def _over(outcome: Outcome, where: Sky) -> float:
    """Return the largest error over its level; 0 where there is an alert or no level."""
    bound = outcome.verdicts[0].bound
    if bound is None or outcome.status == "alert":
        return 0.0
    error = enu_rotation(where.place_m) @ (outcome.update.posterior.mean[:3] - where.place_m)
    return float(np.max(np.abs(error) / np.array([bound.east_m, bound.north_m, bound.up_m])))


def _fault_rows(found: Sequence[ClockFault], name: str) -> Iterator[Row]:
    n, size = len(found), facts()["published"]["fault_m"]
    label = f"{size:g} m clock fault, each of {n} satellites: {WORDS[name]}"
    seen, right = sum(f.alarm_s == 0 for f in found), sum(f.right for f in found)
    late = ", ".join(f"{f.satellite} after {f.alarm_s} s" for f in found if f.alarm_s != 0)
    yield row(f"{label}: alarm at the first faulty epoch", "at once", f"{seen} of {n}", seen == n, late)
    missed = ", ".join(f.satellite for f in found if not f.right)
    low, _ = binomial_interval(right, n)
    yield row(
        f"{label}: it alone is left out at the alarm", None, f"{right} of {n}", right >= 0.99 * n,
        f"not: {missed}" if missed else f"99 % interval from {100 * low:.0f} %",
    )  # fmt: skip
    early = [f for f in found if f.back_s is not None and f.back_s < _lasts_s()]
    others = ", ".join(f"{f.satellite}: {'+'.join(f.wrong)}" for f in found if f.wrong)
    yield row(
        f"{label}: used again before the fault ended", None, f"{len(early)} of {n}", not early,
        f"its code proves itself epoch by epoch, with a new ambiguity; left out later: {others or 'none'}",
    )  # fmt: skip
    inside, worst = sum(f.inside for f in found), max(f.worst for f in found)
    yield row(
        f"{label}: error inside the level at all epochs", None, f"{inside} of {n}", inside == n,
        f"largest error over level {worst:.2f}",
    )  # fmt: skip


def _lasts_s() -> int:
    first, last = facts()["published"]["fault_s"]
    return int(last - first)


# --- who is blamed ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Named:
    """How often faults were seen, how often the two rules named the right one first, and how often the
    re-test named a wrong one without saying that others explain the data as well.
    """

    alerts: int = 0
    published: int = 0
    exact: int = 0
    sure: int = 0

    def __add__(self, other: Named) -> Named:
        names = ("alerts", "published", "exact", "sure")
        return Named(*(getattr(self, n) + getattr(other, n) for n in names))


def named(where: Sky, name: str, seed: int) -> Named:
    """Count whom the largest normalised separation and the re-test name, each satellite and size in turn."""
    updates = updates_of(_epochs(where, name, BEFORE + 1, 200 + seed), model(name))
    ism = isms("even")["case4"]
    monitors = [Separation(p_fa=P_FA, ism=ism, variant="published"), Separation(p_fa=P_FA, ism=ism)]
    memories: list[Any] = [m.start() for m in monitors]
    for u in updates[:-1]:
        memories = [m.step(memory, u)[1] for m, memory in zip(monitors, memories, strict=True)]
    total, last = Named(), updates[-1]
    for sat in (g for g in last.groups() if len(g) == 3):
        for size in SIZES_M:
            faulty = _with_fault(last, sat, size)
            first, second = (m.step(x, faulty)[0] for m, x in zip(monitors, memories, strict=True))
            if second.status == "alert":
                plain, exact = first.suspect_groups == (sat,), second.suspect_groups == (sat,)
                total += Named(1, int(plain), int(exact), int(not exact and not second.ambiguous))
    return total


def _with_fault(update: Update, sat: str, size_m: float) -> Update:
    """Return the update as it were with a fault on a satellite's code and carrier."""
    fault = size_m * np.array([k.startswith(f"{sat}:") for k in update.keys])
    p = update.posterior
    moved = State(p.t_ns, p.mean + update.K @ fault, p.P, p.layout)
    return replace(update, nu=update.nu + fault, posterior=moved)


def _named_rows(found: Sequence[Named], name: str) -> Iterator[Row]:
    total = sum(found, Named())
    sizes = ", ".join(f"{s:g}" for s in SIZES_M)
    note = f"{total.alerts} alerts at faults of {sizes} m on code and carrier, {BEFORE} s after the start"
    for label, wrong in (
        ("largest normalised separation", total.alerts - total.published),
        ("worst re-test", total.alerts - total.exact),
        ("worst re-test and not told to be ambiguous", total.sure),
    ):
        n = max(total.alerts, 1)
        low, high = binomial_interval(wrong, n)
        yield row(
            f"wrong one named by the {label}, %: {WORDS[name]}", None, round(100.0 * wrong / n, 1), None,
            f"{wrong} of {n} (99 %: {100 * low:.1f} to {100 * high:.1f} %); {note}",
        )  # fmt: skip
