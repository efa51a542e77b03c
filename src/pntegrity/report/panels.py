"""Figures of the report with several panels: statistics, position error."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import Any

import numpy as np
import polars as pl

from pntegrity.records import FloatArray, Verdict
from pntegrity.report.figures import Figure, Frame, array, axes, safe

__all__ = [
    "around", "band", "course", "half_range", "label", "log_range", "monitors", "numbers", "position",
    "shaded", "within_sigma",
]  # fmt: skip


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
            "type": "log", "domain": domain, "range": bounds,
            "dtick": max(round((bounds[1] - bounds[0]) / 3.0), 1),
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
    return traces, *log_range(np.concatenate([statistic, threshold, resolved]), threshold)


def log_range(every: FloatArray, threshold: FloatArray) -> tuple[float, float]:
    """Return a range that shows the statistics and the threshold; zeros have no place on a log axis."""
    every = every[np.isfinite(every) & (every > 0.0)]
    top = float(every.max()) if len(every) else 10.0
    level = float(np.nanmedian(threshold)) if np.isfinite(threshold).any() else 1.0
    low = float(np.quantile(every, 0.01)) if len(every) else level * 1e-2
    return max(low / 2.0, level * 1e-15), max(top, level) * 3.0


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
    return label(text, top)


def label(text: str, top: float) -> dict[str, Any]:
    """Return a title at the left above a panel whose upper edge is at `top`."""
    return {
        "text": text, "x": 0, "xref": "paper", "xanchor": "left", "y": top, "yref": "paper",
        "yanchor": "bottom", "showarrow": False, "font": {"size": 12},
    }  # fmt: skip


def _untested(f: Frame, verdicts: list[Verdict], domain: tuple[float, float]) -> list[dict[str, Any]]:
    return shaded(f, [v.status == "unavailable" for v in verdicts], domain, "--na-fill")


def shaded(
    f: Frame, which: Sequence[bool], domain: tuple[float, float], tone: str, most: int = 400
) -> list[dict[str, Any]]:
    """Return a shade behind a panel over each stretch of outcomes that is true, the longest `most`."""
    runs = [list(run) for true, run in groupby(range(len(which)), key=lambda i: bool(which[i])) if true]
    shapes = []
    for at in sorted(runs, key=len, reverse=True)[:most]:
        begin, width = f.span(at[0], at[-1] + 1)
        shapes.append(
            {
                "type": "rect", "x0": begin, "x1": begin + width, "yref": "paper", "y0": domain[0],
                "y1": domain[1], "fillcolor": tone, "line": {"width": 0}, "layer": "below",
            }
        )  # fmt: skip
    return shapes


def position(f: Frame, table: pl.DataFrame) -> Figure:
    """Return east, north and up error within three sigma where truth is known, else three sigma alone."""
    names = [(f"sigma_{a}_m", f"error_{a}_m") for a in "enu"]
    sigma, error = f.place(numbers(table, names)).transpose(1, 0, 2)
    halves = [half_range(3.0 * s, e) for s, e in zip(sigma, error, strict=True)]
    factor, unit = (1.0, "m") if max(halves) > 1.0 else (100.0, "cm")
    return within_sigma("position", ("East", "North", "Up"), unit, factor * sigma, factor * error)


def numbers(table: pl.DataFrame, names: Sequence[Sequence[str]]) -> FloatArray:
    """Return columns of a table, shape (len(names), len(names[0]), n), nan where there is no value."""
    flat = table.select(n for group in names for n in group).cast(pl.Float64).fill_null(np.nan).to_numpy().T
    return np.asarray(flat.reshape(len(names), -1, len(table)))


def within_sigma(name: str, words: Sequence[str], unit: str, sigma: FloatArray, error: FloatArray) -> Figure:
    """Return errors within their bands of three sigma, a panel each.

    Parameters
    ----------
    name : str
        Of the figure.
    words : sequence of str, length k
        What each error is called.
    unit : str
    sigma, error : ndarray, shape (k, instants)
        At the instants of the axis; nan where not known.
    """
    data: list[dict[str, Any]] = []
    layout: dict[str, Any] = {"hovermode": "x unified", "annotations": [], "margin": {"t": 26}}
    for i, (word, domain) in enumerate(zip(words, axes(len(words), 0.1), strict=True)):
        axis = "y" if i == 0 else f"y{i + 1}"
        data += band(3.0 * sigma[i], axis)
        if np.isfinite(error[i]).any():
            data.append(course(error[i], axis, f"{word} error"))
        half = half_range(3.0 * sigma[i], error[i])
        layout[axis.replace("y", "yaxis")] = {
            "domain": domain, "range": [-half, half], "anchor": "x", "nticks": 5, "fixedrange": True,
        }  # fmt: skip
        layout["annotations"].append(label(f"<b>{word}</b>, {unit}", domain[1]))
    layout["xaxis"] = {"anchor": f"y{len(words)}"}
    return Figure(name, data, layout, 440)


def course(values: FloatArray, axis: str, name: str) -> dict[str, Any]:
    """Return the trace of what a figure is about, at the instants of the axis."""
    return {
        "type": "scatter", "mode": "lines", "x": "$t", "y": array(values), "yaxis": axis, "name": name,
        "line": {"color": "--line", "width": 1.5},
    }  # fmt: skip


def band(half: FloatArray, axis: str, middle: FloatArray | float = 0.0) -> list[dict[str, Any]]:
    """Return the traces of a band of three sigma (`half`) about a course."""
    common = {
        "type": "scatter", "mode": "lines", "x": "$t", "yaxis": axis, "showlegend": False,
        "line": {"width": 0.8, "color": "--band-edge"},
    }  # fmt: skip
    return [
        {**common, "y": array(middle - half), "name": "−3σ", "hoverinfo": "skip"},
        {**common, "y": array(middle + half), "name": "3σ", "fill": "tonexty", "fillcolor": "--band"},
    ]


def half_range(band_m: FloatArray, error: FloatArray) -> float:
    """Return a range that shows the usual three sigma, and every error but of a start that says it is
    wide.
    """
    usual = float(np.nanquantile(band_m, 0.9)) if np.isfinite(band_m).any() else 1.0
    size = np.abs(error[~((band_m > usual) & (np.abs(error) <= band_m)) & np.isfinite(error)])
    return 1.12 * max(usual, float(size.max(initial=0.0)), 1e-3)


def around(value: FloatArray, sigma: FloatArray) -> list[float]:
    """Return a range that shows the values and the usual three sigma (a start is wider)."""
    usual = 3.0 * float(np.nanmedian(sigma)) if np.isfinite(sigma).any() else 0.0
    low, high = float(np.nanmin(value)) - usual, float(np.nanmax(value)) + usual
    pad = 0.06 * max(high - low, 1e-3)
    return [low - pad, high + pad]
