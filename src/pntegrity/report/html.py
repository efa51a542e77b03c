"""The report: one self-contained HTML file, what a person looks at first."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import polars as pl

from pntegrity.errors import InputError
from pntegrity.formats.atomic import write_text
from pntegrity.physics.signals import WORDS
from pntegrity.pipeline import Outcome
from pntegrity.report import (
    figures,
    inertial_figures,
    panels,
    precise,
    protection_cards,
    protection_figures,
    screening_figures,
    sky,
    source_cards,
    source_figures,
)
from pntegrity.report import inertial_cards as ins
from pntegrity.report.cards import (
    details,
    escaped,
    header,
    monitor_table,
    plot,
    section,
    story_list,
    whiteness_table,
)
from pntegrity.report.facts import RunFacts
from pntegrity.report.figures import Figure, Frame, array, frame
from pntegrity.report.protection import Protected, protected
from pntegrity.report.story import story
from pntegrity.report.summary import committed, headline, summary
from pntegrity.report.tables import solution

__all__ = ["page", "write_html"]

POLICY = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data: blob:"
"""Nothing may be loaded from anywhere: the browser keeps the promise that the file is self-contained."""


def write_html(path: Path | str, outcomes: Sequence[Outcome], facts: RunFacts) -> None:
    """Write the report of a run as one file without external requests.

    Raises
    ------
    InputError
        Where the file cannot be written.
    """
    table = solution(outcomes, facts)
    text = page(outcomes, facts, summary(outcomes, facts, table), table)
    write_text(path, text)


def page(
    outcomes: Sequence[Outcome], facts: RunFacts, numbers: Mapping[str, Any], table: pl.DataFrame
) -> str:
    """Return the report as text, from the outcomes and what `summary` and `solution` made of them."""
    f = frame(outcomes) if outcomes else None
    p = protected(table, facts)
    shown = _figures(f, numbers, table, p, facts) if f is not None else []
    if f is not None:
        shown += _moving(f, table, facts)
    there = {s.name for s in shown}
    data = {
        "t": array(f.x_ms, exact=True) if f is not None else None,
        "figures": [s.as_json() for s in shown],
        "left": source_figures.left_px(f, facts.sources) if f is not None and f.is_vehicle else None,
    }
    assets = files("pntegrity.report") / "assets"
    parts = [
        "<!doctype html>\n<html lang='en'><head><meta charset='utf-8'>",
        f"<meta http-equiv='Content-Security-Policy' content=\"{POLICY}\">",
        "<meta name='viewport' content='width=device-width, initial-scale=1'>",
        "<meta name='color-scheme' content='light dark'>",
        f"<title>{escaped(headline(numbers)[0])} · pntegrity</title>",
        f"<style>{(assets / 'report.css').read_text(encoding='utf-8')}</style></head><body><main>",
        header(
            numbers,
            facts,
            [*([protection_cards.card(numbers)] if p is not None else []), *ins.cards(numbers)],
        ),
        section("When it could be trusted", plot("status", _STATUS)) if shown else "",
        story_list(story(outcomes, facts, table), facts),
        source_cards.sources_part(numbers) + source_cards.levels_part(numbers) if "sources" in there else "",
        ins.track_part(there),
        ins.sections_part(numbers),
        _protection(p, numbers, facts) if p is not None else "",
        source_cards.risk_part(numbers) if "sources" in there else "",
        _body(there, f, numbers, facts) if f is not None else "",
        details(facts),
        "</main>",
        f"<script type='application/json' id='data'>{_json(data)}</script>",
        f"<script>{_plotly()}</script><script>{(assets / 'report.js').read_text(encoding='utf-8')}</script>"
        if shown
        else "",
        "</body></html>\n",
    ]
    return "\n".join(parts)


def _json(data: object) -> str:
    """Return JSON that cannot end the script element it stands in."""
    text = json.dumps(data, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _plotly() -> str:
    """Return plotly.js, read as a file: importing the plotly package costs more than the whole report."""
    spec = find_spec("plotly")
    for folder in (spec.submodule_search_locations if spec else None) or ():
        file = Path(folder) / "package_data" / "plotly.min.js"
        if file.is_file():
            return file.read_text(encoding="utf-8")
    raise InputError("the report needs plotly, which is not installed", hint="pip install plotly")


def _figures(
    f: Frame, numbers: Mapping[str, Any], table: pl.DataFrame, p: Protected | None, facts: RunFacts
) -> list[Figure]:
    shown = [figures.status(f), panels.monitors(f, numbers["monitors"])]
    shown += [protection_figures.levels(f, p)] if p is not None else []
    shown += [protection_figures.diagram(a) for a in p.axes] if p is not None and p.has_truth else []
    if f.is_vehicle:
        shown.append(source_figures.sources(f, facts.sources))
    elif f.gone:
        shown.append(figures.timeline(f))
    shown += [figures.satellites(f), figures.used(f, table), precise.arcs(f, committed(f.outcomes))]
    shown += [panels.position(f, table), precise.troposphere(f, table), sky.sky(f)]
    return [s for s in shown if s.data]


def _moving(f: Frame, table: pl.DataFrame, facts: RunFacts) -> list[Figure]:
    """Return the figures of runs that move, have an INS or screen their rows."""
    shown = [inertial_figures.track(f, table, facts), screening_figures.detection(f)]
    shown += [inertial_figures.attitude(f, table), inertial_figures.attitude_error(f, table)]
    return [s for s in shown if s.data]


# --- the parts of the page --------------------------------------------------------------------------------


def _protection(p: Protected, numbers: Mapping[str, Any], facts: RunFacts) -> str:
    pair = "".join(
        f"<div><h3>{a.name.capitalize()}</h3>{plot(f'stanford-{a.name}', '')}</div>" for a in p.axes
    )
    stanford = f"<figcaption>{_STANFORD}</figcaption><div class='pair'>{pair}</div>"
    if p.has_truth:
        stanford += protection_cards.region_table(numbers)
    else:
        stanford = f"<p class='quiet'>{_NO_STANFORD}</p>"
    return "\n".join(
        [
            section(
                "Protection levels" + " against errors" * p.has_truth,
                plot("levels", _LEVELS) + protection_cards.level_table(numbers),
            ),
            section("Stanford diagram", stanford),
            section("Which fault sets the level", protection_cards.mode_table(numbers)),
            section("What the levels promise", protection_cards.promise(numbers, facts)),
        ]
    )


def _body(there: set[str], f: Frame, numbers: Mapping[str, Any], facts: RunFacts) -> str:
    excluded = (
        plot(
            "timeline",
            "Which test saw it and the estimated fault. The thin line starts at the estimated onset.",
        )
        if "timeline" in there
        else f"<p class='quiet'>{_NOTHING[numbers['screening'] is not None]}</p>"
    )
    one = "satellite" if numbers["sources"] is None else "sensor"
    error = "Error against the truth within the filter's own three-sigma band." if numbers["position"] else (
        "Three sigma as the filter states it. No truth was given, so the error itself is not known."
    )  # fmt: skip
    return "\n".join(
        [
            section("What the monitors saw", plot("monitors", _MONITORS) + monitor_table(numbers)),
            section("Left out", excluded, numbers["sources"] is None),
            ins.screening_part(numbers, there),
            section(f"Innovations of each {one}", plot("residuals", _RESIDUALS), "residuals" in there),
            section(f"{one.capitalize()}s used", plot("used", ""), "used" in there),
            section("Carrier arcs", plot("arcs", _ARCS), "arcs" in there),
            section("Position", plot("position", error)),
            ins.attitude_part(there),
            section("Troposphere", plot("troposphere", _WET), "troposphere" in there),
            section("Atmosphere products", protection_cards.product_list(facts), bool(facts.products)),
            "<div class='pair'>",
            section("Sky", _legend(f) + plot("sky", _SKY), "sky" in there),
            section("Can the false-alarm rates be believed?", whiteness_table(numbers, facts)),
            "</div>",
        ]
    )  # fmt: skip


_NOTHING = (
    "Nothing was excluded.",
    "The monitors excluded nothing. What the estimator itself left out before them is below.",
)
_LEVELS = (
    "An error may be beyond its level only with the stated risk, or with an alert (shaded orange). "
    "Logarithmic. Shaded grey: no level."
)
_STANFORD = (
    "A cell for each error and level that occurred, stronger where there were more epochs. Above the "
    "diagonal the error is within its level. Epochs with an alert are left out; levels without a bound are "
    "in the upper row. A cross marks each error beyond its level."
)
_NO_STANFORD = (
    "Left out: it holds protection levels against true errors, and no truth was given (option --truth)."
)
_STATUS = "After exclusion. Drag along any time axis to zoom all of them; double-click to go back."
_SKY = "A point every 30 s and wherever satellites come or go. Orange: left out there."
_MONITORS = (
    "Statistic (line) and threshold (dashed), logarithmic. Open circles: alarms at first look that exclusion "
    "resolved; triangles: alarms that remained. Shaded: no test possible."
)
_ARCS = "Each line is the life of an ambiguity, its mark is where and why it was born."
_WET = "As the filter states it, within its three-sigma band."
_RESIDUALS = (
    "Measured minus predicted, beside what the epoch's other rows say, in standard deviations. Underlined: "
    "left out; its colour is then the residual against the solution without it. Pale everywhere means that "
    "the noise model is cautious."
)


def _legend(f: Frame) -> str:
    items = "".join(
        f"<li><i style='background:var({tone})'></i>{escaped(WORDS.get(c, c))}</li>"
        for c, tone in sky.legend(f)
    )
    return f"<ul class='legend'>{items}</ul>"
