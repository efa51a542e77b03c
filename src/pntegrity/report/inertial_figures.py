"""Figures of runs that move: the track on a map without tiles, and attitude against time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import polars as pl

from pntegrity.physics.frames import enu_rotation
from pntegrity.records import FloatArray
from pntegrity.report.facts import RunFacts
from pntegrity.report.figures import Figure, Frame, array, axes, safe
from pntegrity.report.inertial import ANGLES
from pntegrity.report.panels import around, band, course, label, numbers, within_sigma
from pntegrity.report.sections import CHALLENGING, DENIED, OPEN, order
from pntegrity.report.sentences import clock_time
from pntegrity.report.units import length, level_text

__all__ = ["attitude", "attitude_error", "track"]

MOVES_M = 100.0
"""A track that is smaller, of a filter without an INS, is no track."""
HOVERED = 3000
"""About so many points of the track say what they are."""
SECTIONS = {OPEN: "--line", CHALLENGING: "--E", DENIED: "--ink"}
OTHERS = ("--R", "--J", "--C", "--I")
"""Colours of sections: of the known ones, and of others in turn."""
STATUSES = {"ok": "--ok", "alert": "--alert", "unavailable": "--na"}
COMPASS_DEG = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0, 45.0, 90.0, 180.0, 360.0)
"""Steps of the ticks of headings."""
XYZ = ("x_m", "y_m", "z_m")


# --- the track --------------------------------------------------------------------------------------------


def track(f: Frame, table: pl.DataFrame, facts: RunFacts) -> Figure:
    """Return the track east and north of its first point, by section and by status, and the true one; no
    traces where the receiver hardly moved and no INS ran.
    """
    position, truth = numbers(table, [XYZ])[0].T, facts.truth(len(table))
    known = np.flatnonzero(np.isfinite(position).all(axis=1))
    if not len(known) or not (_moved(position[known]) or "roll_deg" in table.columns):
        return Figure("track", [], {}, 0)
    to_enu = enu_rotation(position[known[0]])
    east, north = ((position - position[known[0]]) @ to_enu.T)[:, :2].T
    true = ((truth - position[known[0]]) @ to_enu.T)[:, :2]
    data = [*_true(true), _said(f, table, east, north)]
    fixed = tuple(range(len(data)))
    views: list[tuple[str, tuple[int, ...]]] = []
    for name, column, tones in (("Section", "section", SECTIONS), ("Status", "status", STATUSES)):
        if column in table.columns:
            traces = list(_coloured(table[column].to_list(), tones, east, north, not views))
            views.append((name, (*fixed, *range(len(data), len(data) + len(traces)))))
            data += traces
    return Figure("track", data, _map_layout(), 520, timed=False, views=tuple(views))


def _moved(position_m: FloatArray) -> bool:
    """Tell whether a track is one: most of it is not at one place."""
    low, high = np.quantile(position_m, [0.05, 0.95], axis=0)
    return bool(np.linalg.norm(high - low) > MOVES_M)


def _map_layout() -> dict[str, Any]:
    title = {"standoff": 12, "font": {"size": 12}}
    return {
        "xaxis": {"title": title | {"text": "east, m"}, "automargin": True},
        "yaxis": {"title": title | {"text": "north, m"}, "scaleanchor": "x", "scaleratio": 1,
                  "automargin": True},
        "margin": {"l": 58, "r": 12, "t": 46, "b": 46}, "showlegend": True, "legend": {"y": 1.02},
        "hovermode": "closest", "dragmode": "zoom",
    }  # fmt: skip


def _true(true_m: FloatArray) -> list[dict[str, Any]]:
    if not np.isfinite(true_m).any():
        return []
    return [
        {
            "type": "scatter", "mode": "lines", "x": array(true_m[:, 0]), "y": array(true_m[:, 1]),
            "name": "truth", "line": {"color": "--muted", "width": 1.2, "dash": "dot"}, "hoverinfo": "skip",
        }
    ]  # fmt: skip


def _said(f: Frame, table: pl.DataFrame, east: FloatArray, north: FloatArray) -> dict[str, Any]:
    """Return an unseen line whose points tell time, section, protection level and error."""
    at = np.flatnonzero(np.isfinite(east))[:: max(len(east) // HOVERED, 1)]
    rows = table.select(
        [c for c in ("status", "section", "hpl_m", "error_h_m") if c in table.columns]
    )[at.tolist()]  # fmt: skip
    text = [_point(f.outcomes[i].t_ns, row) for i, row in zip(at.tolist(), rows.to_dicts(), strict=True)]
    return {
        "type": "scatter", "mode": "lines", "x": array(east[at]), "y": array(north[at]), "text": text,
        "line": {"width": 0, "color": "--line"}, "showlegend": False,
        "hovertemplate": "%{text}<extra></extra>",
    }  # fmt: skip


def _point(t_ns: int, row: dict[str, Any]) -> str:
    said = [clock_time(t_ns), row["status"], row.get("section")]
    said += [f"HPL {level_text(row['hpl_m'])}"] if row["hpl_m"] is not None else []
    said += [f"error {length(row['error_h_m'])}"] if row["error_h_m"] is not None else []
    return safe("  ".join(filter(None, said)))


def _coloured(
    labels: Sequence[str | None], tones: dict[str, str], east: FloatArray, north: FloatArray, visible: bool
) -> list[dict[str, Any]]:
    """Return a trace for each label: its points and the one after each, so that no piece is missing."""
    names = np.array([label or "" for label in labels])
    found = order(labels)
    spare = dict(zip([n for n in found if n not in tones], OTHERS * len(found), strict=False))
    out = []
    for name in found:
        mine = names == name
        shown = mine | np.append(False, mine[:-1])
        x, y = (array(np.where(shown, v, np.nan)) for v in (east, north))
        width = 4.5 if name in (DENIED, "alert") else 3.0
        out.append(
            {
                "type": "scatter", "mode": "lines", "x": x, "y": y, "name": safe(name), "visible": visible,
                "line": {"color": tones.get(name) or spare[name], "width": width}, "hoverinfo": "skip",
            }
        )  # fmt: skip
    return out


# --- attitude ---------------------------------------------------------------------------------------------


def attitude(f: Frame, table: pl.DataFrame) -> Figure:
    """Return roll, pitch and heading within three sigma; no traces without an INS."""
    if "roll_deg" not in table.columns:
        return Figure("attitude", [], {}, 0)
    value, sigma = numbers(table, [(f"{a}_deg", f"sigma_{a}_deg") for a in ANGLES]).transpose(1, 0, 2)
    value[2] = _unwrapped(value[2])
    data: list[dict[str, Any]] = []
    layout: dict[str, Any] = {"hovermode": "x unified", "annotations": [], "margin": {"t": 26}}
    for i, (name, domain) in enumerate(zip(ANGLES, axes(3, 0.1), strict=True)):
        axis = "y" if i == 0 else f"y{i + 1}"
        middle, spread = f.place(value[i]), f.place(sigma[i])
        data += [*band(3.0 * spread, axis, middle), course(middle, axis, name.capitalize())]
        scale = around(value[i], sigma[i])
        layout[axis.replace("y", "yaxis")] = {
            "domain": domain, "anchor": "x", "fixedrange": True, "range": scale, "nticks": 5,
            **(_compass(*scale) if name == "heading" else {}),
        }  # fmt: skip
        layout["annotations"].append(label(f"<b>{name.capitalize()}</b>, °", domain[1]))
    layout["xaxis"] = {"anchor": "y3"}
    shown = np.mod(f.place(value[2]), 360.0)
    data[-1] |= {"customdata": array(shown), "hovertemplate": "%{customdata:.2f}"}
    return Figure("attitude", data, layout, 440)


def _unwrapped(heading_deg: FloatArray) -> FloatArray:
    """Return headings without steps over north: beyond 360 deg after a full turn."""
    out, known = heading_deg.copy(), np.isfinite(heading_deg)
    out[known] = np.unwrap(heading_deg[known], period=360.0)
    return out


def _compass(low: float, high: float) -> dict[str, Any]:
    """Return the ticks of an axis of headings that may have gone round."""
    step = next((s for s in COMPASS_DEG if (high - low) / s <= 6.0), 360.0 * np.ceil((high - low) / 2160.0))
    values = np.arange(np.ceil(low / step), np.floor(high / step) + 1.0) * step
    return {"tickvals": values.tolist(), "ticktext": [f"{v % 360.0:g}" for v in values]}


def attitude_error(f: Frame, table: pl.DataFrame) -> Figure:
    """Return the errors of roll, pitch and heading within three sigma; no traces without truth."""
    if "error_roll_deg" not in table.columns or table["error_roll_deg"].null_count() == len(table):
        return Figure("attitude-error", [], {}, 0)
    names = [(f"sigma_{a}_deg", f"error_{a}_deg") for a in ANGLES]
    sigma, error = f.place(numbers(table, names)).transpose(1, 0, 2)
    return within_sigma("attitude-error", [a.capitalize() for a in ANGLES], "°", sigma, error)
