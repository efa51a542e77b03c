"""The figure of a vehicle's sources: a lane each, with its sensors below, and what each did when."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from pntegrity.report.columns import is_part_of
from pntegrity.report.figures import UNIX_GPS_MS, Figure, Frame, safe
from pntegrity.report.sentences import clock_time
from pntegrity.report.sources import Doing, Lane, Spans, coarse, doings, lanes, spans
from pntegrity.report.story import Absence

__all__ = ["LOOKS", "left_px", "sources"]

MOST = 6000
"""More stretches than this are drawn as what mattered most in each of `STEPS` of the run."""
STEPS = 700
LANE_PX, BETWEEN = 15, 0.55
"""Height of a lane, and the space between two sources, lanes."""
LONGEST = 11
"""Characters of a name on the axis."""
LOOKS: dict[Doing, tuple[str, str, str]] = {
    Doing.USED: ("used", "--used", ""),
    Doing.PART: ("used without some of its sensors", "--used", "--alert"),
    Doing.OUT: ("left out", "--alert", ""),
    Doing.TRIED: ("left out, tried in vain", "--alert-soft", "--alert"),
    Doing.AMBIGUOUS: ("used, one of several that may be at fault", "--E", ""),
    Doing.SUSPECTED: ("used, named by a verdict", "--ink", ""),
}
"""What each is called, its colour, and that of the stripes on it."""


def left_px(f: Frame, given: Sequence[str]) -> int:
    """Return the room that the names need at the left of all figures with a time axis."""
    longest = max((len(_cut(lane.name)) for lane in lanes(f.outcomes, given)), default=0)
    return max(62, 16 + 7 * longest)


def sources(f: Frame, given: Sequence[str] = ()) -> Figure:
    """Return what each source and sensor did: stretches of the same as one bar, gaps where it was silent.

    Sources `given` have a lane also where they never measured. A thin line leads from the estimated onset to
    where somebody was left out, a diamond marks the return.
    """
    shown = lanes(f.outcomes, given)
    y: list[float] = []
    top = 0.0
    for lane in shown:
        top += 0.0 if lane.sensor or not y else BETWEEN
        y.append(-top)
        top += 1.0
    ticks = [f"<b>{safe(_cut(x.source))}</b>" if not x.sensor else safe(_cut(x.sensor)) for x in shown]
    layout = {
        "barmode": "overlay", "hovermode": "closest", "margin": {"t": 8}, "bargap": 0,
        "yaxis": {
            "tickmode": "array", "tickvals": y, "ticktext": ticks, "range": [-top + 0.2, 0.8],
            "fixedrange": True, "showgrid": False,
        },
    }  # fmt: skip
    data = [*_bars(f, shown, y), *_onsets(f, shown, y)]
    return Figure("sources", data, layout, 44 + round(LANE_PX * (top + 0.6)))


def _cut(name: str) -> str:
    return name if len(name) <= LONGEST else f"{name[: LONGEST - 1]}…"


def _bars(f: Frame, shown: Sequence[Lane], y: Sequence[float]) -> list[dict[str, Any]]:
    t_ns = np.array([o.t_ns for o in f.outcomes], dtype=np.int64)
    done = doings(f.outcomes, shown)
    found = [spans(t_ns, row) for row in done]
    many = sum(map(len, found)) > MOST
    if many:
        t_ns, done = coarse(t_ns, done, STEPS)
        found = [spans(t_ns, row) for row in done]
    gone = [() if many else _absences(f, lane) for lane in shown]
    out = [_bar(what, shown, found, gone, y) for what in LOOKS]
    return [bar for bar in out if bar["y"]]


Gone = tuple[int, int, str]
"""Who was left out, from when until when, and why."""


def _absences(f: Frame, lane: Lane) -> tuple[Gone, ...]:
    """Return when a lane, its source or any of its sensors was left out."""
    mine = (a for a in f.gone if any(is_part_of(m, a.group) for m in lane.members))
    return tuple(
        (f.outcomes[a.start].t_ns, f.outcomes[a.stop - 1].t_ns, f"{safe(a.group)}: {safe(a.cause)}")
        for a in mine
    )


def _bar(
    what: Doing, shown: Sequence[Lane], found: Sequence[Spans], gone: Sequence[tuple[Gone, ...]],
    y: Sequence[float],
) -> dict[str, Any]:  # fmt: skip
    word, colour, stripes = LOOKS[what]
    at = [(i, k) for i, s in enumerate(found) for k in np.flatnonzero(s.doing == what).tolist()]
    begin = np.array([found[i].start_ns[k] for i, k in at], dtype=np.int64)
    end = np.array([found[i].end_ns[k] for i, k in at], dtype=np.int64)
    marker: dict[str, Any] = {"color": colour, "line": {"width": int(what > Doing.PART), "color": colour}}
    if stripes:
        marker["pattern"] = {"shape": "/", "bgcolor": colour, "fgcolor": stripes, "size": 6, "solidity": 0.4}
    return {
        "type": "bar", "orientation": "h", "y": [y[i] for i, _ in at], "base": _ms(begin),
        "x": ((end - begin) / 1e6).tolist(), "width": [0.5 if shown[i].sensor else 0.82 for i, _ in at],
        "marker": marker, "name": word,
        "customdata": [_text(shown[i].name, word, found[i], k, gone[i]) for i, k in at],
        "hovertemplate": "%{customdata}<extra></extra>",
    }  # fmt: skip


def _ms(t_ns: npt.NDArray[np.int64]) -> list[float]:
    return [float(t) for t in t_ns / 1e6 + UNIX_GPS_MS]


def _text(name: str, word: str, s: Spans, k: int, gone: tuple[Gone, ...]) -> str:
    begin, end = int(s.start_ns[k]), int(s.end_ns[k])
    lines = [f"<b>{safe(name)}</b> {word}", f"{clock_time(begin)} to {clock_time(end)}"]
    if s.doing[k] in (Doing.OUT, Doing.TRIED, Doing.PART):
        lines += [why for first, last, why in gone if first < end and last >= begin][:3]
    return "<br>".join(lines)


def _onsets(f: Frame, shown: Sequence[Lane], y: Sequence[float]) -> list[dict[str, Any]]:
    """Return the lines from the onsets, and the marks of who came back."""
    place = {lane.name: at for lane, at in zip(shown, y, strict=True)}
    known = [(a, place[a.group]) for a in f.gone if a.group in place]
    old = [(a, at) for a, at in known if a.exclusion.onset_ns < _start_ns(f, a)]
    lines = {
        "type": "scatter", "mode": "lines", "hoverinfo": "skip", "line": {"color": "--alert", "width": 2},
        "x": [x for a, _ in old for x in (*_ms(_times(a.exclusion.onset_ns, _start_ns(f, a))), None)],
        "y": [v for _, at in old for v in (at, at, None)],
    }  # fmt: skip
    back = [(f.outcomes[min(a.stop, len(f.outcomes) - 1)].t_ns, a, at) for a, at in known if a.back]
    marks = {
        "type": "scatter", "mode": "markers", "x": _ms(_times(*(t for t, _, _ in back))),
        "y": [at for _, _, at in back],
        "marker": {"symbol": "diamond", "size": 9, "color": "--card", "line": {"width": 2, "color": "--ink"}},
        "customdata": [f"<b>{safe(a.group)}</b> is back at {clock_time(t)}" for t, a, _ in back],
        "hovertemplate": "%{customdata}<extra></extra>",
    }  # fmt: skip
    return [trace for trace in (lines, marks) if trace["x"]]


def _start_ns(f: Frame, a: Absence) -> int:
    return f.outcomes[a.start].t_ns


def _times(*t_ns: int) -> npt.NDArray[np.int64]:
    return np.array(t_ns, dtype=np.int64)
