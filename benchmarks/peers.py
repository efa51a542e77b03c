"""Ours beside RTKLIB, sidereon and gnss_lib_py: the same file, the same epochs, the same run.

``python -m benchmarks.peers --data FOLDER --write docs/benchmarks.md``
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.stages import audit_stages, log_stages
from benchmarks.timing import cpu_each, cpu_of, markdown
from benchmarks.tools import Fix
from benchmarks.workload import DEFAULT_DATA, FAULT_M, FAULTED, FIRST, LAST, Workload, brux
from pntegrity.pipeline import Outcome, Pipeline
from pntegrity.run import pipeline_for

__all__ = ["compare", "tools_for"]

COMMAND = "python -m benchmarks.peers --data FOLDER --write docs/benchmarks.md"


@dataclass
class Cell:
    """CPU seconds of one stage of one tool, and what came out."""

    seconds: float
    fixes: Sequence[Fix] = ()


def tools_for(work: Workload) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the tools that can run, ours first, and why the others cannot."""
    from benchmarks.tools.gnss_lib_py_tool import GnssLibPy
    from benchmarks.tools.ours import Ours
    from benchmarks.tools.rtklib import Rtklib
    from benchmarks.tools.sidereon_tool import Sidereon

    ionosphere = work.loaded.klobuchar is not None
    made: dict[str, Callable[[], Any]] = {
        "pntegrity": lambda: Ours(work),
        "RTKLIB": lambda: Rtklib(work, ionosphere),
        "sidereon": lambda: Sidereon(work),
        "gnss_lib_py": lambda: GnssLibPy(work),
    }
    found, absent = {}, {}
    for name, make in made.items():
        try:
            found[name] = make()
        except ImportError as error:
            absent[name] = f"{name} is not installed ({error.name})"
    return found, absent


def compare(work: Workload, tools: dict[str, Any], rounds: int) -> dict[str, dict[str, Cell]]:
    """Return the cells of the table: by stage, then by tool."""
    span = range(FIRST, LAST)
    table: dict[str, dict[str, Cell]] = {}
    for name, tool in tools.items():
        n = tool.read_observations()
        _put(table, "read observations", name, cpu_of(tool.read_observations, rounds) / n)
        if hasattr(tool, "read_navigation"):
            _put(table, "read navigation (whole file)", name, cpu_of(tool.read_navigation, rounds))
        if hasattr(tool, "all_states"):
            each = cpu_of(tool.all_states, rounds) / len(work.loaded.epochs)
            _put(table, "satellite states", name, each)
        elif hasattr(tool, "states"):
            each = cpu_each(_preparing(tool, False), tool.states, span, rounds)[0]
            _put(table, "satellite states", name, each)
        for stage, run, faulted in (
            ("position", tool.fix, False),
            ("position, test, exclusion", tool.fix_excluding, False),
            ("the same, three satellites at fault", tool.fix_excluding, True),
        ):
            seconds, fixes = _timed(tool, run, faulted, rounds if name != "sidereon" or not faulted else 1)
            _put(table, stage, name, seconds, fixes)
    return table


def _put(
    table: dict[str, dict[str, Cell]], stage: str, tool: str, seconds: float, fixes: Sequence[Fix] = ()
) -> None:
    table.setdefault(stage, {})[tool] = Cell(seconds, fixes)


def _timed(tool: Any, run: Callable[[Any], Fix], faulted: bool, rounds: int) -> tuple[float, list[Fix]]:
    seconds, fixes = cpu_each(_preparing(tool, faulted), run, range(FIRST, LAST), rounds)
    if not hasattr(tool, "left_out"):
        return seconds, fixes
    named = []
    for k in range(FIRST, LAST):  # who was left out is asked apart: it is no part of the work
        prepared = tool.prepare(k, faulted)
        fix = run(prepared)
        named.append(Fix(fix.position_m, tool.left_out(prepared), fix.said))
    return seconds, named


def _preparing(tool: Any, faulted: bool) -> Callable[[int], Any]:
    return lambda k: tool.prepare(k, faulted)


def rms_m(work: Workload, ks: Sequence[int], fixes: Sequence[Fix]) -> float:
    """Return the horizontal RMS of the positions there are, nan where there is none."""
    h = [
        work.horizontal_m(k, f.position_m) for k, f in zip(ks, fixes, strict=True) if f.position_m is not None
    ]
    return float(np.sqrt(np.mean(np.square(h)))) if h else float("nan")


# --- the page ---------------------------------------------------------------------------------------


