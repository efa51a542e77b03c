"""Figures of the report with several panels, and the sky: statistics, position error, tracks."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import Any

import numpy as np
import polars as pl

from pntegrity.records import FloatArray, Verdict, group_of
from pntegrity.report.figures import ORDER, Figure, Frame, array, axes, colour, ordered, safe
from pntegrity.report.tables import groups_in

__all__ = ["monitors", "position", "sky"]

FEW = 12
"""Up to as many exclusions get a ring in the sky plot, more only a thick track."""
SKY_STEP_S = 30.0
"""The sky plot has one point a track in this time; its caption says so."""


def monitors(f: Frame, counts: Sequence[dict[str, Any]]) -> Figure:
    """Return each monitor's statistic against its threshold, a panel a monitor, on log axes."""
    first: dict[tuple[str, str], list[Verdict]] = {}
    last: dict[tuple[str, str], list[Verdict]] = {}
    for o in f.outcomes:
        for a, b in zip(o.first, o.verdicts, strict=True):
            first.setdefault((b.monitor, b.variant), []).append(a)
            last.setdefault((b.monitor, b.variant), []).append(b)
    data: list[dict[str, Any]] = []
    layout: dict[str, Any] = {"hovermode": "x unified", "annotations": [], "shapes": [], "margin": {"t": 26}}
    for i, (domain, count) in enumerate(zip(axes(len(counts), 0.06), counts, strict=True)):
        which = (count["monitor"], count["variant"])
        axis = "y" if i == 0 else f"y{i + 1}"
        traces, lowest, highest = _panel(f, first[which], last[which], axis)
        data += traces
        bounds = [float(np.log10(lowest)), float(np.log10(highest))]
        layout[axis.replace("y", "yaxis")] = {
            "type": "log", "domain": domain, "range": bounds, "dtick": 2 if bounds[1] - bounds[0] > 4 else 1,
            "exponentformat": "power", "fixedrange": True, "anchor": "x", "tickfont": {"size": 10},
        }  # fmt: skip
        layout["annotations"].append(_title(count, domain[1]))
        layout["shapes"] += _untested(f, last[which], domain)
    layout["xaxis"] = {"anchor": f"y{len(counts)}" if len(counts) > 1 else "y"}
    return Figure("monitors", data, layout, 76 + 118 * max(len(counts), 1))


def _panel(
    f: Frame, first: list[Verdict], last: list[Verdict], axis: str
) -> tuple[list[dict[str, Any]], float, float]:
    statistic, threshold = _tested(last)
    looked, _ = _tested(first)
    alarm = np.where([v.status == "alert" for v in last], statistic, np.nan)
    resolved = np.where(
        [a.status == "alert" != b.status for a, b in zip(first, last, strict=True)], looked, np.nan
    )
    common = {"type": "scatter", "x": "$t", "yaxis": axis, "showlegend": False}
    traces: list[dict[str, Any]] = [
        {**common, "y": array(f.place(values)), "mode": "lines", "name": name, "line": line}
        for values, name, line in (
            (threshold, "threshold", {"color": "--ink", "width": 1.2, "dash": "dash"}),
            (statistic, "statistic", {"color": "--line", "width": 1.3}),
        )
    ]
    for values, name, symbol in (
        (resolved, "alarm, resolved by exclusion", "circle-open"),
        (alarm, "alarm", "triangle-up"),
    ):
        if np.isfinite(values).any():
            at = np.flatnonzero(np.isfinite(values))
            hollow = symbol.endswith("open")
            marker = {
                "symbol": symbol,
                "size": 8 if len(at) < 30 else 5,
                "color": "--alert",
                "line": {"width": 2 if hollow else 0, "color": "--alert"},
            }
            x = f.x_ms[np.searchsorted(f.x_ms, _instants(f)[at])]
            traces.append(
                {
                    **common,
                    "x": array(x, exact=True),
                    "y": array(values[at]),
                    "mode": "markers",
                    "name": name,
                    "marker": marker,
                }
            )
    return traces, *_log_range(np.concatenate([statistic, threshold, resolved]), threshold)


def _log_range(every: FloatArray, threshold: FloatArray) -> tuple[float, float]:
    """Return a range that shows the statistics and the threshold; zeros have no place on a log axis."""
    every = every[np.isfinite(every) & (every > 0.0)]
    top = float(every.max()) if len(every) else 10.0
    level = float(np.nanmedian(threshold)) if np.isfinite(threshold).any() else 1.0
    low = float(np.quantile(every, 0.01)) if len(every) else level * 1e-2
    return max(low / 2.0, level * 1e-7), max(top, level) * 3.0


