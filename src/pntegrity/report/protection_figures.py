"""Figures of protection levels: against time, and against the true error (the Stanford diagram)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from pntegrity.evaluate.stanford import Region
from pntegrity.records import FloatArray
from pntegrity.report.figures import Figure, Frame, array, axes
from pntegrity.report.panels import label, shaded
from pntegrity.report.protection import Axis, Protected
from pntegrity.report.units import level_text

__all__ = ["diagram", "levels"]

BINS = 44
"""About as many cells has the Stanford diagram in each direction."""
STEPS = (0.01, 0.02, 0.05, 0.1, 0.2)
"""Widths of a cell, decades."""
DIAGRAM_PX = 400


# --- against time -----------------------------------------------------------------------------------------


def levels(f: Frame, p: Protected) -> Figure:
    """Return levels, errors where they are known and alert limits against time, on log axes."""
    data: list[dict[str, Any]] = []
    layout: dict[str, Any] = {
        "hovermode": "x unified", "annotations": [], "shapes": [], "margin": {"t": 46}, "showlegend": True,
        "legend": {"y": 1.06},
    }  # fmt: skip
    for i, (axis, domain) in enumerate(zip(p.axes, axes(2, 0.12), strict=True)):
        name = "y" if i == 0 else "y2"
        low, high = _range(axis)
        data += _traces(f, axis, name, high)
        layout[name.replace("y", "yaxis")] = {
            "type": "log", "domain": domain, "range": [math.log10(low), math.log10(high)], "anchor": "x",
            "fixedrange": True, **ticks(low, high),
        }  # fmt: skip
        layout["annotations"].append(_heading(axis, p, domain[1]))
        layout["shapes"] += shaded(f, axis.alert.tolist(), domain, "--alert-soft")
        layout["shapes"] += shaded(f, np.isnan(axis.level).tolist(), domain, "--na-fill")
    layout["xaxis"] = {"anchor": "y2"}
    names = [t["name"] for t in data]
    data = [t | {"showlegend": t["name"] not in names[:k]} for k, t in enumerate(data)]
    return Figure("levels", data, layout, 460)


def _traces(f: Frame, a: Axis, yaxis: str, high: float) -> list[dict[str, Any]]:
    def line(values: FloatArray, name: str, **style: Any) -> dict[str, Any]:
        return {
            "type": "scatter", "mode": "lines", "x": "$t", "y": array(f.place(values)), "yaxis": yaxis,
            "name": name, "legendgroup": name, "line": style,
        }  # fmt: skip

    bounded = np.where(np.isfinite(a.level) & (a.level > 0.0), a.level, np.nan)
    out = [line(bounded, "protection level", color="--line", width=1.8)]
    if np.isfinite(a.error).any():
        shown = np.where(a.error > 0.0, a.error, np.nan)
        out.append(line(shown, "error", color="--muted", width=1.1))
    if a.limit < math.inf:
        limit = np.full(len(a.level), a.limit)
        out.append(line(limit, "alert limit", color="--ink", width=1.2, dash="dash"))
    at_top = np.where(np.isinf(a.level), high / 1.12, np.nan)
    return [
        *out,
        *_marks(f, at_top, "no finite level", "triangle-up", "--na", yaxis),
        *_marks(f, np.where(a.beyond, a.error, np.nan), "error beyond, no alert", "x", "--alert", yaxis),
    ]


def _marks(f: Frame, y: FloatArray, name: str, symbol: str, tone: str, yaxis: str) -> list[dict[str, Any]]:
    at = np.flatnonzero(np.isfinite(y))
    if not len(at):
        return []
    marker = {"symbol": symbol, "size": 7 if len(at) < 60 else 4, "color": tone}
    return [
        {
            "type": "scatter", "mode": "markers", "x": array(f.x_ms[f.at >= 0][at], exact=True),
            "y": array(y[at]), "yaxis": yaxis, "name": name, "legendgroup": name, "marker": marker,
            "hovertemplate": name if symbol != "x" else "%{y:.3g} m",
        }
    ]  # fmt: skip


def _heading(a: Axis, p: Protected, top: float) -> dict[str, Any]:
    level = a.level[p.given]
    median = level_text(float(np.quantile(level, 0.5, method="higher")))
    text = f"<b>{a.name.capitalize()}</b>, m · median {median}"
    beyond = int(a.beyond.sum())
    return label(text + (f", <b>{beyond} beyond</b>" if beyond else ""), top)


def _range(a: Axis) -> tuple[float, float]:
    """Return a range that shows every level, the alert limit and all but the smallest errors."""
    error = a.error[np.isfinite(a.error) & (a.error > 0.0)]
    level = a.level[np.isfinite(a.level) & (a.level > 0.0)]
    low = [float(level.min())] if len(level) else []
    low += [float(np.quantile(error, 0.02))] if len(error) else []
    high = [float(x.max()) for x in (error, level) if len(x)] + [a.limit] * math.isfinite(a.limit)
    top = max(high, default=1.0)
    return min([*low, top]) / 1.6, top * 2.0


def ticks(low: float, high: float) -> dict[str, Any]:
    """Return the ticks of a log axis: powers of ten, with 2 and 5 between where there are few."""
    decades = math.log10(high / low)
    between = (1.0,) if decades > 3.2 else (1.0, 3.0) if decades > 1.6 else (1.0, 2.0, 5.0)
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    values = [m * 10.0**k for k in powers for m in between if low <= m * 10.0**k <= high]
    return {"tickvals": values, "ticktext": [f"{v:.6g}" if v < 1e5 else f"{v:.0e}" for v in values]}


# --- the Stanford diagram ---------------------------------------------------------------------------------


def diagram(a: Axis) -> Figure:
    """Return the Stanford diagram of one direction: epochs a cell of error and level, regions shaded.

    Levels without a bound are in the upper row. Epochs with an error beyond its level have a mark of their
    own, so that none hides in a cell.
    """
    shown = ~np.isin(a.region, (Region.ALERTED, Region.UNKNOWN)) & ~np.isnan(a.level)
    low, high, step = _square(a, shown)
    steps = np.arange(round(math.log10(high / low) / step) + 1)
    edges = np.asarray(low * 10.0 ** (step * steps), dtype=np.float64)
    x = np.clip(a.error[shown], low * 1.0001, high / 1.0001)
    y = np.clip(a.level[shown], low * 1.0001, high / 1.0001)
    cells, _, _ = np.histogram2d(y, x, bins=(edges, edges))
    data = [_cells(cells, edges), *_beyond(x, y, a.beyond[shown])]
    log_axis = {"type": "log", "range": [math.log10(low), math.log10(high)], "fixedrange": True}
    layout = {
        "xaxis": {**log_axis, **ticks(low, high), "title": _title("error, m")},
        "yaxis": {**log_axis, **ticks(low, high), "title": _title("protection level, m")},
        "shapes": [*_shades(low, high, a.limit), *_upper_row(low, high, step, a.level[shown])],
        "annotations": _names(low, high, a.limit),
        "margin": {"l": 58, "r": 10, "t": 30, "b": 50},
    }  # fmt: skip
    return Figure(f"stanford-{a.name}", data, layout, DIAGRAM_PX, timed=False)


def _title(text: str) -> dict[str, Any]:
    return {"text": text, "standoff": 18, "font": {"size": 12}}


def _square(a: Axis, shown: np.ndarray) -> tuple[float, float, float]:
    """Return the range of both axes and the width of a cell in decades."""
    error, level = a.error[shown], a.level[shown]
    error, level = error[error > 0.0], level[np.isfinite(level) & (level > 0.0)]
    small = [float(np.quantile(error, 0.005))] if len(error) else []
    small += [float(level.min())] if len(level) else []
    large = [float(x.max()) for x in (error, level) if len(x)] + [2.5 * a.limit] * math.isfinite(a.limit)
    high = max(large, default=1.0) * 1.6
    low = min(min(small, default=0.1), high / 4.0) / 1.5
    decades = math.log10(high / low)
    step = min(STEPS, key=lambda s: abs(decades / s - BINS))
    first = math.floor(math.log10(low) / step)
    last = math.ceil(math.log10(high) / step)
    return 10.0 ** (first * step), 10.0 ** (last * step), step


def _cells(cells: FloatArray, edges: FloatArray) -> dict[str, Any]:
    shown = np.log10(np.where(cells > 0.0, cells, np.nan))
    top = max(float(np.nanmax(shown)) if np.isfinite(shown).any() else 0.0, 0.5)
    marks = [float(k) for k in range(math.floor(top) + 1)]
    return {
        "type": "heatmap", "x": edges.tolist(), "y": edges.tolist(), "z": array(shown), "zmin": -0.2,
        "zmax": top, "colorscale": [[0, "--low-weak"], [1, "--low"]],
        "customdata": cells.astype(int).tolist(),
        "hovertemplate": "error %{x:.3g} m, level %{y:.3g} m: %{customdata} epochs<extra></extra>",
        "colorbar": {
            "orientation": "h", "thickness": 8, "len": 0.36, "x": 1, "xanchor": "right", "y": 1.01,
            "yanchor": "bottom", "outlinewidth": 0, "tickvals": marks, "ticklabelposition": "outside top",
            "ticktext": [f"{10**k:.0f}" for k in marks], "tickfont": {"size": 10},
        },
    }  # fmt: skip


def _beyond(x: FloatArray, y: FloatArray, which: np.ndarray) -> list[dict[str, Any]]:
    """Return a mark for each epoch whose error is beyond its level; of those that coincide, one."""
    if not which.any():
        return []
    places = np.unique(np.round(np.log10(np.stack([x[which], y[which]])), 2), axis=1)
    marker = {"symbol": "x", "size": 6, "color": "--alert"}
    return [
        {
            "type": "scatter", "mode": "markers", "x": array(10.0 ** places[0]),
            "y": array(10.0 ** places[1]), "marker": marker,
            "hovertemplate": "error %{x:.3g} m beyond its level %{y:.3g} m<extra></extra>",
        }
    ]  # fmt: skip


TONES = {
    Region.NORMAL: ("--ok", 0.14),
    Region.MISLEADING: ("--alert", 0.16),
    Region.HAZARDOUS: ("--alert", 0.36),
    Region.UNAVAILABLE: ("--na", 0.2),
    Region.UNAVAILABLE_MISLEADING: ("--alert", 0.16),
}
"""Colour and strength of each region's shade."""


