"""Figures of filters that use carriers: when each arc lives, and the wet delay."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl

from pntegrity.estimators._precise_filter import LEFT_OUT
from pntegrity.records import Update, group_of
from pntegrity.report.figures import LANE_PX, UNIX_GPS_MS, Figure, Frame, axes, colour, ordered, safe
from pntegrity.report.panels import around, band, course, label
from pntegrity.report.units import unit

__all__ = ["Arc", "arcs", "carrier_arcs", "troposphere"]

#: Why an ambiguity is born, with the mark of each. What ended the arc before is not in an update.
CAUSES = {
    "start": ("the filter starts", "line-ns-open", "--muted"),
    "view": ("the satellite comes into view", "circle", "--ink"),
    "cut": ("cycle slip, loss of lock or another signal", "x", "--alert"),
    "left out": ("born anew while left out", "diamond-open", "--alert"),
}


@dataclass(frozen=True)
class Arc:
    """An ambiguity's life: from update `start` until before update `stop`, and why it was born."""

    group: str
    name: str
    cause: str
    start: int
    stop: int


def carrier_arcs(updates: Sequence[Update]) -> list[Arc]:
    """Return the life of every ambiguity, in order of birth."""
    out: list[Arc] = []
    alive: dict[str, tuple[str, int]] = {}
    for k, u in enumerate(updates):
        now = [(u.prior.layout.names[i], bool(u.F[i].any())) for i in u.prior.layout.block("amb")]
        names = {n for n, _ in now}
        begins = {n: _cause(u, n, alive) for n, inherited in now if not (inherited and n in alive)}
        for n in [n for n in alive if n not in names or n in begins]:
            out.append(Arc(_group(n), n, *alive.pop(n), k))
        alive |= {n: (cause, k) for n, cause in begins.items()}
    out += [Arc(_group(n), n, *life, len(updates)) for n, life in alive.items()]
    return sorted(out, key=lambda a: (a.start, a.name))


def _group(name: str) -> str:
    return group_of(name.partition(":")[2])


def _cause(u: Update, name: str, alive: dict[str, tuple[str, int]]) -> str:
    if u.is_start:
        return "start"
    if name in alive or name.endswith(LEFT_OUT) or name + LEFT_OUT in alive:
        return "left out"
    return "cut" if _group(name) in map(_group, alive) else "view"


def arcs(f: Frame, updates: Sequence[Update]) -> Figure:
    """Return when each arc of each satellite lives, a lane a satellite; births are marked with their cause.

    Parameters
    ----------
    f : Frame
    updates : sequence of Update
        Those that stood at the end.
    """
    found = carrier_arcs(updates)
    lanes = ordered({a.group for a in found})[::-1]
    t_ms = [u.t_ns / 1e6 + UNIX_GPS_MS for u in updates]
    data = [*_lives(found, t_ms), *_births(found, t_ms)]
    layout = {
        "yaxis": {
            "type": "category", "categoryorder": "array", "categoryarray": [safe(g) for g in lanes],
            "fixedrange": True, "showgrid": False, "tickfont": {"size": 9}, "dtick": 1,
        },
        "hovermode": "closest", "showlegend": True,
    }  # fmt: skip
    return Figure("arcs", data, layout, 90 + LANE_PX * len(lanes))


def _lives(found: Sequence[Arc], t_ms: Sequence[float]) -> Iterator[dict[str, Any]]:
    for tone in dict.fromkeys(colour(a.group) for a in found):
        x: list[float | None] = []
        y: list[str | None] = []
        for a in found:
            if colour(a.group) == tone:
                x += [t_ms[a.start], t_ms[a.stop - 1], None]
                y += [safe(a.group), safe(a.group), None]
        yield {
            "type": "scatter", "mode": "lines", "x": x, "y": y, "line": {"color": tone, "width": 5},
            "opacity": 0.55, "hoverinfo": "skip", "showlegend": False,
        }  # fmt: skip


def _births(found: Sequence[Arc], t_ms: Sequence[float]) -> Iterator[dict[str, Any]]:
    for cause, (words, symbol, tone) in CAUSES.items():
        born = [a for a in found if a.cause == cause]
        if born:
            yield {
                "type": "scatter", "mode": "markers", "x": [t_ms[a.start] for a in born],
                "y": [safe(a.group) for a in born], "name": words,
                "customdata": [safe(a.name[4:]) for a in born],
                "marker": {"symbol": symbol, "size": 7, "color": tone, "line": {"width": 1.5, "color": tone}},
                "hovertemplate": f"%{{customdata}}: {words} %{{x|%H:%M:%S}}<extra></extra>",
            }  # fmt: skip


def troposphere(f: Frame, table: pl.DataFrame) -> Figure:
    """Return the zenith wet delay and, where they are estimated, its gradients, with three sigma."""
    panels = {"zwd_m": "Zenith wet delay", "grad_n_m": "Gradient north", "grad_e_m": "Gradient east"}
    there = [c for c in panels if c in table.columns and table[c].null_count() < len(table)]
    data: list[dict[str, Any]] = []
    layout: dict[str, Any] = {"hovermode": "x unified", "annotations": [], "margin": {"t": 26}}
    for i, (column, domain) in enumerate(zip(there, axes(len(there), 0.16), strict=True)):
        axis = "y" if i == 0 else f"y{i + 1}"
        value, sigma = (f.place(table[c].fill_null(np.nan).to_numpy()) for c in (column, f"sigma_{column}"))
        factor, name = unit(float(np.nanmax(np.abs(value))))
        data += band(factor * sigma * 3.0, axis, factor * value)
        data.append(course(factor * value, axis, panels[column]))
        layout[axis.replace("y", "yaxis")] = {
            "domain": domain, "anchor": "x", "nticks": 5, "fixedrange": True,
            "range": around(factor * value, factor * sigma),
        }  # fmt: skip
        layout["annotations"].append(label(f"<b>{panels[column]}</b>, {name}", domain[1]))
    layout["xaxis"] = {"anchor": f"y{len(there)}" if len(there) > 1 else "y"}
    return Figure("troposphere", data, layout, 80 + 120 * max(len(there), 1))
