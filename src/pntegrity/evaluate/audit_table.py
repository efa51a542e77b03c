"""An audit for people (a table for the terminal) and for machines (a dict for JSON)."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from pntegrity.evaluate.audit import AuditResult
from pntegrity.evaluate.visibility import Visibility

if TYPE_CHECKING:
    from rich.console import Group
    from rich.table import Table

__all__ = ["audit_json", "audit_table"]


def audit_json(result: AuditResult) -> dict[str, Any]:
    """Return an audit as plain dicts, lists and numbers: the fields of `AuditResult`, and its `rows`."""
    return {**asdict(result), "rows": result.rows()}


def audit_table(result: AuditResult) -> Group:
    """Return an audit as two rich tables: the false-alarm rate, and the smallest faults that are seen."""
    from rich.console import Group

    return Group(_rates(result), _faults(result), *_skipped(result))


def _rates(result: AuditResult) -> Table:
    table = _table(
        f"{result.monitor} ({result.variant}): false alarms an epoch", ("", "value", "from", "to", "note")
    )
    for row in result.rows()[: -len(result.visibility) or None]:
        table.add_row(
            row["quantity"], *(_number(row[name], 3) for name in ("value", "low", "high")), row["note"]
        )
    return table


def _faults(result: AuditResult) -> Table:
    """One line a row of the record: the median over the onsets, and the worst in brackets."""
    wanted = list(dict.fromkeys((v.kind, v.delay_s) for v in result.visibility))
    title = f"smallest fault seen with probability {result.power:g}, median (worst) over the onsets"
    table = _table(title, ("row", *(f"{kind}, {delay:g} s" for kind, delay in wanted), "note"))
    rows: dict[str, dict[tuple[str, float], Visibility]] = {}
    for v in result.visibility:
        rows.setdefault(v.key, {})[v.kind, v.delay_s] = v
    for key, cells in rows.items():
        notes = dict.fromkeys(v.note for v in cells.values() if v.note)
        table.add_row(key, *(_size(cells[w]) for w in wanted), "; ".join(list(notes)[:1]))
    return table


def _skipped(result: AuditResult) -> list[str]:
    return [f"{n} of {result.epochs} epochs not tested: {reason}" for reason, n in result.skipped.items()]


def _size(v: Visibility) -> str:
    if not v.onsets:
        return "-"
    return f"{_number(v.median, 3)} ({_number(v.worst, 3)})" if v.median is not None else "never"


def _number(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}g}"


def _table(title: str, columns: tuple[str, ...]) -> Table:
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    for name in columns:
        table.add_column(name, overflow="fold")
    return table
