"""What happened, in words: consecutive epochs merged into sentences that a person can act on."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
import numpy.typing as npt
import polars as pl

from pntegrity.exclusion import SEPARATION, Exclusion
from pntegrity.physics.time import DAY_NS
from pntegrity.pipeline import Outcome
from pntegrity.records import Status
from pntegrity.report.columns import groups_in, is_vehicle, members_in, names_in, unit_of_row
from pntegrity.report.facts import RunFacts
from pntegrity.report.inertial import FIX
from pntegrity.report.inertial_story import bridged, screened
from pntegrity.report.levels import has_bounds, only_beyond
from pntegrity.report.protection import Protected, protected
from pntegrity.report.sentences import OFTEN, Sentence, clock_time, names, span_text
from pntegrity.report.tables import solution
from pntegrity.report.units import length, level_text, measured
from pntegrity.states import is_left_out, is_satellite

__all__ = ["Absence", "absences", "cause_text", "story"]


MANY = 10
"""The same sentence about more stretches than this is told once for all of them."""
#: So many epochs back the rows of who is left out are looked for.
LOOK_BACK = 100
NUMBER = re.compile(r"\d+(\.\d+)?")


@dataclass(frozen=True)
class Absence:
    """A group that was left out: from outcome `start` until before outcome `stop`.

    `group` may be a sensor of a source (``"lbl.AP1"``). `back` tells that it proved itself, was forgotten or
    that the filter began anew before the end; `unitless`: that the size of its fault is in units of its rows.
    """

    group: str
    exclusion: Exclusion
    start: int
    stop: int
    back: bool
    vehicle: bool = False
    unit: str = "m"

    @property
    def cause(self) -> str:
        """Which test excluded it, and the fault."""
        return cause_text(self.exclusion, self.unit)


def story(
    outcomes: Sequence[Outcome], facts: RunFacts, table: pl.DataFrame | None = None
) -> tuple[Sentence, ...]:
    """Return what happened, in order of time: starts, exclusions, alerts, untested stretches, gaps, and how
    the protection levels did; `table` is what `solution` gives, where it is at hand.
    """
    if not outcomes:
        return (Sentence(0, 0, "end", "No epoch was processed."),)
    date = outcomes[-1].t_ns // DAY_NS != outcomes[0].t_ns // DAY_NS
    found = [
        *_starts(outcomes, date),
        *_excluded(outcomes, date),
        *_stretches(outcomes, date),
        *_gaps(outcomes, date),
        *bridged(outcomes, date),
    ]
    p = None
    if has_bounds(outcomes):
        p = protected(solution(outcomes, facts) if table is None else table, facts)
    found += _levels(outcomes, p, date) if p is not None else []
    found.sort(key=lambda s: (s.start_ns, s.end_ns))
    kept = _kept(outcomes, p, date) if p is not None else ()
    return (*found, *screened(outcomes, date), *kept, *_end(outcomes, facts, date))


def cause_text(e: Exclusion, unit: str = "m") -> str:
    """Return which test excluded a group, and the fault: ``GLR: ramp 0.20 m/s``; `unit`: that of its rows. A
    size of 0 is not known.
    """
    test = "epoch test" if e.monitor == "subset" else e.monitor.upper()
    if not e.size:
        return f"{test}: {e.kind}"
    if e.kind == SEPARATION:
        return f"{test}: {'bias' if e.monitor == 'subset' else 'positions apart by'} {length(e.size)}"
    return f"{test}: {e.kind} {measured(e.size, unit, '/s' if e.kind == 'ramp' else '')}"


def absences(outcomes: Sequence[Outcome]) -> list[Absence]:
    """Return who was left out from when to when, in order of exclusion."""
    out: list[Absence] = []
    standing: dict[str, tuple[Exclusion, int]] = {}
    vehicle = is_vehicle(outcomes)

    def gone(group: str, stop: int, back: bool) -> Absence:
        e, i = standing.pop(group)
        return Absence(group, e, i, stop, back, vehicle, _unit(group, outcomes[: i + 1]) if vehicle else "m")

    for i, o in enumerate(outcomes):
        used = names_in(o.update.keys) if standing else frozenset()
        out += [gone(group, i, True) for group in [g for g in standing if g in used]]
        for e in o.exclusions:
            standing.setdefault(e.group, (e, i))
        for group in o.readmitted:
            if group in standing:
                out.append(gone(group, i + 1, True))
    out += [gone(group, len(outcomes), False) for group in list(standing)]
    return sorted(out, key=lambda a: (a.start, a.stop, a.group))


def _unit(name: str, outcomes: Sequence[Outcome]) -> str:
    """Return the unit of who was left out, from the last epochs that used it; ``""``: several or unknown."""
    out = frozenset([name])
    for o in outcomes[: -LOOK_BACK - 1 : -1]:
        for update in o.updates[::-1]:
            rows = [i for i, k in enumerate(update.keys) if is_left_out(k, out)]
            units = {unit_of_row(update, i) for i in rows}
            if units:
                return units.pop() if len(units) == 1 else ""
    return ""


# --- the kinds of sentences -------------------------------------------------------------------------------


def _left(o: Outcome, vehicle: bool) -> str:
    """Return how many satellites, or sources of a vehicle and their sensors, an epoch still used."""
    keys = o.update.keys
    if not vehicle:
        return f"{len(groups_in(keys))} satellites left"
    sources, sensors = len(groups_in(keys)), len(members_in(keys))
    with_ = f" with {sensors} sensors" if sensors > sources else ""
    return f"{sources or 'no'} source{'s' * (sources != 1)} left{with_}"


def _starts(outcomes: Sequence[Outcome], date: bool) -> Iterator[Sentence]:
    """Yield starts and other events of the filter; what happens again and again gets one sentence."""
    found: dict[str, list[tuple[Outcome, str]]] = {}
    for o in outcomes:
        words = "; ".join(e for e in o.update.events if e != "start")
        running = bool(o.update.keys) or o.update.screening is not None
        if "start" in o.update.events and running:
            yield Sentence(o.t_ns, o.t_ns, "start", f"{clock_time(o.t_ns, date)}: {_started(o, words)}.")
        elif words and running:
            found.setdefault(NUMBER.sub("#", words), []).append((o, words))
    for at in found.values():
        yield from _events(at, date)


def _events(at: list[tuple[Outcome, str]], date: bool) -> Iterator[Sentence]:
    """Yield what happened, each time or as one sentence; what differs by numbers only is the same."""
    if len(at) <= OFTEN:
        for o, words in at:
            yield Sentence(o.t_ns, o.t_ns, "event", f"{clock_time(o.t_ns, date)}: {words}.")
        return
    (first, words), (last, _) = at[0], at[-1]
    first_time = "" if len({w for _, w in at}) == 1 else "; the first of them told"
    when = span_text(first.t_ns, last.t_ns, date)
    yield Sentence(first.t_ns, last.t_ns, "event", f"{when}: {words} ({len(at)} times{first_time}).")


def _started(o: Outcome, words: str) -> str:
    untested = [v.monitor.upper() for v in o.verdicts if v.status == "unavailable"]
    test = "no test possible" if len(untested) == len(o.verdicts) else f"no test yet by {names(untested)}"
    groups = groups_in(o.update.keys)
    by_satellites = all(map(is_satellite, groups)) and FIX not in groups
    source = f"{len(groups)} satellites" if by_satellites else "a fix" if FIX in groups else names(groups)
    text = f"filter started from {source}" + (f" ({words})" if words else "")
    return text + (f"; {test}" if untested else "")


def _excluded(outcomes: Sequence[Outcome], date: bool) -> Iterator[Sentence]:
    gone = absences(outcomes)
    often = {g for g, n in Counter(a.group for a in gone).items() if n > OFTEN}
    for group in sorted(often):
        yield _repeated([a for a in gone if a.group == group], outcomes, date)
    rest = [a for a in gone if a.group not in often]
    for _, same in groupby(rest, key=lambda a: (a.start, a.stop)):
        yield _absent(list(same), outcomes, date)


def _absent(together: list[Absence], outcomes: Sequence[Outcome], date: bool) -> Sentence:
    a = together[0]
    o = outcomes[a.start]
    last = outcomes[a.stop - 1].t_ns
    causes = groupby(together, key=lambda x: _cause(x, date, o.t_ns))
    grouped = [(names([x.group for x in xs]), cause) for cause, xs in causes]
    who = names([f"{g} ({cause})" for g, cause in grouped]) + " excluded"
    if len(grouped) == 1:
        who = f"{grouped[0][0]} excluded ({grouped[0][1]})"
    text = f"{span_text(o.t_ns, last, date)}: {who}; {_effect(o, a.vehicle)}"
    if any(x.exclusion.ambiguous for x in together):
        text += (
            f"; {o.reason}"
            if o.reason.startswith("ambiguous")
            else "; ambiguous: others would explain the data as well"
        )
    text += "; readmitted." if a.back else "; still excluded at the end."
    return Sentence(o.t_ns, last, "excluded", text)


def _cause(a: Absence, date: bool, now_ns: int) -> str:
    since_ns = a.exclusion.onset_ns
    return a.cause + (f" since {clock_time(since_ns, date)}" if since_ns != now_ns else "")


def _effect(o: Outcome, vehicle: bool) -> str:
    back = "the last epoch" if o.rewound == 1 else f"the last {o.rewound} epochs"
    repaired = f"filter run again over {back}, " if o.rewound else ""
    if o.update.switched:
        who = "it" if len(o.update.switched) == 1 else "them"
        repaired += f"filter goes on from the subfilter that never used {who}, "
    kept = (
        "position kept"
        if o.status == "ok"
        else "alert not resolved"
        if o.status == "alert"
        else "no test left"
    )
    return f"{repaired}{kept}, {_left(o, vehicle)}"


def _repeated(gone: list[Absence], outcomes: Sequence[Outcome], date: bool) -> Sentence:
    first, last = outcomes[gone[0].start].t_ns, outcomes[gone[-1].stop - 1].t_ns
    share = sum(a.stop - a.start for a in gone) / len(outcomes)
    tests = names(
        sorted(
            {"epoch test" if a.exclusion.monitor == "subset" else a.exclusion.monitor.upper() for a in gone}
        )
    )
    who = f"{gone[0].group} excluded {len(gone)} times by {tests}, {100 * share:.0f} % of the run"
    text = f"{span_text(first, last, date)}: {who}"
    return Sentence(
        first, last, "excluded", text + ("." if gone[-1].back else "; still excluded at the end.")
    )


def _stretches(outcomes: Sequence[Outcome], date: bool) -> Iterator[Sentence]:
    """Yield unresolved alerts and unavailable stretches; what comes very often gets one sentence."""
    found: dict[tuple[Status, str], list[list[Outcome]]] = {}
    for status, run in groupby(outcomes, key=lambda o: o.status):
        stretch = list(run)
        if status == "alert":
            found.setdefault((status, f"{_alarm(stretch)}{{}}. Do not use the position."), []).append(stretch)
        elif status != "ok":
            found.setdefault((status, f"no test possible ({_common_reason(stretch)}){{}}."), []).append(
                stretch
            )
    for (status, text), stretches in found.items():
        for first, last, often in _merged(stretches):
            when = span_text(first.t_ns, last.t_ns, date)
            yield Sentence(first.t_ns, last.t_ns, status, f"{when}: {often.join(text.rsplit('{}', 1))}")  # type: ignore[arg-type]


def _merged(stretches: list[list[Outcome]]) -> Iterator[tuple[Outcome, Outcome, str]]:
    """Yield first and last outcome of each stretch, or of all of them together, with how many there are."""
    if len(stretches) <= MANY:
        yield from ((x[0], x[-1], "") for x in stretches)
        return
    epochs = sum(map(len, stretches))
    yield stretches[0][0], stretches[-1][-1], f" ({len(stretches)} times, {epochs} epochs)"


def _alarm(stretch: list[Outcome]) -> str:
    monitors = sorted({v.monitor.upper() for o in stretch for v in o.verdicts if v.status == "alert"})
    reasons = Counter(r for o in stretch for r in o.reason.split("; ") if r).most_common(2)
    blamed = Counter(
        "+".join(v.suspect_groups) for o in stretch for v in o.verdicts if v.status == "alert" and v.suspects
    )
    who = f", most often suspecting {blamed.most_common(1)[0][0]}" if blamed else ""
    why = f" ({'; '.join(r for r, _ in reasons)})" if reasons else ""
    alert = "alert" if any(map(only_beyond, stretch)) else "unresolved alert"
    return (f"unresolved alarm of {names(monitors)}" if monitors else alert) + who + why


def _common_reason(stretch: list[Outcome]) -> str:
    reasons = Counter(r for o in stretch for r in [o.reason, *(v.reason for v in o.verdicts)] if r)
    return reasons.most_common(1)[0][0] if reasons else "no reason given"


def _gaps(outcomes: Sequence[Outcome], date: bool) -> Iterator[Sentence]:
    t = np.array([o.t_ns for o in outcomes], dtype=np.int64)
    step = np.diff(t)
    usual = int(np.median(step)) if len(step) else 0
    for i in np.flatnonzero(step > 1.5 * usual) if usual else []:
        a, b = int(t[i]), int(t[i + 1])
        missing = max(round((b - a) / usual) - 1, 1)
        yield Sentence(a, b, "gap", f"{span_text(a, b, date)}: no data ({missing} epochs missing).")


def _levels(outcomes: Sequence[Outcome], p: Protected, date: bool) -> Iterator[Sentence]:
    """Yield where levels were of no use, and where an error was beyond its own without an alert."""
    large = p.ok & p.given & ~p.unbounded & ~p.available
    for which, kind, tell in (
        (p.unbounded & ~p.misleading, "unavailable", _no_level),
        (large & ~p.misleading, "unavailable", _large_level),
        (p.misleading, "alert", _misled),
    ):
        runs = _runs(which)
        if len(runs) > OFTEN:
            runs = [(runs[0][0], runs[-1][1])]
        for start, stop in runs:
            first, last = outcomes[start].t_ns, outcomes[stop - 1].t_ns
            inside = np.flatnonzero(which[start:stop]) + start
            often = f" ({len(inside)} epochs)" if len(inside) < stop - start else ""
            text = f"{span_text(first, last, date)}: {tell(p, inside)}{often}."
            yield Sentence(first, last, kind, text)  # type: ignore[arg-type]


def _runs(which: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return first and past-the-last index of each stretch that is true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], which, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _no_level(p: Protected, at: npt.NDArray[np.intp]) -> str:
    why = Counter(p.reason[i] for i in at.tolist() if p.reason[i]).most_common(1)
    return "no finite protection level" + (f" ({why[0][0]})" if why else "")


def _large_level(p: Protected, at: npt.NDArray[np.intp]) -> str:
    said = [
        f"{a.name} up to {length(float(a.level[at].max()))} against {length(a.limit)}"
        for a in p.axes
        if (a.level[at] > a.limit).any()
    ]
    return f"protection level beyond the alert limit ({names(said)})"


def _misled(p: Protected, at: npt.NDArray[np.intp]) -> str:
    said = []
    for a in p.axes:
        beyond = at[a.beyond[at]]
        if len(beyond):
            worst = beyond[np.argmax(a.error[beyond] / a.level[beyond])]
            size, level = length(float(a.error[worst])), length(float(a.level[worst]))
            said.append(f"{a.name} {size} against {level}")
    return f"error beyond its protection level without an alert (worst {names(said)})"


def _kept(outcomes: Sequence[Outcome], p: Protected, date: bool) -> Iterator[Sentence]:
    """Yield how large the levels were, and whether they held; nothing where none was finite."""
    if not any(np.isfinite(a.level).any() for a in p.axes):
        return
    level = (level_text(float(np.quantile(a.level[p.given], 0.5, method="higher"))) for a in p.axes)
    text = "protection levels of {} horizontal and {} vertical (median)".format(*level)
    compared, misled = int(p.compared.sum()), int(p.misleading.sum())
    if not p.has_truth:
        text += "; no truth was given to hold them against"
    elif misled:
        text += f"; the error was beyond them without an alert at {misled} of {compared} epochs"
    else:
        text += f"; the error never left them without an alert ({compared} epochs compared)"
    first, last = outcomes[0].t_ns, outcomes[-1].t_ns
    yield Sentence(first, last, "alert" if misled else "end", f"{span_text(first, last, date)}: {text}.")


def _end(outcomes: Sequence[Outcome], facts: RunFacts, date: bool) -> Iterator[Sentence]:
    t = outcomes[-1].t_ns
    if facts.interrupted:
        said = f"interrupted here; the {len(outcomes)} epochs done so far are kept"
        yield Sentence(t, t, "end", f"{clock_time(t, date)}: {said}.")
    elif all(o.status == "ok" for o in outcomes) and not any(o.exclusions for o in outcomes):
        said = f"{len(outcomes)} epochs, no alarm, nothing excluded"
        yield Sentence(outcomes[0].t_ns, t, "end", f"{span_text(outcomes[0].t_ns, t, date)}: {said}.")
