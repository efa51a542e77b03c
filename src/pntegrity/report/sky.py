"""The sky of the report: tracks of satellites, and where one was left out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pntegrity.records import FloatArray, group_of
from pntegrity.report.columns import groups_in
from pntegrity.report.figures import ORDER, Figure, Frame, colour, ordered, safe

__all__ = ["label_sides", "legend", "sky"]

FEW = 12
"""Up to as many exclusions get a ring in the sky plot, more only a thick track."""
RADIUS_PX = 190.0
NAME_PX = np.array([24.0, 13.0])
"""About how large the sky and a name in it are."""
SIDES = {
    "top center": np.array([0.0, 12.0]), "bottom center": np.array([0.0, -12.0]),
    "middle right": np.array([20.0, 0.0]), "middle left": np.array([-20.0, 0.0]),
}  # fmt: skip
"""Where a name may stand beside its point."""
SKY_STEP_S = 30.0
"""The sky plot has one point a track in this time; its caption says so."""


def sky(f: Frame) -> Figure:
    """Return the tracks of the satellites, north up; where one was left out its track is marked."""
    tracks = _tracks(f)
    data: list[dict[str, Any]] = []
    sides = label_sides({g: (el, az) for g, (_, el, az) in tracks.items()})
    for g in ordered(set(tracks)):
        data.append(_track(g, *tracks[g][1:], sides[g]))
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
                if np.isfinite(el):  # a standstill has no place in the sky
                    found.setdefault(g, []).append((i, el, az))
    out: dict[str, Track] = {}
    for g, points in found.items():
        a = np.array(points, dtype=np.float64)
        el, az = (np.asarray(np.round(np.degrees(a[:, j]), 1), dtype=np.float64) for j in (1, 2))
        out[g] = (a[:, 0], el, az)
    return out


def label_sides(tracks_deg: Mapping[str, tuple[FloatArray, FloatArray]]) -> dict[str, str]:
    """Return on which side of its track's end each name has most room.

    In the way are the track itself, the ends of the others and the names that have their place already.
    """
    paths = {g: _on_page(*tracks_deg[g]) for g in ordered(set(tracks_deg))}
    names: list[FloatArray] = []
    out: dict[str, str] = {}
    for g, path in paths.items():
        others = [p[-1:] for h, p in paths.items() if h != g]
        taken = np.concatenate([path[:-1], *others, *names])
        room = {
            side: np.abs((path[-1] + at - taken) / NAME_PX).max(axis=1).min(initial=1.0)
            for side, at in SIDES.items()
        }
        out[g] = max(room, key=lambda side: room[side])
        names.append(path[-1:] + SIDES[out[g]])
    return out


def _on_page(el_deg: FloatArray, az_deg: FloatArray) -> FloatArray:
    """Return where directions are on the page, pixels right of and above the zenith, shape (n, 2)."""
    az = np.radians(az_deg)
    return np.asarray(RADIUS_PX * (1.0 - el_deg / 90.0) * [np.sin(az), np.cos(az)]).T


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


def _track(group: str, el: FloatArray, az: FloatArray, side: str) -> dict[str, Any]:
    tone = colour(group)
    sizes = [0.0] * (len(el) - 1) + [7.0]
    return {
        "type": "scatterpolar", "mode": "lines+markers+text", "r": (90.0 - el).round(1).tolist(),
        "theta": az.tolist(),
        "text": [""] * (len(el) - 1) + [safe(group)], "textposition": side, "textfont": {"size": 10},
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
