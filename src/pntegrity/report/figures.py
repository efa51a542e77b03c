"""The figures of the report, as plain dictionaries for plotly.js (plotly's own classes are slow).

Text that starts with ``$`` names a shared array and text that starts with ``--`` a colour of the style sheet;
the page's script puts both in. Arrays travel as base64 (plotly's ``bdata``), which is smaller and faster than
decimal digits.
"""

from __future__ import annotations

import base64
import html
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import polars as pl

from pntegrity.evaluate.whiteness import KINDS, judged, row_kinds
from pntegrity.kernels.signatures import family_of
from pntegrity.physics.signals import WORDS
from pntegrity.pipeline import Outcome
from pntegrity.records import FloatArray
from pntegrity.report.columns import family_counts, is_part_of, is_vehicle, member_of, members_in
from pntegrity.report.sentences import clock_time, kind_words
from pntegrity.report.story import Absence, absences

__all__ = ["Figure", "Frame", "array", "axes", "frame", "satellites", "status", "timeline", "used"]

ORDER = "GERCJIS"
"""Constellations in the order in which they are shown, and their colours those of sources, one after
another.
"""
UNIX_GPS_MS = 315_964_800_000
"""1980-01-06 in milliseconds of the axis (a calendar without leap seconds: the axis shows GPS time)."""
LANE_PX = 11


@dataclass(frozen=True)
class Figure:
    """A figure: traces and layout, its height, whether it shares the time axis, and views to choose from.

    `views` are pairs of a label and the traces that it shows.
    """

    name: str
    data: list[dict[str, Any]]
    layout: dict[str, Any]
    height: int
    timed: bool = True
    views: tuple[tuple[str, tuple[int, ...]], ...] = ()

    def as_json(self) -> dict[str, Any]:
        """Return what the page's script takes."""
        return {
            "name": self.name, "data": self.data, "layout": self.layout, "height": self.height,
            "timed": self.timed,
            "views": [{"label": label, "show": list(show)} for label, show in self.views],
        }  # fmt: skip


@dataclass(frozen=True, eq=False)
class Frame:
    """What the time figures share.

    Parameters
    ----------
    outcomes : sequence of Outcome
    x_ms : ndarray
        Instants of the axis: every epoch, and two empty ones a gap.
    at : ndarray
        Which outcome stands at each instant, -1 in a gap.
    gone : tuple of Absence
        Who was left out when.
    """

    outcomes: Sequence[Outcome]
    x_ms: FloatArray
    at: npt.NDArray[np.intp]
    gone: tuple[Absence, ...]

    @cached_property
    def is_vehicle(self) -> bool:
        """Whether the rows are those of sources of a vehicle."""
        return is_vehicle(self.outcomes)

    def place(self, values: FloatArray) -> FloatArray:
        """Return values of the outcomes (last axis) at the instants of the axis, nan in gaps."""
        padded = np.concatenate([values, np.full((*values.shape[:-1], 1), np.nan)], axis=-1)
        return np.asarray(padded[..., self.at])

    def span(self, start: int, stop: int) -> tuple[float, float]:
        """Return first instant and width (ms) of the outcomes from `start` until before `stop`."""
        t = [self.outcomes[i].t_ns for i in (start, min(stop, len(self.outcomes) - 1))]
        begin = t[0] / 1e6 + UNIX_GPS_MS
        return begin, max((t[1] - t[0]) / 1e6, 500.0)


