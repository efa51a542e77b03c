"""Parts of the report page that hold text and tables: the head, what happened, the tables, the small
print.
"""

from __future__ import annotations

import html
import json
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from pntegrity.evaluate.whiteness import KINDS
from pntegrity.report.facts import RunFacts
from pntegrity.report.sentences import Sentence, kind_words
from pntegrity.report.summary import headline
from pntegrity.report.units import duration, length, percent

__all__ = [
    "Figures", "details", "escaped", "flat", "header", "monitor_table", "plot", "section",
    "story_list", "table_of", "whiteness_table",
]  # fmt: skip

Figures = tuple[str, str, str, str]
WHITE_ENOUGH = 0.1
"""Autocorrelations below this are called white."""


def escaped(text: object) -> str:
    """Return text that stands for itself in HTML."""
    return html.escape(str(text))


def section(title: str, inside: str, there: bool = True) -> str:
    """Return a section of the page, nothing where it is not `there`."""
    return "" if not there else f"<section><h2>{escaped(title)}</h2>{inside}</section>"


def plot(name: str, caption: str) -> str:
    """Return the place of a figure, with what is said above it."""
    said = f"<figcaption>{escaped(caption)}</figcaption>" if caption else ""
    return f"<figure>{said}<div class='plot' id='fig-{name}'></div></figure>"


def table_of(titles: Sequence[str], rows: Sequence[Sequence[str]], kind: str = "") -> str:
    """Return a table with a header a row; `kind` is its class."""
    head = "".join(f"<th>{escaped(t)}</th>" for t in titles)
    body = "".join(
        f"<tr><th>{escaped(row[0])}</th>{''.join(f'<td>{_kept(c)}</td>' for c in row[1:])}</tr>"
        for row in rows
    )
    named = f" class='{kind}'" if kind else ""
    return (
        f"<div class='scroll'><table{named}><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"
    )


def _kept(text: str) -> str:
    """Return the text of a cell; the minus of an exponent is one at which no line is broken."""
    return escaped(re.sub(r"(?<=\de)-(?=\d)", "\u2212", text))


def header(numbers: Mapping[str, Any], facts: RunFacts, more: Sequence[Figures] = ()) -> str:
    """Return the verdict on the run and its main figures; `more` follow them (label, value, unit, note)."""
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
        f"<h1>{escaped(title)}</h1><p class='lead'>{escaped(detail)}</p>"
        f"<p class='chips'>{''.join(f'<span>{escaped(c)}</span>' for c in chips if c)}</p>"
        f"<dl class='figures'>{''.join(_number(*n) for n in (*_numbers(numbers), *more))}</dl></header>"
    )


def _number(label: str, value: str, unit: str, note: str) -> str:
    said = f"{escaped(value)}<small>{escaped(unit)}</small>"
    kind = "" if value[:1].isdigit() else " class='word'"
    return f"<div><dt>{escaped(label)}</dt><dd{kind}>{said}</dd><p>{escaped(note)}</p></div>"


def _numbers(s: Mapping[str, Any]) -> list[tuple[str, str, str, str]]:
    ok, untested = s["availability"]["ok"], s["availability"]["unavailable"]["epochs"]
    alarms = s["availability"]["alert"]["epochs"]
    gone = sorted({e["key"] for e in s["exclusions"]})
    used = s["satellites"]
    out = [
        (
            "Tested and OK",
            percent(ok["share"]),
            "%",
            f"{ok['epochs']} of {s['epochs']} epochs, {untested} untested",
        ),
        (
            "Unresolved alerts",
            str(alarms),
            "epochs",
            _of_alerts(alarms, s["limit_alerts"]),
        ),
        ("Left out", str(len(gone)), _kinds(s, gone), f"{s['readmissions']} readmitted"),
        (
            "Satellites used" if s["sources"] is None else "Sources used",
            f"{used['used_mean']:.1f}",
            "mean",
            f"never fewer than {used['used_min']}",
        ),
    ]
    return [*out, *_accuracy(s)]


def _of_alerts(alerts: int, of_limits: int) -> str:
    """Say why there were alerts."""
    if of_limits:
        return f"{of_limits} of them: level above its alert limit"
    return "an alarm remained after exclusion" if alerts else "none remained"


