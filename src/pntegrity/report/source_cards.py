"""Parts of the report page for vehicles with several sources: lanes, verdicts level by level, the risk
tree.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from math import log10
from typing import Any

from pntegrity.report.cards import escaped, plot, section, table_of
from pntegrity.report.sentences import names
from pntegrity.report.source_figures import LOOKS
from pntegrity.report.units import duration, percent
from pntegrity.states import source_of

__all__ = ["levels_part", "risk_part", "sources_part", "words_of"]

LINES = 24
"""How many rows the table of verdicts has."""
EACH = 6
"""How many branches of each number of faults the table of the tree has."""
_LANES = (
    "A lane a source, thinner ones for its sensors. No bar: it did not measure. A thin line leads from the "
    "estimated onset of a fault to where somebody was left out, a diamond marks the return."
)
_LEVELS = (
    "What the monitors said before anybody was left out: which source, which of its sensors; and the trials "
    "of who was left out. Sources of which any could be at fault are ambiguous."
)
_TREE = (
    "Every combination of those used at the end that may be at fault together, and how probable it is that "
    "exactly these are. The most probable are monitored: the position without them is compared with the "
    "others. The rest is not, and its probability comes off the integrity risk."
)


def sources_part(numbers: Mapping[str, Any]) -> str:
    """Return the lanes of all sources, and a row each."""
    swatches = "".join(
        f"<li><i style='{_swatch(*look)}'></i>{escaped(word)}</li>" for word, *look in LOOKS.values()
    )
    rows = [
        (
            s["source"], str(len(s["sensors"]) or 1), str(s["epochs"]),
            f"{percent(s['used']['share'])} %" if s["epochs"] else "–",
            str(s["left_out"]), str(s["readmitted"]), duration(round(s["silent_s"], 1)),
        )
        for s in numbers["sources"]["sources"]
    ]  # fmt: skip
    titles = ("Source", "Sensors", "Epochs with it", "Used at", "Left out", "Came back", "Longest interval")
    return section(
        "Sources and their sensors",
        plot("sources", _LANES).replace("<div", f"<ul class='legend lanes'>{swatches}</ul><div", 1)
        + table_of(titles, rows, "white"),
    )


def _swatch(colour: str, stripes: str) -> str:
    if not stripes:
        return f"background:var({colour})"
    return f"background:repeating-linear-gradient(135deg,var({stripes}) 0 2px,var({colour}) 2px 5px)"


# --- level by level ---------------------------------------------------------------------------------------


def levels_part(numbers: Mapping[str, Any]) -> str:
    """Return who was named at which level, and the trials of who was left out, in order of time."""
    told = numbers["sources"]
    rows = sorted([*_verdict_rows(told["verdicts"]), *map(_proof_row, told["proofs"])])
    if not rows:
        return section("Level by level", "<p class='quiet'>No monitor alarmed.</p>")
    rest = max(len(rows) - LINES, 0) + sum(told["omitted"].values())
    where = "verdicts.parquet and proofs.csv have all"
    more = f"<p class='quiet'>And {rest} more: {where}.</p>" if rest else ""
    body = "".join(
        f"<tr><th>{escaped(when)}</th><td class='word'>{escaped(level)}</td><td "
        f"class='said'>{escaped(found)}</td>"
        f"<td class='said'>{escaped(then)}</td></tr>"
        for _, when, level, found, then in rows[:LINES]
    )
    table = _table("told", ("When", "Level", "What it said", "What followed"), body)
    return section("Level by level", f"<p class='quiet'>{_LEVELS}</p>{table}{more}")


def _table(kind: str, titles: Sequence[str], rows: str) -> str:
    head = "".join(f"<th>{t}</th>" for t in titles)
    inside = f"<thead><tr>{head}</tr></thead><tbody>{rows}</tbody>"
    return f"<div class='scroll'><table class='{kind}'>{inside}</table></div>"


Row = tuple[str, str, str, str, str]


def _verdict_rows(found: Sequence[Mapping[str, Any]]) -> list[Row]:
    """Return a row for what several monitors said alike at the same time."""
    alike: dict[tuple[str, ...], list[Mapping[str, Any]]] = {}
    for v in found:
        alike.setdefault((v["from"], v["to"], v["level"], words_of(v)), []).append(v)
    return [_verdict_row(same) for same in alike.values()]


def _verdict_row(same: Sequence[Mapping[str, Any]]) -> Row:
    v = same[0]
    level = {"source": "Source", "sensor": "Sensor", "none": "Alarm"}[v["level"]]
    whole = dict.fromkeys(n for v in same for n in v["left_out"])
    gone = [n for n in whole if "." not in n or source_of(n) not in whole]
    often = f" ({v['epochs']} epochs)" if v["epochs"] > 1 else ""
    said = f"{words_of(v)}, by {names([v['monitor'].upper() for v in same])}{often}"
    return v["from"], _when(v), level, said, f"{names(gone)} left out" if gone else "nobody left out"


def _when(event: Mapping[str, Any]) -> str:
    first, last = event["from"][11:19], event["to"][11:19]
    return first if first == last else f"{first}-{last}"


def words_of(verdict: Mapping[str, Any]) -> str:
    """Return whom a verdict of `sources.source_numbers` names: ``lbl and gnss together``,
    ``ambiguous: lbl or gnss``.
    """
    sets = verdict["named"]
    if not sets:
        return "nobody named"
    if verdict["ambiguous"]:
        return f"ambiguous: {' or '.join(dict.fromkeys('+'.join(s) for s in sets))}"
    (one,) = sets
    return f"{names(one)}{' together' if len(one) > 1 else ''}"


def _proof_row(p: Mapping[str, Any]) -> Row:
    many = p["tests"] - 1
    size = f"largest deviation {p['statistic']:.2g} of {p['limit']:.2g} allowed"
    if p["passed"]:
        before = f", after {many} in vain" if many else ""
        said = f"{p['name']} passed a trial of {_epochs(p['epochs'])}{before}: {size}; {_if_faulty(p)}"
        return p["from"], _when(p), "Verification", said, "it is back"
    why = p["reason"] or size
    more = f" and {many} before it" if many else ""
    said = f"{p['name']} failed a trial of {_epochs(p['epochs'])}{more} ({why})"
    return p["from"], _when(p), "Verification", said, "left out still"


def _epochs(n: int) -> str:
    return f"{n} epoch{'s' * (n != 1)}"


def _if_faulty(p: Mapping[str, Any]) -> str:
    """Say how probably who is still at fault, by as much as before, would pass."""
    if p["readmission"] >= 1.0:
        return "how probably a fault passes is not known"
    known = f"{p['readmission']:.1g}" if p["readmission"] >= 1e-9 else "below 1e-9"
    return f"were it still as far off, it would pass with probability {known}"


# --- the risk tree ----------------------------------------------------------------------------------------


def risk_part(numbers: Mapping[str, Any]) -> str:
    """Return the tree of those used last, what of it is not monitored, and how it changed."""
    risk = numbers["sources"]["risk"]
    if risk is None:
        return ""
    last = next((s for s in risk["sets"] if s["names"] == risk["names"]), None)
    sum_text = ""
    if last is not None:
        within = "within" if last["unmonitored"] <= risk["allowed"] else "beyond"
        sum_text = (
            f"<p class='sum'><b>{escaped(names(risk['names'], 12))}</b>: {last['modes']} fault "
            f"mode{'s' * (last['modes'] != 1)} "
            f"monitored, up to {last['together']} at once. Not monitored: {last['unmonitored']:.2g}, "
            f"{within} the "
            f"{risk['allowed']:.2g} that may be, of an integrity risk of {risk['p_hmi']:.2g}.</p>"
        )
    return section("Risk tree", f"<p class='quiet'>{_TREE}</p>{sum_text}{_branches(risk)}{_changes(risk)}")


def _branches(risk: Mapping[str, Any]) -> str:
    rows = "".join(
        row
        for size, found in groupby(risk["branches"], key=lambda b: len(b["names"]))
        for row in _of_size(size, list(found), risk["at_once"][size])
    )
    listed = max(len(b["names"]) for b in risk["branches"])
    beyond = sum(risk["at_once"][listed + 1 :])
    if beyond > 0.0:
        rows += _tree_row("fault", f"More than {listed} at once", beyond, "not listed")
    return _table("tree", ("At fault", "Probability", "", ""), rows)


def _of_size(size: int, found: Sequence[Mapping[str, Any]], probability: float) -> Iterator[str]:
    """Yield the row of a number of faults, and those of its most probable branches."""
    watched = sum(b["monitored"] for b in found)
    if not size:
        yield _tree_row("size", "Nobody", probability, "")
        return
    title = "One alone" if size == 1 else f"{size} at once"
    yield _tree_row("size", title, probability, f"{watched} of {len(found)} monitored")
    for b in found[:EACH]:
        tone = "good" if b["monitored"] else "bad"
        said = "monitored" if b["monitored"] else "not monitored"
        yield _tree_row("branch", " + ".join(b["names"]), b["probability"], said, tone)
    if len(found) > EACH:
        rest = found[EACH:]
        kept = sum(b["monitored"] for b in rest)
        said = f"{kept} of them monitored" if kept else "not monitored"
        yield _tree_row("branch", f"{len(rest)} others", sum(b["probability"] for b in rest), said)


def _tree_row(kind: str, title: str, probability: float, said: str, tone: str = "") -> str:
    width = 100.0 * max(1.0 + log10(max(probability, 1e-16)) / 16.0, 0.0)
    bar = f"<span class='bar {tone}' style='--w:{width:.0f}%'></span>" if tone else ""
    number = f"{probability:.2g}".replace("e-", "e\u2212") if probability < 0.99 else f"{probability:.6g}"
    return (
        f"<tr class='{kind}'><th>{escaped(title)}</th><td>{number}</td><td class='wide'>{bar}</td>"
        f"<td class='word'>{escaped(said)}</td></tr>"
    )


def _changes(risk: Mapping[str, Any]) -> str:
    """Return the sets of who was used, where the tree changed."""
    if len(risk["sets"]) < 2:
        return ""
    rows = [
        (
            names(s["names"], 12), s["from"][11:19], str(s["epochs"]), str(s["modes"]), str(s["together"]),
            f"{s['unmonitored']:.2g}",
        )
        for s in risk["sets"]
    ]  # fmt: skip
    titles = ("Used together", "First at", "Epochs", "Modes monitored", "At once", "Not monitored")
    return f"<h3>How it changed</h3>{table_of(titles, rows, 'white')}"
