"""The report: one self-contained HTML file, what a person looks at first."""

from __future__ import annotations

import html
import json
import math
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
from pntegrity.report import figures, panels
from pntegrity.report.facts import RunFacts
from pntegrity.report.figures import Figure, Frame, array, frame
from pntegrity.report.story import Sentence, story
from pntegrity.report.summary import headline, summary
from pntegrity.report.tables import solution

__all__ = ["page", "write_html"]

POLICY = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data: blob:"
"""Nothing may be loaded from anywhere: the browser keeps the promise that the file is self-contained."""
WHITE_ENOUGH = 0.1
"""Autocorrelations below this are called white."""


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
    shown = _figures(f, numbers, table) if f is not None else []
    data = {
        "t": array(f.x_ms, exact=True) if f is not None else None,
        "figures": [s.as_json() for s in shown],
    }
    assets = files("pntegrity.report") / "assets"
    parts = [
        "<!doctype html>\n<html lang='en'><head><meta charset='utf-8'>",
        f"<meta http-equiv='Content-Security-Policy' content=\"{POLICY}\">",
        "<meta name='viewport' content='width=device-width, initial-scale=1'>",
        "<meta name='color-scheme' content='light dark'>",
        f"<title>{_e(headline(numbers)[0])} · pntegrity</title>",
        f"<style>{(assets / 'report.css').read_text(encoding='utf-8')}</style></head><body><main>",
        _header(numbers, facts),
        _section("When it could be trusted", _figure("status", _STATUS)) if shown else "",
        _story(story(outcomes, facts), facts),
        _body(shown, f, numbers, facts) if f is not None else "",
        _details(facts),
        "</main>",
        f"<script type='application/json' id='data'>{_json(data)}</script>",
        f"<script>{_plotly()}</script><script>{(assets / 'report.js').read_text(encoding='utf-8')}</script>"
        if shown
        else "",
        "</body></html>\n",
    ]
    return "\n".join(parts)


def _e(text: object) -> str:
    return html.escape(str(text))


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


def _figures(f: Frame, numbers: Mapping[str, Any], table: pl.DataFrame) -> list[Figure]:
    shown = [figures.status(f), panels.monitors(f, numbers["monitors"])]
    shown += [figures.timeline(f)] if f.gone else []
    shown += [figures.satellites(f), figures.used(f, table), panels.position(f, table), panels.sky(f)]
    return [s for s in shown if s.data]


# --- the parts of the page --------------------------------------------------------------------------------


def _header(numbers: Mapping[str, Any], facts: RunFacts) -> str:
    title, detail, tone = headline(numbers)
    span = (
        f"{numbers['started']} to {numbers['ended']} GPS time".replace("T", " ")
        if numbers["epochs"]
        else facts.started
    )
    chips = [
        span,
        f"estimator {facts.estimator}",
        f"noise model {facts.noise_name}" if facts.noise_name else "",
    ]
    return (
        f"<header class='{tone}'><p class='eyebrow'>pntegrity <span>integrity report</span></p>"
        f"<h1>{_e(title)}</h1><p class='lead'>{_e(detail)}</p>"
        f"<p class='chips'>{''.join(f'<span>{_e(c)}</span>' for c in chips if c)}</p>"
        f"<dl class='figures'>{''.join(_number(*n) for n in _numbers(numbers))}</dl></header>"
    )


def _number(label: str, value: str, unit: str, note: str) -> str:
    return f"<div><dt>{_e(label)}</dt><dd>{_e(value)}<small>{_e(unit)}</small></dd><p>{_e(note)}</p></div>"