def frame(outcomes: Sequence[Outcome]) -> Frame:
    """Return the time axis of some outcomes."""
    t = np.array([o.t_ns for o in outcomes], dtype=np.int64)
    step = np.diff(t)
    usual = int(np.median(step)) if len(step) else 0
    gaps = np.flatnonzero(step > 1.5 * usual) if usual else np.zeros(0, dtype=np.intp)
    ends = np.stack([t[gaps] + usual // 2, t[gaps + 1] - usual // 2], axis=1).ravel() if len(gaps) else t[:0]
    x = np.insert(t, np.repeat(gaps + 1, 2), ends)
    at = np.insert(np.arange(len(t)), np.repeat(gaps + 1, 2), -1)
    return Frame(outcomes, x / 1e6 + UNIX_GPS_MS, at, tuple(absences(outcomes)))


def array(values: FloatArray, exact: bool = False) -> dict[str, Any]:
    """Return an array as plotly takes it: base64 of little-endian numbers, float32 unless `exact`."""
    name, dtype = ("f8", "<f8") if exact else ("f4", "<f4")
    raw = np.ascontiguousarray(values, dtype=dtype)
    out = {"dtype": name, "bdata": base64.b64encode(raw.tobytes()).decode()}
    return out | ({"shape": ", ".join(map(str, raw.shape))} if raw.ndim > 1 else {})


def packed(values: FloatArray, step: float) -> dict[str, Any]:
    """Return an array in 16-bit steps, which the page's script unpacks; the lowest means no value."""
    none = np.iinfo(np.int16).min
    raw = np.where(np.isfinite(values), np.clip(np.round(values / step), none + 1, -none - 1), none).astype(
        "<i2"
    )
    return {"packed": base64.b64encode(raw.tobytes()).decode(), "step": step, "columns": raw.shape[-1]}


def axes(n: int, gap: float = 0.05) -> list[tuple[float, float]]:
    """Return the domains of `n` panels, the first on top."""
    height = (1.0 - gap * (n - 1)) / max(n, 1)
    return [(1.0 - height - i * (height + gap), 1.0 - i * (height + gap)) for i in range(n)]


def safe(text: str) -> str:
    """Return text that plotly shows as it is (it reads a little HTML)."""
    return html.escape(text, quote=False)


def ordered(groups: set[str]) -> list[str]:
    """Return groups by constellation, then name."""
    return sorted(groups, key=lambda g: (ORDER.find(g[:1]) % 99, g))


def colour(group: str) -> str:
    """Return the colour of a group's constellation."""
    family = family_of(group)
    return f"--{family}" if family in WORDS else "--other"


def status(f: Frame) -> Figure:
    """Return the status strip: a lane each for ok, alert and no test, to be read without colours."""
    lanes = ("unavailable", "alert", "ok")
    code = np.array([lanes.index(o.status) for o in f.outcomes], dtype=np.float64)
    z = f.place(np.where(code[None, :] == np.arange(3)[:, None], np.arange(3)[:, None], np.nan))
    scale = [
        [0, "--na"],
        [0.333, "--na"],
        [0.333, "--alert"],
        [0.667, "--alert"],
        [0.667, "--ok"],
        [1, "--ok"],
    ]
    trace = {
        "type": "heatmap", "x": "$t", "y": ["No test", "Alert", "OK"], "z": array(z), "zmin": 0, "zmax": 2,
        "colorscale": scale, "showscale": False, "ygap": 4,
        "hovertemplate": "%{x|%H:%M:%S}  %{y}<extra></extra>",
    }  # fmt: skip
    return Figure(
        "status", [trace], {"yaxis": {"fixedrange": True, "showgrid": False}, "margin": {"t": 4}}, 118
    )


def timeline(f: Frame) -> Figure:
    """Return who was left out when, one lane a group; a thin line leads from the estimated onset."""
    groups = ordered({a.group for a in f.gone})[::-1]
    spans = [f.span(a.start, a.stop) for a in f.gone]
    often = Counter(a.group for a in f.gone)
    labelled = {a for a in f.gone if often[a.group] == 1}
    bars = {
        "type": "bar", "orientation": "h", "y": [safe(a.group) for a in f.gone],
        "base": [b for b, _ in spans],
        "x": [w for _, w in spans], "width": 0.55, "marker": {"color": "--alert"},
        "customdata": [_bar_text(f, a) for a in f.gone],
        "hovertemplate": "%{customdata}<extra></extra>",
    }  # fmt: skip
    x, y = [], []
    for a, (begin, _) in zip(f.gone, spans, strict=True):
        x += [a.exclusion.onset_ns / 1e6 + UNIX_GPS_MS, begin, None]
        y += [safe(a.group), safe(a.group), None]
    onset = {
        "type": "scatter", "mode": "lines+markers", "x": x, "y": y,
        "line": {"color": "--alert", "width": 1.5},
        "marker": {"symbol": "line-ns-open", "size": 9, "color": "--alert"}, "hoverinfo": "skip",
    }  # fmt: skip
    late = [b + w > f.x_ms[0] + 0.7 * (f.x_ms[-1] - f.x_ms[0]) for b, w in spans]
    starts = [
        min(b, a.exclusion.onset_ns / 1e6 + UNIX_GPS_MS) for a, (b, _) in zip(f.gone, spans, strict=True)
    ]
    said = {
        "type": "scatter", "mode": "text",
        "x": [x if end else b + w for x, (b, w), end in zip(starts, spans, late, strict=True)],
        "y": [safe(a.group) for a in f.gone],
        "text": [f"  {safe(a.cause)}  " if a in labelled else "" for a in f.gone],
        "textposition": ["middle left" if end else "middle right" for end in late], "textfont": {"size": 11},
        "hoverinfo": "skip",
    }  # fmt: skip
    yaxis = {
        "type": "category",
        "categoryorder": "array",
        "categoryarray": [safe(g) for g in groups],
        "fixedrange": True,
    }
    layout = {"yaxis": yaxis, "bargap": 0.3, "hovermode": "closest", "margin": {"t": 6}}
    return Figure("timeline", [bars, onset, said], layout, 56 + 28 * max(len(groups), 1))


def _bar_text(f: Frame, a: Absence) -> str:
    until = clock_time(f.outcomes[a.stop - 1].t_ns) if a.back else "the end"
    onset = clock_time(a.exclusion.onset_ns)
    lines = [
        f"<b>{safe(a.group)}</b> {clock_time(f.outcomes[a.start].t_ns)} to {until}",
        safe(a.cause),
        f"onset {onset}",
    ]
    return "<br>".join(
        lines + (["ambiguous: others would explain it as well"] if a.exclusion.ambiguous else [])
    )


def satellites(f: Frame) -> Figure:
    """Return normalised innovations, a lane a group (or sensor) and a view a kind; what was left out is
    underlined.

    Each is what its row says beside all others of the epoch. The residual of a group that is left out is the
    one against the solution without it.
    """
    found = zip(kind_words(f.is_vehicle), _normalised(f), strict=True)
    views = [(name, part) for name, part in found if part[0]]
    data: list[dict[str, Any]] = []
    shown = []
    for i, (_, (groups, z)) in enumerate(views):
        data += [_heat(groups, z, i == 0), _underline(f, groups, i == 0)]
        shown.append((2 * i, 2 * i + 1))
    groups = max((part[0] for _, part in views), key=len, default=[])
    layout = {
        "yaxis": {
            "type": "category",
            "fixedrange": True,
            "showgrid": False,
            "tickfont": {"size": 9},
            "dtick": 1,
        }
    }
    labels = tuple((label, show) for (label, _), show in zip(views, shown, strict=True))
    return Figure("residuals", data, layout, 90 + LANE_PX * len(groups), views=labels)


def _normalised(f: Frame) -> list[tuple[list[str], FloatArray]]:
    """Return groups and (groups, instants) of each kind of rows; of a group's rows the largest."""
    kind_of = row_kinds(o.update for o in f.outcomes)
    out = []
    values = [_judged_and_spare(o) for o in f.outcomes]
    for kind in KINDS:
        mine = [k for k, found in kind_of.items() if found == kind]
        groups = ordered({member_of(k) for k in mine})[::-1]
        row = {k: groups.index(member_of(k)) for k in mine}
        z = np.full((len(values), len(groups)), np.nan)
        for j, parts in enumerate(values):
            for keys, value in parts:
                _fill(z[j], keys, value, row)
        out.append((groups, f.place(z.T)))
    return out


def _judged_and_spare(o: Outcome) -> tuple[tuple[tuple[str, ...], FloatArray], ...]:
    """Return the rows that were used and those that were not, in standard deviations."""
    u = o.update
    used = judged(u) if u.keys else u.nu
    return (u.keys, used), (u.spare_keys, u.spare_nu / np.sqrt(u.spare_var))


def _fill(z: FloatArray, keys: tuple[str, ...], value: FloatArray, row: dict[str, int]) -> None:
    at = [(row[k], i) for i, k in enumerate(keys) if k in row]
    if at:
        lanes, i = np.array(at, dtype=np.intp).T
        order = np.argsort(np.nan_to_num(np.abs(value[i]), nan=-1.0), kind="stable")
        z[lanes[order]] = value[i][order]


def _heat(groups: list[str], z: FloatArray, visible: bool) -> dict[str, Any]:
    strong, weak = 4.0, 1.0
    half = (strong - weak) / (2.0 * strong)
    scale = [[0, "--low"], [half, "--low-weak"], [0.5, "--zero"], [1.0 - half, "--high-weak"], [1, "--high"]]
    return {
        "type": "heatmap", "x": "$t", "y": [safe(g) for g in groups], "z": packed(z, 0.01), "zmin": -strong,
        "zmax": strong,
        "colorscale": scale, "ygap": 1, "visible": visible,
        "hovertemplate": "%{y}  %{x|%H:%M:%S}  %{z:.2f} σ<extra></extra>",
        "colorbar": {
            "orientation": "h", "thickness": 8, "len": 0.3, "x": 1, "xanchor": "right", "y": 1.0,
            "yanchor": "bottom", "outlinewidth": 0,
            "tickvals": [-4, -1, 0, 1, 4], "ticktext": ["−4σ", "−1", "0", "1", "4σ"],
            "tickfont": {"size": 10}, "tickangle": 0,
        },
    }  # fmt: skip


def _underline(f: Frame, groups: list[str], visible: bool) -> dict[str, Any]:
    x: list[float | None] = []
    y: list[str | None] = []
    for a in f.gone:
        begin, width = f.span(a.start, a.stop)
        for group in (g for g in groups if is_part_of(g, a.group)):
            x += [begin, begin + width, None]
            y += [safe(group), safe(group), None]
    return {
        "type": "scatter", "mode": "lines", "x": x, "y": y, "line": {"color": "--ink", "width": 2},
        "name": "left out",
        "hoverinfo": "skip", "visible": visible, "showlegend": False,
    }  # fmt: skip


def _stacked(f: Frame, family: str, count: FloatArray, tone: str) -> dict[str, Any]:
    """Return how many of a family there were at each epoch, as a layer above those before it."""
    return {
        "type": "scatter", "mode": "lines", "x": "$t", "y": array(f.place(count)),
        "name": safe(WORDS.get(family, family)), "stackgroup": "one",
        "line": {"shape": "hv", "width": 0.6, "color": tone}, "fillcolor": f"{tone}-fill",
        "hovertemplate": "%{y}",
    }  # fmt: skip


def _left_out_counts(f: Frame, table: pl.DataFrame) -> FloatArray:
    """Return how many sensors of a vehicle, or satellites, were left out at each epoch, shape (n,)."""
    if f.is_vehicle:
        return np.array([len(members_in(o.update.spare_keys)) for o in f.outcomes], dtype=np.float64)
    return np.array([len(e.split(",")) if e else 0 for e in table["excluded"].to_list()], dtype=np.float64)


def used(f: Frame, table: pl.DataFrame) -> Figure:
    """Return the number of satellites used, stacked by constellation (or of sensors, by source), and how many
    were left out.
    """
    counts = [family_counts(o.update.keys) for o in f.outcomes]
    families = ordered({family for c in counts for family in c})
    tones = {c: f"--{ORDER[i % len(ORDER)]}" if f.is_vehicle else colour(c) for i, c in enumerate(families)}
    data = [_stacked(f, x, np.array([c[x] for c in counts], dtype=np.float64), tones[x]) for x in families]
    out = _left_out_counts(f, table)
    if out.any():
        line = {"shape": "hv", "width": 2, "color": "--alert", "dash": "dot"}
        data.append(
            {
                "type": "scatter",
                "mode": "lines",
                "x": "$t",
                "y": array(f.place(np.where(out > 0.0, out, np.nan))),
                "name": "left out",
                "line": line,
            }
        )
    layout = {
        "yaxis": {"rangemode": "tozero", "fixedrange": True},
        "showlegend": True,
        "hovermode": "x unified",
    }
    return Figure("used", data, layout, 240)