def _kinds(s: Mapping[str, Any], gone: Sequence[str]) -> str:
    """Return what those that were left out are: satellites, sources, sensors of these."""
    parts = {"." in name for name in gone}
    word = "satellite" if s["sources"] is None else "sensor" if parts == {True} else "source"
    both = " and sensors" if len(parts) == 2 and word == "source" else ""
    return f"{word}{'s' * (len(gone) != 1)}{both}"


def _accuracy(s: Mapping[str, Any]) -> list[tuple[str, str, str, str]]:
    """Return how far off the position is, where the truth is known, else what the filter says of it."""
    if s["position"]:
        h, u = s["position"]["h"], s["position"]["u"]
        value, name = length(h["p95_m"]).split()
        note = f"RMS {length(h['rms_m'])}, largest {length(h['max_m'])}; up 95\u00a0% {length(u['p95_m'])}"
        return [("Horizontal error, 95\u00a0%", value, name, note)]
    sigma = s["sigma_m"]
    if sigma["e"] is None:
        return []
    value, name = length(math.hypot(sigma["e"], sigma["n"])).split()
    note = f"as the filter states it; up {length(sigma['u'])}. No truth given"
    return [("Horizontal sigma", value, name, note)]


def story_list(sentences: Sequence[Sentence], facts: RunFacts) -> str:
    """Return what happened, and what was injected."""
    items = "".join(f"<li class='{s.kind}'>{_told(s.text)}</li>" for s in sentences)
    faults = "".join(f"<li>{escaped(f)}</li>" for f in facts.faults)
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
        f"<time>{escaped(when)}</time><span>{escaped(what)}</span>"
        if colon and when[:1].isdigit()
        else f"<span>{escaped(text)}</span>"
    )


def monitor_table(numbers: Mapping[str, Any]) -> str:
    """Return a row a monitor: how often it tested and alarmed."""
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
        f"<tr><th>{escaped(m['monitor'].upper())}</th><td class='word'>{escaped(m['variant'])}</td>"
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


def whiteness_table(numbers: Mapping[str, Any], facts: RunFacts) -> str:
    """Return how white the innovations are, and what cannot be seen at all."""
    w = numbers["whiteness"]
    head = "".join(f"<th>{duration(lag)}</th>" for lag in w["lags_s"])
    rows = "".join(
        f"<tr><th>{word}</th>{''.join(_correlation(r) for r in w[kind]['autocorrelation'])}"
        f"<td>{_short(w[kind]['mean_square'])}</td></tr>"
        for word, kind in zip(kind_words(numbers["sources"] is not None), KINDS, strict=True)
        if w[kind]["count"]
    )
    spots = "".join(f"<li>{escaped(b)}</li>" for b in facts.blind_spots)
    unseen = f"<h3>What this set-up cannot see</h3><ul class='spots'>{spots}</ul>" if spots else ""
    return (
        "<p>The thresholds assume innovations that are white. Measured here, with the noise model "
        f"<b>{escaped(facts.noise_name or 'unnamed')}</b>:</p><div class='scroll'>"
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


def details(facts: RunFacts) -> str:
    """Return configuration and notes, folded."""
    rows = "".join(
        f"<tr><th>{escaped(k)}</th><td class='word'>{escaped(v)}</td></tr>" for k, v in flat(facts.config)
    )
    out = (
        f"<details><summary>Configuration</summary><table class='config'>{rows}</table></details>"
        if rows
        else ""
    )
    if facts.notes:
        notes = "".join(f"<li>{escaped(n)}</li>" for n in facts.notes)
        title = f"What the readers left out ({len(facts.notes)})"
        out += f"<details><summary>{title}</summary><ul class='spots'>{notes}</ul></details>"
    return f"<section class='small'>{out}</section>" if out else ""


def flat(config: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """Return a nested mapping as dotted names and values."""
    out: list[tuple[str, str]] = []
    for key, value in config.items():
        if isinstance(value, Mapping) and value:
            out += flat(value, f"{prefix}{key}.")
        else:
            text = value if isinstance(value, str) else json.dumps(value, default=str, ensure_ascii=False)
            out.append((f"{prefix}{key}", text))
    return out