def _numbers(s: Mapping[str, Any]) -> list[tuple[str, str, str, str]]:
    ok, untested = s["availability"]["ok"], s["availability"]["unavailable"]["epochs"]
    alarms = s["availability"]["alert"]["epochs"]
    gone = sorted({e["key"] for e in s["exclusions"]})
    used = s["satellites"]
    out = [
        (
            "Tested and OK",
            _percent(ok["share"]),
            "%",
            f"{ok['epochs']} of {s['epochs']} epochs, {untested} untested",
        ),
        (
            "Unresolved alerts",
            str(alarms),
            "epochs",
            "an alarm remained after exclusion" if alarms else "none remained",
        ),
        (
            "Left out",
            str(len(gone)),
            "satellites" if len(gone) != 1 else "satellite",
            f"{s['readmissions']} readmissions",
        ),
        ("Satellites used", f"{used['used_mean']:.1f}", "mean", f"never fewer than {used['used_min']}"),
    ]
    if s["position"]:
        h, u = s["position"]["h"], s["position"]["u"]
        note = f"RMS {h['rms_m']:.2f} m, largest {h['max_m']:.2f} m; up 95 % {u['p95_m']:.2f} m"
        return [*out, ("Horizontal error, 95 %", f"{h['p95_m']:.2f}", "m", note)]
    sigma = s["sigma_m"]
    if sigma["e"] is None:
        return out
    horizontal = float((sigma["e"] ** 2 + sigma["n"] ** 2) ** 0.5)
    return [
        *out,
        (
            "Horizontal sigma",
            f"{horizontal:.2f}",
            "m",
            f"as the filter states it; up {sigma['u']:.2f} m. No truth given",
        ),
    ]


def _percent(share: float) -> str:
    """Return a share in per cent, rounded down: 100 means all."""
    return f"{math.floor(1000.0 * share + 1e-9) / 10.0:g}"


def _story(sentences: Sequence[Sentence], facts: RunFacts) -> str:
    items = "".join(f"<li class='{s.kind}'>{_told(s.text)}</li>" for s in sentences)
    faults = "".join(f"<li>{_e(f)}</li>" for f in facts.faults)
    injected = (
        f"<div class='injected'><h3>Faults injected into this run</h3><ul>{faults}</ul></div>"
        if faults
        else ""
    )
    return f"<section><h2>What happened</h2><ol class='story'>{items}</ol>{injected}</section>"


def _told(text: str) -> str:
    """Return a sentence with its time set apart."""
    when, colon, what = text.partition(": ")
    return (
        f"<time>{_e(when)}</time><span>{_e(what)}</span>"
        if colon and when[:1].isdigit()
        else f"<span>{_e(text)}</span>"
    )


def _body(shown: Sequence[Figure], f: Frame, numbers: Mapping[str, Any], facts: RunFacts) -> str:
    there = {s.name for s in shown}
    excluded = (
        _figure(
            "timeline",
            "Which test saw it and the estimated fault. The thin line starts at the estimated onset.",
        )
        if "timeline" in there
        else "<p class='quiet'>Nothing was excluded.</p>"
    )
    error = "Error against the truth within the filter's own three-sigma band." if numbers["position"] else (
        "Three sigma as the filter states it. No truth was given, so the error itself is not known."
    )  # fmt: skip
    return "\n".join(
        [
            _section("What the monitors saw", _figure("monitors", _MONITORS) + _monitor_table(numbers)),
            _section("Left out", excluded),
            _section("Innovations of each satellite", _figure("residuals", _RESIDUALS), "residuals" in there),
            _section("Satellites used", _figure("used", ""), "used" in there),
            _section("Position", _figure("position", error)),
            "<div class='pair'>",
            _section("Sky", _legend(f) + _figure("sky", _SKY), "sky" in there),
            _section("Can the false-alarm rates be believed?", _whiteness(numbers, facts)),
            "</div>",
        ]
    )  # fmt: skip


_STATUS = "After exclusion. Drag along any time axis to zoom all of them; double-click to go back."
_SKY = "A point every 30 s and wherever satellites come or go. Orange: left out there."
_MONITORS = (
    "Statistic (line) and threshold (dashed), logarithmic. Open circles: alarms at first look that exclusion "
    "resolved; triangles: alarms that remained. Shaded: no test possible."
)
_RESIDUALS = (
    "Measured minus predicted, in standard deviations. Underlined: left out; its colour is then the residual "
    "against the solution without it. Pale everywhere means that the noise model is cautious."
)


def _section(title: str, inside: str, there: bool = True) -> str:
    return "" if not there else f"<section><h2>{_e(title)}</h2>{inside}</section>"


def _figure(name: str, caption: str) -> str:
    said = f"<figcaption>{_e(caption)}</figcaption>" if caption else ""
    return f"<figure>{said}<div class='plot' id='fig-{name}'></div></figure>"


def _legend(f: Frame) -> str:
    items = "".join(
        f"<li><i style='background:var({tone})'></i>{_e(WORDS.get(c, c))}</li>"
        for c, tone in panels.legend(f)
    )
    return f"<ul class='legend'>{items}</ul>"