def _instants(f: Frame) -> FloatArray:
    return f.x_ms[f.at >= 0]


def _tested(verdicts: list[Verdict]) -> tuple[FloatArray, FloatArray]:
    pairs = [(v.statistic, v.threshold) if v.status != "unavailable" else (np.nan, np.nan) for v in verdicts]
    values = np.array(pairs, dtype=np.float64).reshape(-1, 2)
    return np.where(values[:, 0] > 0.0, values[:, 0], np.nan), values[:, 1]


def _title(count: dict[str, Any], top: float) -> dict[str, Any]:
    tests, alarms, first = count["final"]["tests"], count["final"]["alarms"], count["first"]["alarms"]
    said = f"{first} alarm{'' if first == 1 else 's'}" + (
        "" if alarms == first else f", {alarms} after exclusion"
    )
    said = said if tests else "no test"
    text = f"<b>{safe(count['monitor'].upper())}</b>  {safe(count['variant'])} · {said}"
    return _label(text, top)


def _label(text: str, top: float) -> dict[str, Any]:
    """Return a title at the left above a panel whose upper edge is at `top`."""
    return {
        "text": text, "x": 0, "xref": "paper", "xanchor": "left", "y": top, "yref": "paper",
        "yanchor": "bottom", "showarrow": False, "font": {"size": 12},
    }  # fmt: skip


def _untested(f: Frame, verdicts: list[Verdict], domain: tuple[float, float]) -> list[dict[str, Any]]:
    shapes = []
    for untested, run in groupby(range(len(verdicts)), key=lambda i: verdicts[i].status == "unavailable"):
        if untested:
            at = list(run)
            begin, width = f.span(at[0], at[-1] + 1)
            shapes.append(
                {
                    "type": "rect", "x0": begin, "x1": begin + width, "yref": "paper", "y0": domain[0],
                    "y1": domain[1],
                    "fillcolor": "--na-fill", "line": {"width": 0}, "layer": "below",
                }
            )  # fmt: skip
    return shapes


def position(f: Frame, table: pl.DataFrame) -> Figure:
    """Return east, north and up error within three sigma where truth is known, else three sigma alone."""
    data: list[dict[str, Any]] = []
    layout: dict[str, Any] = {"hovermode": "x unified", "annotations": [], "margin": {"t": 26}}
    for i, (a, word, domain) in enumerate(zip("enu", ("East", "North", "Up"), axes(3, 0.1), strict=True)):
        axis = "y" if i == 0 else f"y{i + 1}"
        sigma = 3.0 * f.place(table[f"sigma_{a}_m"].cast(pl.Float64).fill_null(np.nan).to_numpy())
        error = f.place(table[f"error_{a}_m"].cast(pl.Float64).fill_null(np.nan).to_numpy())
        data += _band(sigma, axis)
        if np.isfinite(error).any():
            line = {"color": "--line", "width": 1.5}
            data.append(
                {
                    "type": "scatter",
                    "mode": "lines",
                    "x": "$t",
                    "y": array(error),
                    "yaxis": axis,
                    "name": f"{word} error",
                    "line": line,
                }
            )
        half = _half_range(sigma, error)
        layout[axis.replace("y", "yaxis")] = {
            "domain": domain,
            "range": [-half, half],
            "anchor": "x",
            "nticks": 5,
            "fixedrange": True,
        }
        layout["annotations"].append(_label(f"<b>{word}</b>, m", domain[1]))
    layout["xaxis"] = {"anchor": "y3"}
    return Figure("position", data, layout, 440)


def _band(sigma: FloatArray, axis: str) -> list[dict[str, Any]]:
    common = {
        "type": "scatter",
        "mode": "lines",
        "x": "$t",
        "yaxis": axis,
        "line": {"width": 0.8, "color": "--band-edge"},
    }
    return [
        {**common, "y": array(-sigma), "name": "−3σ", "hoverinfo": "skip"},
        {**common, "y": array(sigma), "name": "3σ", "fill": "tonexty", "fillcolor": "--band"},
    ]


def _half_range(sigma: FloatArray, error: FloatArray) -> float:
    """Return a range that shows every error and the usual three sigma (a start is far wider)."""
    usual = float(np.nanquantile(sigma, 0.95)) if np.isfinite(sigma).any() else 1.0
    largest = float(np.nanmax(np.abs(error))) if np.isfinite(error).any() else 0.0
    return 1.12 * max(usual, largest, 1e-3)


