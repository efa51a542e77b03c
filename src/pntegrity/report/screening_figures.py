"""Figure of the fault detection inside an estimator: statistics, checks, satellites, PDOP, sets tested."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pntegrity.records import FloatArray
from pntegrity.report.figures import Figure, Frame, array, axes
from pntegrity.report.panels import label, log_range, shaded
from pntegrity.report.protection_figures import ticks
from pntegrity.report.screening import NONE

__all__ = ["detection"]

PANEL_PX = 112
LEGEND = ("before", "after", "threshold")
"""Lines that the legend tells, once for all panels."""


@dataclass(frozen=True, eq=False)
class _Panel:
    """One panel: what it is called, its lines (name, values, style), and whether its axis is logarithmic."""

    title: str
    lines: Sequence[tuple[str, FloatArray, dict[str, Any]]]
    log: bool

    @property
    def there(self) -> bool:
        """Whether any value is known."""
        return any(bool(np.isfinite(values).any()) for _, values, _ in self.lines)


def detection(f: Frame) -> Figure:
    """Return what was tested before the filter took the rows, before and after rows were left out; no traces
    where nothing was.
    """
    told = [
        s if s is not None and s.method != NONE else None for s in (o.update.screening for o in f.outcomes)
    ]
    if not any(told):
        return Figure("screening", [], {}, 0)
    panels = [p for p in _panels(told) if p.there]
    data: list[dict[str, Any]] = []
    layout: dict[str, Any] = {
        "hovermode": "x unified",
        "annotations": [],
        "shapes": [],
        "margin": {"t": 46},
        "showlegend": True,
        "legend": {"y": 1.03},
    }
    refused = [s is not None and not s.used for s in told]
    for i, (panel, domain) in enumerate(zip(panels, axes(len(panels), 0.06), strict=True)):
        axis = "y" if i == 0 else f"y{i + 1}"
        data += [_line(f, values, name, axis, style) for name, values, style in panel.lines]
        layout[axis.replace("y", "yaxis")] = {
            "domain": domain,
            "anchor": "x",
            "fixedrange": True,
            **_scale(panel),
        }
        layout["annotations"].append(label(panel.title, domain[1]))
        layout["shapes"] += shaded(f, refused, domain, "--alert-soft")
    layout["xaxis"] = {"anchor": f"y{len(panels)}" if len(panels) > 1 else "y"}
    names = [t["name"] for t in data]
    data = [
        t | {"showlegend": t["name"] in LEGEND and t["name"] not in names[:k]} for k, t in enumerate(data)
    ]
    return Figure("screening", data, layout, 60 + PANEL_PX * len(panels))


def _panels(told: Sequence[Any]) -> list[_Panel]:
    """Return all panels, from the screening of each outcome (None: there was none); nan for what is not
    finite.
    """

    def of(name: str, part: int | None = None) -> FloatArray:
        values = [None if s is None else getattr(s, name) for s in told]
        numbers = [v if v is None or part is None else v[part] for v in values]
        out = np.array([np.nan if v is None else v for v in numbers], dtype=np.float64)
        return np.where(np.isfinite(out), out, np.nan)

    before, after = {"color": "--muted", "width": 1.1}, {"color": "--line", "width": 1.5}
    limit = {"color": "--ink", "width": 1.2, "dash": "dash"}
    limits = [("threshold", of("last_limit"), limit)]
    pair = [("before", before, 0), ("after", after, 1)]
    return [
        _Panel("<b>Consistency</b> of the rows, before and after", [
            ("before", of("first"), before), ("after", of("last"), after), *limits], True),
        _Panel("<b>Missed-detection factor</b>, m", [
            ("factor", of("missed_m"), after), ("threshold", of("missed_limit_m"), limit)], True),
        _Panel("<b>False-alarm factor</b>, m", [
            ("factor", of("false_alarm_m"), after), ("threshold", of("false_alarm_limit_m"), limit)], True),
        _Panel("<b>Satellites</b>, before and after", [
            (n, of("satellites", k), style) for n, style, k in pair], False),
        _Panel("<b>PDOP</b>, before and after", [(n, of("pdop", k), style) for n, style, k in pair], True),
        _Panel("<b>Sets of rows tested</b>", [("sets", of("tests"), after)], False),
    ]  # fmt: skip


def _line(f: Frame, values: FloatArray, name: str, axis: str, style: dict[str, Any]) -> dict[str, Any]:
    return {
        "type": "scatter", "mode": "lines", "x": "$t", "y": array(f.place(values)), "yaxis": axis,
        "name": name, "line": {**style, "shape": "hv"}, "hovertemplate": "%{y:.3g}",
    }  # fmt: skip


def _scale(panel: _Panel) -> dict[str, Any]:
    every = np.concatenate([values for _, values, _ in panel.lines])
    if not panel.log:
        return {"rangemode": "tozero", "nticks": 4}
    low, high = log_range(every, panel.lines[-1][1])
    return {"type": "log", "range": [float(np.log10(low)), float(np.log10(high))], **ticks(low, high)}