def _monitor_table(numbers: Mapping[str, Any]) -> str:
    titles = (
        "Monitor",
        "Variant",
        "Nominal P<sub>FA</sub>",
        "Tests",
        "Alarms, first look",
        "After exclusion",
        "Largest ratio",
    )
    head = f"<tr>{''.join(f'<th>{t}</th>' for t in titles)}</tr>"
    rows = "".join(
        f"<tr><th>{_e(m['monitor'].upper())}</th><td class='word'>{_e(m['variant'])}</td>"
        f"<td>{m['p_fa']:.0e}</td><td>{m['final']['tests']}</td>"
        f"<td>{m['first']['alarms']}</td><td>{m['final']['alarms']}</td>"
        f"<td>{_short(m['final']['worst_ratio'])}</td></tr>"
        for m in numbers["monitors"]
    )
    note = "<p class='quiet'>Ratio: statistic over threshold after exclusion; 1 is an alarm. "
    if any(m["variant"] == "published" for m in numbers["monitors"]):
        note += "A published variant does not keep its nominal P<sub>FA</sub>: it takes dependent terms "
        note += "as independent."
    return f"<div class='scroll'><table><thead>{head}</thead><tbody>{rows}</tbody></table></div>{note}</p>"


def _short(value: float | None) -> str:
    if value is None:
        return "–"
    return f"{value:.0f}" if 100.0 <= abs(value) < 1e5 else f"{value:.3g}"


def _whiteness(numbers: Mapping[str, Any], facts: RunFacts) -> str:
    w = numbers["whiteness"]
    head = "".join(f"<th>{lag:g} s</th>" for lag in w["lags_s"])
    rows = "".join(
        f"<tr><th>{word}</th>{''.join(_correlation(r) for r in w[kind]['autocorrelation'])}"
        f"<td>{_short(w[kind]['mean_square'])}</td></tr>"
        for word, kind in (("Code", "level"), ("Range rate", "rate"))
        if w[kind]["count"]
    )
    spots = "".join(f"<li>{_e(b)}</li>" for b in facts.blind_spots)
    unseen = f"<h3>What this set-up cannot see</h3><ul class='spots'>{spots}</ul>" if spots else ""
    return (
        "<p>The thresholds assume innovations that are white. Measured here, with the noise model "
        f"<b>{_e(facts.noise_name or 'unnamed')}</b>:</p><div class='scroll'>"
        "<table class='white'><thead>"
        f"<tr><th>Autocorrelation</th>{head}<th>Mean square</th></tr></thead>"
        f"<tbody>{rows}</tbody></table></div>"
        f"<p class='quiet'>White innovations have an autocorrelation of 0 (below {WHITE_ENOUGH} counts "
        f"as white) and a mean square of 1; below 1 the model is cautious, above 1 too optimistic.</p>"
        f"{unseen}"
    )


def _correlation(r: float | None) -> str:
    if r is None:
        return "<td>–</td>"
    good = abs(r) < WHITE_ENOUGH
    width = min(abs(r), 1.0) * 100
    mark = "white" if good else "not white"
    tone = "good" if good else "bad"
    return f"<td title='{mark}'>{_signed(r)}<span class='bar {tone}' style='--w:{width:.0f}%'></span></td>"


def _signed(r: float) -> str:
    return "0.00" if abs(r) < 0.005 else f"{r:+.2f}".replace("-", "\u2212")


def _details(facts: RunFacts) -> str:
    rows = "".join(f"<tr><th>{_e(k)}</th><td class='word'>{_e(v)}</td></tr>" for k, v in _flat(facts.config))
    out = (
        f"<details><summary>Configuration</summary><table class='config'>{rows}</table></details>"
        if rows
        else ""
    )
    if facts.notes:
        notes = "".join(f"<li>{_e(n)}</li>" for n in facts.notes)
        title = f"What the readers left out ({len(facts.notes)})"
        out += f"<details><summary>{title}</summary><ul class='spots'>{notes}</ul></details>"
    return f"<section class='small'>{out}</section>" if out else ""


def _flat(config: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """Return a nested mapping as dotted names and values."""
    out: list[tuple[str, str]] = []
    for key, value in config.items():
        if isinstance(value, Mapping) and value:
            out += _flat(value, f"{prefix}{key}.")
        else:
            text = value if isinstance(value, str) else json.dumps(value, default=str, ensure_ascii=False)
            out.append((f"{prefix}{key}", text))
    return out