def sky(f: Frame) -> Figure:
    """Return the tracks of the satellites, north up; where one was left out its track is marked."""
    tracks = _tracks(f)
    data: list[dict[str, Any]] = []
    for g in ordered(set(tracks)):
        data.append(_track(g, *tracks[g][1:]))
    marked = [m for a in f.gone if a.group in tracks for m in _marked(*tracks[a.group], a.start, a.stop)]
    if marked:
        r, theta = zip(*marked, strict=True)
        line = {"color": "--alert", "width": 4}
        few = len(f.gone) <= FEW
        marker = {"size": 13 if few else 0, "color": "--alert", "symbol": "circle-open", "line": {"width": 2}}
        data.append(
            {
                "type": "scatterpolar", "mode": "lines+markers", "r": list(r), "theta": list(theta),
                "line": line, "marker": marker,
                "name": "left out", "hoverinfo": "skip", "opacity": 0.85,
            }
        )  # fmt: skip
    polar = {
        "angularaxis": {
            "direction": "clockwise", "rotation": 90,
            "tickvals": [0, 90, 180, 270], "ticktext": ["N", "E", "S", "W"],
        },
        "radialaxis": {
            "range": [0, 90], "tickvals": [0, 30, 60, 90], "ticktext": ["", "60°", "30°", ""],
            "angle": 90, "tickangle": 90,
            "ticks": "", "showline": False,
        },
    }  # fmt: skip
    return Figure("sky", data, {"polar": polar, "hovermode": "closest"}, 470, timed=False)


Track = tuple[FloatArray, FloatArray, FloatArray]


def _tracks(f: Frame) -> dict[str, Track]:
    """Return for each group in view: indices of outcomes, elevation and azimuth (deg)."""
    found: dict[str, list[tuple[int, float, float]]] = {}
    for i in _looks(f):
        u = f.outcomes[i].update
        if "el_rad" in u.aux and "az_rad" in u.aux:
            angles = dict(
                zip(
                    map(group_of, u.keys),
                    zip(u.aux["el_rad"].tolist(), u.aux["az_rad"].tolist(), strict=True),
                    strict=True,
                )
            )
            for g, (el, az) in angles.items():
                found.setdefault(g, []).append((i, el, az))
    out: dict[str, Track] = {}
    for g, points in found.items():
        a = np.array(points, dtype=np.float64)
        el, az = (np.asarray(np.round(np.degrees(a[:, j]), 1), dtype=np.float64) for j in (1, 2))
        out[g] = (a[:, 0], el, az)
    return out


def _looks(f: Frame) -> list[int]:
    """Return the outcomes that the sky plot shows: one each `SKY_STEP_S`, and where satellites come or go."""
    looks: list[int] = []
    keys: tuple[str, ...] = ()
    due = -(10**19)
    last = len(f.outcomes) - 1
    for i, o in enumerate(f.outcomes):
        if o.t_ns >= due or i == last or o.update.keys != keys:
            if o.update.keys != keys and i:
                looks.append(i - 1)
            looks.append(i)
            due, keys = o.t_ns + round(SKY_STEP_S * 1e9), o.update.keys
    return sorted(set(looks))


def _track(group: str, el: FloatArray, az: FloatArray) -> dict[str, Any]:
    tone = colour(group)
    sizes = [0.0] * (len(el) - 1) + [7.0]
    return {
        "type": "scatterpolar", "mode": "lines+markers+text", "r": (90.0 - el).round(1).tolist(),
        "theta": az.tolist(),
        "text": [""] * (len(el) - 1) + [safe(group)], "textposition": "top center", "textfont": {"size": 10},
        "line": {"color": tone, "width": 2}, "marker": {"size": sizes, "color": tone}, "name": safe(group),
        "customdata": el.tolist(),
        "hovertemplate": f"{safe(group)}  el %{{customdata}}°  az %{{theta}}<extra></extra>",
    }  # fmt: skip


def _marked(
    i: FloatArray, el: FloatArray, az: FloatArray, start: int, stop: int
) -> list[tuple[float | None, float | None]]:
    """Return the piece of a track during which it was left out: between the known points around it."""
    before = max(int(np.searchsorted(i, start)) - 1, 0)
    after = min(int(np.searchsorted(i, stop)), len(i) - 1)
    at = [before] if before == after else [before, after]
    return [*((float(90.0 - el[j]), float(az[j])) for j in at), (None, None)]


def legend(f: Frame) -> list[tuple[str, str]]:
    """Return constellations in view and their colours."""
    families = {g[:1] for o in f.outcomes for g in groups_in(o.update.keys)}
    return [(c, colour(c)) for c in ORDER if c in families]