def page(work: Workload, rounds: int) -> str:
    """Return docs/benchmarks.md."""
    tools, absent = tools_for(work)
    table = compare(work, tools, rounds)
    rows = own_rows(work, rounds)
    baseline = table["position"].get("RTKLIB")
    parts = [
        "# Benchmarks\n",
        f"Written by `{COMMAND}` (`pip install -e '.[bench]'`;\n`pytest benchmarks` measures the stages "
        "alone, `python -m benchmarks.process` the whole command). All times are\nCPU time in one thread, "
        f"the fastest of {rounds} rounds; on a machine that others use too, ratios repeat to about a "
        "fifth.\n",
        _setting(work, tools, absent),
        "## Cost beside other tools\n",
        "CPU ms an epoch (in brackets: the tool's time over ours).\n",
        _cost_table(table, tools),
        _cost_notes(tools),
        "## What the positions are worth\n",
        _accuracy_table(work, table, tools),
        f"## Three satellites {FAULT_M:g} m off at once\n",
        f"{', '.join(FAULTED)}: {FAULT_M:g} m on the code of each in epochs {FIRST} to {LAST - 1}. A "
        "snapshot tool meets each epoch alone;\nthe filter meets them in time order, with all five monitors "
        "at 1e-6.\n",
        _fault_table(work, table, tools),
        "## Our stages\n",
        "CPU ms an epoch"
        + (", and in units of RTKLIB's `pntpos` on the same file.\n" if baseline else ".\n"),
        _own_table(rows, baseline.seconds if baseline else float("nan")),
        "## Audit\n",
        "Monte Carlo epoch-tests a CPU second on the 10-satellite record, all monitors.\n",
        _audit_table(rounds),
    ]
    return "\n".join(parts)


def own_rows(work: Workload, rounds: int) -> list[tuple[str, int, float]]:
    """Return name, epochs and CPU seconds an epoch of each of our stages."""
    out = []
    for stage in log_stages(work):
        stage.run()
        out.append((stage.name, stage.units, cpu_of(stage.run, rounds) / stage.units))
    return out


def _setting(work: Workload, tools: dict[str, Any], absent: dict[str, str]) -> str:
    versions = ", ".join(
        f"{n} {t.version}" if n not in t.version.lower() else t.version for n, t in tools.items()
    )
    codes = [code for e in work.loaded.epochs if (code := e.sensor("code")) is not None]
    ionosphere = "Klobuchar" if work.loaded.klobuchar else "no ionosphere model (the file has none)"
    lines = [
        f"File: BRUX, {len(work.loaded.epochs)} epochs at 1 Hz, GPS + GLONASS + Galileo + BDS, "
        f"{np.mean([len(c.keys) for c in codes]):.0f} codes an epoch before the\n10 degree mask. All tools: "
        f"one frequency, broadcast ephemerides, Saastamoinen, {ionosphere}.\nCosts, and the faults below, "
        f"are of the {LAST - FIRST} epochs from {FIRST} on.\n",
        f"Versions: {versions}.\n",
    ]
    lines += [f"Not run: {why}.\n" for why in absent.values()]
    return "\n".join(lines)


def _cost_table(table: dict[str, dict[str, Cell]], tools: dict[str, Any]) -> str:
    rows = []
    for stage, cells in table.items():
        ours = cells["pntegrity"].seconds
        rows.append((stage, *(_cost(cells.get(n), ours, n) for n in tools)))
    whole = _whole(table)
    rows.append(
        (
            "states, position, test, exclusion together",
            *(_cost(whole.get(n), whole["pntegrity"].seconds, n) for n in tools),
        )
    )
    return markdown(("stage", *tools), rows)


def _cost(cell: Cell | None, ours: float, name: str) -> str:
    if cell is None:
        return "-"
    ms = f"{cell.seconds * 1e3:.3g}"
    return ms if name == "pntegrity" else f"{ms} ({cell.seconds / ours:.2g})"


def _whole(table: dict[str, dict[str, Cell]]) -> dict[str, Cell]:
    """Return what a tested position costs in all: `pntpos` and sidereon make the states themselves."""
    tested = dict(table["position, test, exclusion"])
    tested.pop("gnss_lib_py", None)
    ours = tested["pntegrity"].seconds + table["satellite states"]["pntegrity"].seconds
    return tested | {"pntegrity": Cell(ours)}


def _cost_notes(tools: dict[str, Any]) -> str:
    notes = [f"- {n} is given: {t.given}." for n, t in tools.items() if t.given]
    notes += [
        "- RTKLIB and sidereon make the satellite states inside the position.",
        "- gnss_lib_py reads only the first 20 epochs of the file. Its positions without a fault are ours by "
        "construction: the same rows with the same weights.",
        "- Ours includes a velocity from range rates, as RTKLIB's does; sidereon's and gnss_lib_py's do not.",
    ]
    return "\n".join(notes) + "\n"