def _shades(low: float, high: float, limit: float) -> list[dict[str, Any]]:
    """Return the shades of the regions; those that an alert limit makes are there only with one."""
    top = min(limit, high)
    corners = {
        Region.NORMAL: [(low, low), (top, top), (low, top)],
        Region.MISLEADING: [(low, low), (top, top), (top, low)],
        Region.HAZARDOUS: [(top, low), (high, low), (high, top), (top, top)],
        Region.UNAVAILABLE: [(low, top), (top, top), (high, high), (low, high)],
        Region.UNAVAILABLE_MISLEADING: [(top, top), (high, top), (high, high)],
    }
    there = [r for r in corners if limit < high or r in (Region.NORMAL, Region.MISLEADING)]
    shapes: list[dict[str, Any]] = [
        {
            "type": "path", "path": _path(corners[r]), "fillcolor": TONES[r][0], "opacity": TONES[r][1],
            "line": {"width": 0}, "layer": "below",
        }
        for r in there
    ]  # fmt: skip
    ink = {"color": "--ink", "width": 1}
    lines = [((low, low), (high, high), ink)]
    if limit < high:
        dashed = ink | {"dash": "dash"}
        lines += [((limit, low), (limit, high), dashed), ((low, limit), (high, limit), dashed)]
    return shapes + [
        {"type": "line", "x0": a[0], "y0": a[1], "x1": b[0], "y1": b[1], "line": style}
        for a, b, style in lines
    ]


