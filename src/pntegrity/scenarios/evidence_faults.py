"""Faults injected into the real static BRUX log, through the whole pipeline: who is left out, and how far off
the position is.

Every trial begins at a checkpoint of a clean run a few epochs before its onset, so that hundreds of onsets
take minutes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pntegrity.estimators.spp import Spp
from pntegrity.estimators.spp_kf import SppKf
from pntegrity.evaluate.intervals import binomial_interval
from pntegrity.exclusion import Policy
from pntegrity.kernels.linear import cholesky
from pntegrity.kernels.subsets import search
from pntegrity.pipeline import Checkpoint, Outcome, Pipeline
from pntegrity.records import Epoch, FloatArray, State, Update, group_of
from pntegrity.scenarios._real_logs import BRUX, Row, Site, monitors, row, skipped, without_groups
from pntegrity.scenarios.evidence_real import P_FA, site_of
from pntegrity.sensors.noise import NoiseModel
from pntegrity.sensors.pseudoranges import code_rows
from pntegrity.simulate.faults import Fault, apply_faults

__all__ = ["faults", "greedy"]

#: Epochs between checkpoint and onset, of a bias, of a ramp, and after a bias until its satellite must be
#: back.
BEFORE, BIAS, RAMP, BACK = 2, 20, 60, 40
#: Epochs a filter runs on few satellites before the onset.
SETTLE = 60


@dataclass(frozen=True)
class Scenario:
    """A kind of faults that come at once: how many, on how many constellations, course, range of sizes (m or
    m/s).
    """

    words: str
    satellites: int
    systems: int
    kind: str
    sizes: tuple[float, float]


SCENARIOS = (
    Scenario("three satellites of two constellations, 40-100 m", 3, 2, "bias", (40.0, 100.0)),
    Scenario("one satellite, 15 m", 1, 1, "bias", (15.0, 15.0)),
    Scenario("one satellite, 0.1 m/s ramp", 1, 1, "ramp", (0.1, 0.1)),
)


@dataclass(frozen=True)
class Result:
    """What came of one trial: faults, who was left out since the onset, largest error, who was back."""

    faults: tuple[Fault, ...]
    excluded: frozenset[str]
    worst_m: float
    back: frozenset[str]
    delay: int | None

    @property
    def guilty(self) -> frozenset[str]:
        """The satellites at fault."""
        return frozenset(f.groups for f in self.faults)


def faults(data: Path, trials: int = 50, rng: np.random.Generator | None = None) -> list[Row]:
    """Return who is found and left out, in full view and on few satellites.

    Parameters
    ----------
    data : Path
        Folder that holds the folder of the log.
    trials : int
        Random satellites, sizes and onsets of each scenario.
    rng : numpy.random.Generator, optional
        That of seed 0 where not given.
    """
    missing = BRUX.missing(data)
    if missing:
        return skipped("faults", missing)
    rng = rng or np.random.default_rng(0)
    site = site_of(data)
    rows = []
    for name, noise in site.models().items():
        for scenario in SCENARIOS:
            rows += _summary(scenario, name, list(_trials(site, noise, scenario, trials, rng)))
    for name, noise in site.models().items():
        for count in (16, 10, 8):
            rows += _few(site, name, noise, count, 2 * trials, rng)
    return rows


# --- all satellites
# ---------------------------------------------------------------------------------------------------


def _trials(
    site: Site, noise: NoiseModel, scenario: Scenario, trials: int, rng: np.random.Generator
) -> Iterator[Result]:
    length = BEFORE + (RAMP if scenario.kind == "ramp" else BIAS + BACK)
    onsets = np.sort(rng.integers(site.half + BEFORE, len(site.epochs) - length, trials))
    for onset, start in _checkpoints(site, noise, [int(o) for o in onsets]):
        span = site.epochs[onset - BEFORE : onset - BEFORE + length]
        chosen = _draw(scenario, _in_view(site, noise, span), span[BEFORE].t_ns, rng)
        yield _run(site, noise, span, onset - BEFORE, start, chosen)


def _pipeline(site: Site, noise: NoiseModel, checkpoint: Checkpoint | None = None) -> Pipeline:
    return Pipeline(SppKf(site.options(noise)), monitors(P_FA, noise), Policy(p_fa=P_FA), checkpoint)


def _checkpoints(site: Site, noise: NoiseModel, onsets: Sequence[int]) -> Iterator[tuple[int, Checkpoint]]:
    """Run the clean log once; yield what it remembers shortly before each onset (ascending)."""
    pipeline, at = _pipeline(site, noise), 0
    for onset in onsets:
        for epoch in site.epochs[at : onset - BEFORE]:
            pipeline.push(epoch)
        at = max(at, onset - BEFORE)
        yield onset, pipeline.checkpoint


def _in_view(site: Site, noise: NoiseModel, span: Sequence[Epoch]) -> tuple[str, ...]:
    """Return the satellites above the mask at both ends of a span."""
    first, last = (set(_directions(site, noise, e)) for e in (span[0], span[-1]))
    return tuple(sorted(first & last))


def _draw(
    scenario: Scenario, view: Sequence[str], onset_ns: int, rng: np.random.Generator
) -> tuple[Fault, ...]:
    """Return random faults: satellites of exactly as many constellations as the scenario says."""
    while True:
        satellites = rng.choice(view, scenario.satellites, replace=False)
        if len({s[0] for s in satellites}) == scenario.systems:
            break
    sizes = rng.uniform(*scenario.sizes, scenario.satellites) * rng.choice((-1.0, 1.0), scenario.satellites)
    ramp = scenario.kind == "ramp"
    end = None if ramp else onset_ns + BIAS * 1_000_000_000
    kind, order = ("ramp", 1) if ramp else ("bias", 0)
    return tuple(
        Fault(str(s), "", kind, float(z), order, begin_ns=onset_ns, stop_ns=end, absolute=True)  # type: ignore[arg-type]
        for s, z in zip(satellites, sizes, strict=True)
    )


def _run(
    site: Site,
    noise: NoiseModel,
    span: Sequence[Epoch],
    first: int,
    start: Checkpoint,
    chosen: tuple[Fault, ...],
) -> Result:
    pipeline = _pipeline(site, noise, start)
    outcomes = [pipeline.push(e) for e in apply_faults(span, chosen)]
    guilty = {f.groups for f in chosen}
    errors = site.horizontal_m([o.update.posterior.mean[:3] for o in outcomes], first)
    found = [k - BEFORE for k, o in enumerate(outcomes) if guilty & set(o.update.excluded)]
    return Result(
        chosen,
        frozenset(g for o in outcomes[BEFORE:] for g in o.update.excluded),
        float(np.max(errors)),
        frozenset(g for g in guilty if g not in pipeline.checkpoint.standing),
        min(found, default=None),
    )


def _summary(scenario: Scenario, name: str, results: Sequence[Result]) -> list[Row]:
    n, words = len(results), f"{scenario.words}, {name} noise model"
    found = sum(r.guilty <= r.excluded for r in results)
    wrong = Counter(g for r in results for g in r.excluded - r.guilty)
    clean = n - sum(bool(r.excluded - r.guilty) for r in results)
    worst = max(r.worst_m for r in results)
    strict = name == "calibrated"
    late = [r.delay for r in results if r.delay is not None]
    blamed = ", ".join(f"{g} {c}" for g, c in wrong.most_common(5))
    missed = ", ".join(sorted({f.groups for r in results for f in r.faults if f.groups not in r.excluded}))
    delay = f"median delay {np.median(late):.0f} s" if late else "never"
    rows = [
        row(
            "faults",
            f"all found: {words}",
            "all",
            f"{found} of {n}",
            found == n if strict else None,
            interval=binomial_interval(found, n),
            note=delay + (f"; missed: {missed}" if missed else ""),
        ),
        row(
            "faults",
            f"no other excluded: {words}",
            "all",
            f"{clean} of {n}",
            clean == n if strict else None,
            interval=binomial_interval(clean, n),
            note=f"wrongly: {blamed}" if blamed else "",
        ),
        row(
            "faults",
            f"largest horizontal error: {words}, m",
            "below 3",
            worst,
            worst < 3.0 if strict else None,
        ),
    ]
    if scenario.kind == "bias":
        back = sum(r.back == r.guilty for r in results)
        quantity = f"all used again {BACK} s after the end: {words}"
        rows.append(row("faults", quantity, "stated", f"{back} of {n}", interval=binomial_interval(back, n)))
    return rows


# --- few satellites
# -------------------------------------------------------------------------------------------------


def _few(
    site: Site, name: str, noise: NoiseModel, count: int, trials: int, rng: np.random.Generator
) -> list[Row]:
    """Return how often three faults among `count` satellites are sorted out by the filter and by two snapshot
    searches.
    """
    tallies: dict[str, Counter[str]] = {
        "filter": Counter(),
        "snapshot, smallest subset": Counter(),
        "snapshot, greedy": Counter(),
    }
    for onset in rng.integers(site.half, len(site.epochs) - 1, trials):
        span, chosen = _small_sky(site, noise, int(onset), count, rng)
        guilty = frozenset(f.groups for f in chosen)
        faulty = apply_faults(span, chosen)
        pipeline = Pipeline(SppKf(site.options(noise)), monitors(P_FA, noise, ("rctm",)), Policy(p_fa=P_FA))
        tallies["filter"][_verdict([pipeline.push(e) for e in faulty][-1], guilty)] += 1
        single = Pipeline(Spp(site.options(noise)), monitors(P_FA, noise, ("rctm",)), Policy(p_fa=P_FA))
        outcome = single.push(faulty[-1])
        tallies["snapshot, smallest subset"][_verdict(outcome, guilty)] += 1
        estimator = Spp(site.options(noise))
        update = estimator.correct(estimator.predict(State.empty(), faulty[-1]), faulty[-1])
        tallies["snapshot, greedy"][_greedy_verdict(update, guilty)] += 1
    return [_few_row(how, name, count, tally) for how, tally in tallies.items()]


def _few_row(how: str, name: str, count: int, tally: Counter[str]) -> Row:
    n, strict = tally.total(), how == "filter" and name == "calibrated"
    honest = tally["exact"] + tally["ambiguous"] + tally["alert"]
    quantity = f"{count} satellites, three at fault (40-100 m): exact set by {how}, {name} noise model"
    note = (
        f"{tally['ambiguous']} reported as ambiguous, {tally['alert']} as unresolved alert,"
        f" {tally['wrong']} wrong without a word, of {n}"
    )
    good = tally["exact"] / n
    ok = (tally["exact"] + tally["ambiguous"]) / n >= 0.98 and honest / n >= 0.98
    must = "at least 0.98, or ambiguity reported" if strict else "stated"
    return row(
        "faults",
        quantity,
        must,
        good,
        ok if strict else None,
        interval=binomial_interval(tally["exact"], n),
        note=note,
    )


def _small_sky(
    site: Site, noise: NoiseModel, onset: int, count: int, rng: np.random.Generator
) -> tuple[list[Epoch], tuple[Fault, ...]]:
    """Return the epochs before an onset with only `count` satellites of a usable geometry, and three faults
    among them.
    """
    span = site.epochs[onset - SETTLE : onset + 1]
    view = _in_view(site, noise, span)
    los = _directions(site, noise, span[-1])
    while True:
        systems = rng.choice(
            sorted({s[0] for s in view}), 4 if count > 10 else 3 if count > 8 else 2, replace=False
        )
        among = [s for s in view if s[0] in systems]
        if len(among) < count:
            continue
        keep = [str(s) for s in rng.choice(among, count, replace=False)]
        members = Counter(s[0] for s in keep)
        if len(members) == len(systems) and min(members.values()) >= 2 and position_dilution(keep, los) < 4.0:
            break
    kept = [without_groups(e, frozenset(keep)) for e in span]
    return kept, _draw(SCENARIOS[0], keep, span[-1].t_ns, rng)


def _directions(site: Site, noise: NoiseModel, epoch: Epoch) -> dict[str, FloatArray]:
    rows = code_rows(epoch, np.array(site.log.truth_m), site.options(noise))
    return {group_of(k): v for k, v in zip(rows.keys, rows.los, strict=True)}


def position_dilution(satellites: Sequence[str], los: dict[str, FloatArray]) -> float:
    """Return the PDOP of satellites with a clock for each constellation, inf where they do not give a
    position.
    """
    systems = sorted({s[0] for s in satellites})
    A = np.array([[*-los[s], *(float(s[0] == c) for c in systems)] for s in satellites])
    if len(A) < A.shape[1] or np.linalg.matrix_rank(A) < A.shape[1]:
        return float("inf")
    return float(np.sqrt(np.trace(np.linalg.inv(A.T @ A)[:3, :3])))


def _verdict(outcome: Outcome, guilty: frozenset[str]) -> str:
    """Return ``exact``, ``ambiguous`` (said so), ``alert`` (did not find its way, and said so) or ``wrong``
    (silent).
    """
    if frozenset(outcome.update.excluded) == guilty:
        return "exact"
    if any(e.ambiguous for e in outcome.exclusions):
        return "ambiguous"
    return "alert" if outcome.status != "ok" else "wrong"


def _greedy_verdict(update: Update, guilty: frozenset[str]) -> str:
    removed, passed = greedy(update, P_FA)
    return "exact" if removed == guilty and passed else "wrong" if passed else "alert"


def greedy(update: Update, p_fa: float) -> tuple[frozenset[str], bool]:
    """Leave out the most suspicious group again and again, as most receivers do; return who, and whether the
    rest agrees.
    """
    keep = np.arange(len(update.keys))
    while len(keep) > update.consumed:
        groups = tuple(dict.fromkeys(group_of(update.keys[i]) for i in keep))
        rows = [np.array([j for j, i in enumerate(keep) if group_of(update.keys[i]) == g]) for g in groups]
        L = cholesky(np.ascontiguousarray(update.S[np.ix_(keep, keep)]))
        result = search(update.nu[keep], L, rows, update.consumed, p_fa, largest=1)
        gone = frozenset(map(group_of, update.keys)) - frozenset(groups)
        if not result.removed:
            return gone, result.passed
        keep = np.delete(keep, rows[result.removed[0]])
    return frozenset(map(group_of, update.keys)), False