def _accuracy_table(work: Workload, table: dict[str, dict[str, Cell]], tools: dict[str, Any]) -> str:
    span = range(FIRST, LAST)
    every = range(len(work.loaded.epochs))
    rows = []
    for name, tool in tools.items():
        whole = "-"
        if name != "gnss_lib_py":
            whole = f"{rms_m(work, every, [tool.fix(tool.prepare(k, False)) for k in every]):.2f}"
        some = rms_m(work, span, table["position"][name].fixes)
        rows.append((f"{name}, snapshot", f"{some:.2f}", whole))
    filtered = [Fix(o.update.posterior.mean[:3]) for o in work.outcomes(work.loaded.epochs)]
    rows.append(
        (
            "pntegrity, filter (spp_kf)",
            f"{rms_m(work, span, filtered[FIRST:LAST]):.2f}",
            f"{rms_m(work, every, filtered):.2f}",
        )
    )
    return markdown(("horizontal RMS, m", f"epochs {FIRST}-{LAST - 1}", "all epochs"), rows)


def _fault_table(work: Workload, table: dict[str, dict[str, Cell]], tools: dict[str, Any]) -> str:
    rows = []
    span = range(FIRST, LAST)
    for name in tools:
        cell = table["the same, three satellites at fault"][name]
        rows.append(_fault_row(f"{name}, snapshot", work, span, cell.fixes, cell.seconds))
    seconds, outcomes = _filter_through(work)
    fixes = [Fix(o.update.posterior.mean[:3], tuple(sorted(o.update.excluded))) for o in outcomes]
    rows.append(_fault_row("pntegrity, filter (spp_kf)", work, span, fixes, seconds))
    head = (
        "tool",
        "position given",
        "left out exactly these",
        "others left out too",
        "horizontal RMS, m",
        "largest, m",
        "ms an epoch",
    )
    return markdown(head, rows)


def _filter_through(work: Workload) -> tuple[float, list[Outcome]]:
    before: Pipeline = pipeline_for(work.config(), work.faulted)
    for epoch in work.faulted.epochs[:FIRST]:
        before.push(epoch)
    outcomes: list[Outcome] = []

    def through() -> None:
        at = Pipeline(before.estimator, before.monitors, before.policy, before.checkpoint)
        outcomes[:] = [at.push(e) for e in work.faulted.epochs[FIRST:LAST]]

    return cpu_of(through) / (LAST - FIRST), outcomes


def _fault_row(
    name: str, work: Workload, span: range, fixes: Sequence[Fix], seconds: float
) -> tuple[str, ...]:
    exact = sum(set(f.excluded) == set(FAULTED) for f in fixes)
    more = Counter(s for f in fixes for s in f.excluded if s not in FAULTED)
    given = [(k, f) for k, f in zip(span, fixes, strict=True) if f.position_m is not None]
    errors = [work.horizontal_m(k, f.position_m) for k, f in given if f.position_m is not None]
    return (
        name, f"{len(given)} of {len(fixes)}", f"{exact} of {len(fixes)}",
        ", ".join(f"{s} ({n})" for s, n in more.most_common(4)) or "none",
        f"{rms_m(work, span, fixes):.2f}" if errors else "-", f"{max(errors):.2f}" if errors else "-",
        f"{seconds * 1e3:.3g}",
    )  # fmt: skip


def _own_table(rows: Sequence[tuple[str, int, float]], baseline: float) -> str:
    known = np.isfinite(baseline)
    cells = [(n, f"{s * 1e3:.3f}", f"{s / baseline:.2f}" if known else "-") for n, _, s in rows]
    return markdown(("stage", "ms an epoch", "times pntpos"), cells)


def _audit_table(rounds: int) -> str:
    rows = []
    for stage in audit_stages():
        stage.run()
        rows.append((stage.name.removeprefix("audit "), f"{stage.units / cpu_of(stage.run, rounds):.2g}"))
    return markdown(("monitor", "epoch-tests a CPU second"), rows)


def main() -> None:
    """Measure, print, and write the page where asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=DEFAULT_DATA, help="folder of the real logs")
    parser.add_argument("--write", type=Path, help="write the page here; else print it")
    parser.add_argument(
        "--rounds", type=int, default=3, help="rounds of each measurement; the fastest counts"
    )
    arguments = parser.parse_args()
    try:
        work = brux(arguments.data)
    except FileNotFoundError as error:
        sys.exit(f"nothing to measure: {error}")
    with threadpool_limits(1):
        text = page(work, arguments.rounds)
    work.close()
    if arguments.write:
        arguments.write.write_text(text, "utf-8")
    else:
        print(text)


if __name__ == "__main__":
    main()