def _upper_row(low: float, high: float, step: float, level: FloatArray) -> list[dict[str, Any]]:
    """Return the shade of the row in which levels without a bound stand."""
    shape = {
        "type": "rect", "x0": low, "x1": high, "y0": high / 10.0**step, "y1": high, "fillcolor": "--na",
        "opacity": 0.35, "line": {"width": 0}, "layer": "below",
    }  # fmt: skip
    return [shape] * bool(np.isinf(level).any())


def _path(corners: list[tuple[float, float]]) -> str:
    return "M " + " L ".join(f"{x:.9g},{y:.9g}" for x, y in corners) + " Z"


def _names(low: float, high: float, limit: float) -> list[dict[str, Any]]:
    """Return the names of the regions, in their corners (on log axes notes stand at logarithms)."""
    bottom, top, edge = math.log10(low), math.log10(high), math.log10(min(limit, high))
    found = [("normal operation", bottom, edge, "left", "top", 0)]
    found += [("misleading", edge, bottom, "right", "bottom", 0)]
    if limit < high:
        found += [("unavailable", bottom, top, "left", "top", 0)]
        found += [("hazardous", (edge + top) / 2.0, bottom, "center", "bottom", -90)]
    return [
        {
            "text": text, "x": x, "y": y, "xanchor": xanchor, "yanchor": yanchor, "textangle": angle,
            "showarrow": False, "font": {"size": 11, "color": "--ink"}, "borderpad": 4,
        }
        for text, x, y, xanchor, yanchor, angle in found
    ]  # fmt: skip
