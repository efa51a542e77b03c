"""Sources of a vehicle and their sensors: what each did when, what the levels of verdicts said, in numbers.

A source is what stands before the colon of a row's key, a sensor what stands behind its kind
(``"lbl:R.AP1"``); a source with one sensor is one lane. What an epoch's own update tells is what was known at
the time: a repair that goes over earlier epochs changes nothing in them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
import numpy.typing as npt

from pntegrity.physics.time import to_iso
from pntegrity.pipeline import Outcome
from pntegrity.proving import Proof
from pntegrity.records import Verdict
from pntegrity.report.columns import HELD, is_part_of, is_vehicle, members_in
from pntegrity.report.facts import RunFacts
from pntegrity.report.risk import risk_numbers
from pntegrity.report.story import Absence, absences
from pntegrity.states import source_of

__all__ = ["Doing", "Lane", "Spans", "coarse", "doings", "lanes", "source_numbers", "spans"]

EVENTS = 200
"""How many verdicts, and how many proofs, the numbers hold."""
CLOSE = 3
"""The same verdict after so few epochs is the same event."""


class Doing(IntEnum):
    """What a source or a sensor did at an epoch, the one that matters more being larger."""

    SILENT = 0
    USED = 1
    PART = 2
    OUT = 3
    TRIED = 4
    AMBIGUOUS = 5
    SUSPECTED = 6


@dataclass(frozen=True)
class Lane:
    """A source (`sensor` empty), or one of its sensors.

    `members` are the sensors that it stands for, as `columns.member_of` calls them.
    """

    source: str
    sensor: str
    members: tuple[str, ...]

    @property
    def name(self) -> str:
        """What it is called where it is left out."""
        return f"{self.source}.{self.sensor}" if self.sensor else self.source


def lanes(outcomes: Sequence[Outcome], given: Sequence[str] = ()) -> tuple[Lane, ...]:
    """Return the sources in the order in which they appear, each with its sensors behind it, where it has
    several; and last those `given` that never do.
    """
    rows = dict.fromkeys(keys for o in outcomes for keys in (o.update.keys, o.update.spare_keys))
    members: dict[str, dict[str, None]] = {}
    for one in dict.fromkeys(m for keys in rows for m in members_in(keys)):
        members.setdefault(source_of(one), {})[one] = None
    out: list[Lane] = []
    for source, own in members.items():
        out.append(Lane(source, "", tuple(sorted(own))))
        out += [Lane(source, m.partition(".")[2], (m,)) for m in sorted(own) if len(own) > 1]
    return (*out, *(Lane(name, "", (name,)) for name in given if name not in members))


# --- what each did ----------------------------------------------------------------------------------------


def doings(outcomes: Sequence[Outcome], shown: Sequence[Lane]) -> npt.NDArray[np.int8]:
    """Return what each lane did at each epoch (`Doing`), shape (lanes, epochs).

    A source is left out where all is that it measured, and in part where some is. Who is named by a verdict
    before any exclusion, and used all the same, is suspected, or ambiguous where others are named as well.
    """
    out = np.zeros((len(shown), len(outcomes)), dtype=np.int8)
    known: dict[tuple[tuple[str, ...], tuple[str, ...]], npt.NDArray[np.int8]] = {}
    for i, o in enumerate(outcomes):
        rows = (o.update.keys, o.update.spare_keys)
        if rows not in known:
            known[rows] = _measured(*rows, shown)
        out[:, i] = known[rows]
        _judge(out[:, i], o, shown)
    return out


def _measured(
    keys: tuple[str, ...], spare_keys: tuple[str, ...], shown: Sequence[Lane]
) -> npt.NDArray[np.int8]:
    used, spare = set(members_in(keys)), set(members_in(spare_keys))

    def doing(members: tuple[str, ...]) -> Doing:
        some, more = not used.isdisjoint(members), not spare.isdisjoint(members)
        if some and more:
            return Doing.PART
        return Doing.USED if some else Doing.OUT if more else Doing.SILENT

    return np.array([doing(lane.members) for lane in shown], dtype=np.int8)


def _judge(now: npt.NDArray[np.int8], o: Outcome, shown: Sequence[Lane]) -> None:
    """Mark who is named while used, and who was tried in vain while left out."""
    named = _named(o)
    tried = {p.name for p in o.proofs if not p.passed}
    if not named and not tried:
        return
    for i, lane in enumerate(shown):
        if now[i] in (Doing.USED, Doing.PART) and lane.name in named and not _acted_on(o, lane):
            now[i] = named[lane.name]
        elif now[i] == Doing.OUT and any(is_part_of(m, name) for m in lane.members for name in tried):
            now[i] = Doing.TRIED


def _acted_on(o: Outcome, lane: Lane) -> bool:
    """Tell whether a sensor of a lane was left out at this epoch: then no verdict was without consequence."""
    return any(is_part_of(e.group, lane.source) for e in o.exclusions)


def _named(o: Outcome) -> dict[str, Doing]:
    """Return who is named, sources and sensors: suspected, or ambiguous unless another verdict is sure."""
    out: dict[str, Doing] = {}
    for v in (*o.first, *o.verdicts):
        if v.status == "alert":
            which = Doing.AMBIGUOUS if v.ambiguous else Doing.SUSPECTED
            for name in (n for names in _candidates(v) for n in names):
                for each in {name, source_of(name)}:
                    out[each] = max(which, out.get(each, Doing.SILENT))
    return out


def _candidates(v: Verdict) -> tuple[tuple[str, ...], ...]:
    """Return the sets that a verdict names: the first, or all of them where it is ambiguous; sensors where
    it tells them.
    """
    return tuple(
        tuple(f"{s.groups[0]}.{name}" for name in s.sensors) if s.sensors else s.groups
        for s in (v.suspects if v.ambiguous else v.suspects[:1])
    )


@dataclass(frozen=True, eq=False)
class Spans:
    """Stretches in which a lane did the same, shape (n,) each: from, to (ns) and what (`Doing`)."""

    start_ns: npt.NDArray[np.int64]
    end_ns: npt.NDArray[np.int64]
    doing: npt.NDArray[np.int8]

    def __len__(self) -> int:
        return len(self.doing)


def spans(t_ns: npt.NDArray[np.int64], doing: npt.NDArray[np.int8]) -> Spans:
    """Return the stretches of a lane; who measures less often than the epochs come is not silent between.

    Parameters
    ----------
    t_ns : ndarray of int64, shape (n,)
    doing : ndarray, shape (n,)
    """
    at = np.flatnonzero(doing != Doing.SILENT)
    if not len(at):
        return Spans(t_ns[:0], t_ns[:0], doing[:0])
    t, what = t_ns[at], doing[at]
    step = int(np.median(np.diff(t))) if len(t) > 1 else _step_ns(t_ns)
    follows = np.append(np.diff(t) <= HELD * step, False)
    end = np.where(follows, np.append(t[1:], 0), t + _step_ns(t_ns))
    begins = np.concatenate([[True], ~follows[:-1] | (what[1:] != what[:-1])])
    last = np.append(np.flatnonzero(begins)[1:] - 1, len(t) - 1)
    return Spans(t[begins], end[last], what[begins])


def coarse(t_ns: npt.NDArray[np.int64], done: npt.NDArray[np.int8], steps: int) -> tuple[Any, Any]:
    """Return times (steps,) and what mattered most around each, shape (lanes, steps): of runs whose every
    stretch could not be drawn.
    """
    edges = np.linspace(t_ns[0], t_ns[-1], steps, endpoint=False).astype(np.int64)
    cuts = np.unique(np.searchsorted(t_ns, edges))
    return t_ns[cuts], np.maximum.reduceat(done, cuts, axis=1)


def _step_ns(t_ns: npt.NDArray[np.int64]) -> int:
    return int(np.median(np.diff(t_ns))) if len(t_ns) > 1 else 10**9


# --- in numbers -------------------------------------------------------------------------------------------


def source_numbers(outcomes: Sequence[Outcome], facts: RunFacts) -> dict[str, Any] | None:
    """Return what the sources of a vehicle did in numbers, null where there are none.

    ========= =============================================================================================
    key       value
    ========= =============================================================================================
    sources   one entry a source: ``source``, ``sensors`` (names), ``epochs`` (with a measurement), ``used``
              (``{"epochs", "share"}`` of these: at least one of its sensors), ``left_out`` (how often it or
              one of its sensors was), ``names`` (which of them), ``readmitted``, ``silent_s`` (longest time
              between measurements, the ends of the run included)
    verdicts  alarms that belong together: ``level`` (``source``, ``sensor``, ``none``: nobody was named),
              ``monitor``, ``from``, ``to``, ``epochs``, ``named`` (sets of names, several where it is
              ambiguous), ``ambiguous``, ``left_out`` (who was left out then)
    proofs    one entry a stretch in which somebody was tried: ``name``, ``from``, ``to``, ``tests``,
              ``passed``, and of the last test ``epochs``, ``statistic``, ``limit``, ``readmission`` (the
              probability with which it passes if it is still as far off) and ``reason``
    omitted   how many ``verdicts`` and ``proofs`` are not listed: the first 200 are
    risk      see `pntegrity.report.risk.risk_numbers`; null where no integrity risk is stated
    ========= =============================================================================================
    """
    if not (facts.sources or is_vehicle(outcomes)):
        return None
    shown = lanes(outcomes, facts.sources)
    done, gone = doings(outcomes, shown), absences(outcomes)
    t_ns = np.array([o.t_ns for o in outcomes], dtype=np.int64)
    verdicts, proofs = list(_verdicts(outcomes)), list(_proofs(outcomes))
    return {
        "sources": [_source(x, done[i], gone, t_ns, shown) for i, x in enumerate(shown) if not x.sensor],
        "verdicts": verdicts[:EVENTS],
        "proofs": proofs[:EVENTS],
        "omitted": {"verdicts": len(verdicts[EVENTS:]), "proofs": len(proofs[EVENTS:])},
        "risk": risk_numbers(outcomes, facts),
    }  # fmt: skip


def _source(
    lane: Lane, done: npt.NDArray[np.int8], gone: Sequence[Absence], t_ns: npt.NDArray[np.int64],
    shown: Sequence[Lane],
) -> dict[str, Any]:  # fmt: skip
    there = done != Doing.SILENT
    epochs = int(there.sum())
    used = epochs - int(np.isin(done, (Doing.OUT, Doing.TRIED)).sum())
    own = [a for a in gone if is_part_of(a.group, lane.source)]
    ends = np.concatenate([t_ns[:1], t_ns[there], t_ns[-1:]])
    return {
        "source": lane.source,
        "sensors": [x.sensor for x in shown if x.source == lane.source and x.sensor],
        "epochs": epochs,
        "used": {"epochs": used, "share": used / epochs if epochs else 0.0},
        "left_out": len(own),
        "names": list(dict.fromkeys(a.group for a in own)),
        "readmitted": sum(a.back for a in own),
        "silent_s": float(np.diff(ends).max(initial=0)) * 1e-9,
    }


def _verdicts(outcomes: Sequence[Outcome]) -> Iterator[dict[str, Any]]:
    """Yield alarms before exclusion, those of neighbouring epochs with the same names as one."""
    open_: dict[tuple[Any, ...], dict[str, Any]] = {}
    found: list[dict[str, Any]] = []
    last: dict[tuple[Any, ...], int] = {}
    for i, o in enumerate(outcomes):
        for v in (v for v in o.first if v.status == "alert"):
            named = _candidates(v)
            key = (v.monitor, v.variant, frozenset(map(frozenset, named)), v.ambiguous)
            if key not in open_ or i - last[key] > CLOSE:
                open_[key] = _event(o, v, named)
                found.append(open_[key])
            _extend(open_[key], o)
            last[key] = i
    yield from found


def _event(o: Outcome, v: Verdict, named: tuple[tuple[str, ...], ...]) -> dict[str, Any]:
    level = "none" if not named else "sensor" if any("." in n for names in named for n in names) else "source"
    return {
        "level": level, "monitor": v.monitor, "from": to_iso(o.t_ns), "to": "", "epochs": 0,
        "named": [list(names) for names in named], "ambiguous": v.ambiguous, "left_out": [],
    }  # fmt: skip


def _extend(event: dict[str, Any], o: Outcome) -> None:
    event["to"], event["epochs"] = to_iso(o.t_ns), event["epochs"] + 1
    event["left_out"] += [e.group for e in o.exclusions if e.group not in event["left_out"]]


def _proofs(outcomes: Sequence[Outcome]) -> Iterator[dict[str, Any]]:
    """Yield the trials of who was left out, those from an exclusion to the next or to the return as one."""
    open_: dict[str, dict[str, Any]] = {}
    found: list[dict[str, Any]] = []
    tests: Counter[str] = Counter()
    for o in outcomes:
        for e in o.exclusions:
            open_.pop(e.group, None)
        for p in o.proofs:
            if p.name not in open_:
                open_[p.name], tests[p.name] = {"name": p.name, "from": to_iso(p.t_ns)}, 0
                found.append(open_[p.name])
            tests[p.name] += 1
            open_[p.name] |= {"to": to_iso(p.t_ns), "tests": tests[p.name]} | _proof(p)
            if p.passed:
                open_.pop(p.name)
    yield from found


def _proof(p: Proof) -> dict[str, Any]:
    return {
        name: getattr(p, name) for name in ("passed", "epochs", "statistic", "limit", "readmission", "reason")
    }
