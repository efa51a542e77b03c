"""The run in a terminal: a short table and the story's first lines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from pntegrity.pipeline import Outcome
from pntegrity.report.facts import RunFacts
from pntegrity.report.sentences import names
from pntegrity.report.story import story
from pntegrity.report.summary import headline, summary
from pntegrity.report.units import degrees, length, level_text, percent, together

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.table import Table

__all__ = ["verdict_table"]

LINES = 8
"""How many sentences of the story are shown."""
TONES = {"ok": "green", "alert": "red", "unavailable": "yellow"}


def verdict_table(
    outcomes: Sequence[Outcome], facts: RunFacts, numbers: Mapping[str, Any] | None = None
) -> RenderableType:
    """Return what ``rich`` prints after a run: the verdict, a line a monitor, the figures, what happened.

    Parameters
    ----------
    outcomes : sequence of Outcome
    facts : RunFacts
    numbers : mapping, optional
        What `summary` gives, where it is at hand.
    """
    from rich.console import Group
    from rich.text import Text

    numbers = summary(outcomes, facts) if numbers is None else numbers
    title, detail, tone = headline(numbers)
    parts: list[RenderableType] = [Text(title, style=f"bold {TONES[tone]}"), Text(detail), Text()]
    if numbers["monitors"]:
        parts += [_monitors(numbers), Text()]
    parts += [Text(line) for line in _figures(numbers)]
    told = story(outcomes, facts)
    parts += [Text(), *(Text(s.text, style=TONES.get(s.kind, "")) for s in told[:LINES])]
    if len(told) > LINES:
        parts.append(Text(f"... and {len(told) - LINES} more in the report", style="dim"))
    return Group(*parts)


def _monitors(numbers: Mapping[str, Any]) -> Table:
    from rich.box import SIMPLE_HEAD
    from rich.table import Table
    from rich.text import Text

    table = Table(box=SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column("monitor", min_width=max(len(m["monitor"]) for m in numbers["monitors"]))
    for name, justify in (("variant", "left"), ("P_FA", "right"), ("tests", "right")):
        table.add_column(name, justify=justify)  # type: ignore[arg-type]
    for name in ("alarms,\nfirst look", "after\nexclusion", "worst\nratio"):
        table.add_column(name, justify="right", no_wrap=True)
    for m in numbers["monitors"]:
        first, last = m["first"], m["final"]
        worst = "-" if last["worst_ratio"] is None else f"{last['worst_ratio']:.3g}"
        cells = [
            m["monitor"],
            m["variant"],
            f"{m['p_fa']:.0e}",
            str(last["tests"]),
            str(first["alarms"]),
            str(last["alarms"]),
            worst,
        ]
        table.add_row(*map(Text, cells), style="red" if last["alarms"] else "")
    return table


def _figures(numbers: Mapping[str, Any]) -> list[str]:
    share = numbers["availability"]
    said = ", ".join(
        f"{s} {share[s]['epochs']} ({100 * share[s]['share']:.1f} %)" for s in ("ok", "alert", "unavailable")
    )
    keys = sorted({e["key"] for e in numbers["exclusions"]})
    n = len(numbers["exclusions"])
    made = f" ({n} exclusion{'s' * (n != 1)}, {numbers['readmissions']} readmitted)" if keys else ""
    lines = [f"epochs      {numbers['epochs']}: {said}", f"excluded    {', '.join(keys) or 'none'}{made}"]
    p = numbers["position"]
    if p:
        horizontal, up = p["h"], p["u"]
        rms = f"RMS {length(horizontal['rms_m'])} horizontal, {length(up['rms_m'])} up"
        lines.append(f"position    {rms} (95 %: {together(horizontal['p95_m'], up['p95_m'])})")
    lines += [_protection(numbers["protection"])] if numbers["protection"] else []
    return [*lines, *_sources(numbers), *_inertial(numbers)]


def _sources(numbers: Mapping[str, Any]) -> list[str]:
    """Return a line for each source of a vehicle."""
    found = numbers["sources"]["sources"] if numbers["sources"] is not None else ()
    width = max((len(s["source"]) for s in found), default=0)
    return [
        f"{'source' if not i else '':<12}{s['source']:<{width}}  {_source(s)}" for i, s in enumerate(found)
    ]


def _source(s: Mapping[str, Any]) -> str:
    """Say how much of what a source measured was used, how often it was left out, and came back."""
    if not s["epochs"]:
        return "never measured anything"
    used = f"used at {percent(s['used']['share'])} % of {s['epochs']} epochs"
    if not s["left_out"]:
        return f"{used}, never left out"
    times = {1: "once", 2: "twice"}.get(s["left_out"], f"{s['left_out']} times")
    who = "" if s["names"] == [s["source"]] else f" ({names(s['names'])})"
    return f"{used}, left out {times}{who}, back {s['readmitted']}"


def _inertial(numbers: Mapping[str, Any]) -> list[str]:
    """Return the lines of an INS and of fault detection before the filter."""
    ins, screened, found = numbers["inertial"], numbers["screening"], numbers["sections"]
    out = []
    if found is not None:
        out.append(f"sections    {', '.join(_section(r) for r in found['rows'][:-1] if r['epochs'])}")
    if ins is not None:
        angles = ", ".join(f"{a} {degrees(v)}" for a, v in ins["attitude_sigma_deg"].items())
        error = ins["attitude_error_deg"]
        rms = f"; heading RMS {degrees(error['heading']['rms'])}" if error is not None else ""
        out.append(f"attitude    sigma {angles}{rms}")
    if screened is not None:
        rows, used = screened["dropped"]["rows"], screened["used"]["epochs"]
        said = f"{screened['method']}, {screened['variant']}: {rows} rows dropped"
        out.append(f"screened    {said}, {used} of {screened['epochs']} epochs used")
    return out


def _section(r: Mapping[str, Any]) -> str:
    """Return how much of the run a section is, and its error where the truth is known."""
    rms = f" RMS {length(r['horizontal_m']['rms'])}" if r["horizontal_m"] else ""
    return f"{r['section']}{rms} ({100 * r['share']:.0f} %)"


def _protection(p: Mapping[str, Any]) -> str:
    """Return the line of the protection levels."""
    said = [
        f"{name} median {level_text(p[key]['median'])} (95 % {level_text(p[key]['p95'])})"
        for name, key in (("HPL", "hpl_m"), ("VPL", "vpl_m"))
    ]
    if p["available"]:
        said.append(f"within alert limits {100 * p['available']['share']:.1f} %")
    if p["unbounded"]["epochs"]:
        said.append(f"unbounded {p['unbounded']['epochs']}")
    if p["misleading"]:
        said.append(f"misleading {p['misleading']['epochs']} of {p['misleading']['compared']}")
    return f"protection  {', '.join(said)}"
