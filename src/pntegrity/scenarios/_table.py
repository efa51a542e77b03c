"""Rows of a reproduction as a table for the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.table import Table

__all__ = ["rows_table"]


def rows_table(rows: Sequence[Mapping[str, Any]], title: str) -> Table:
    """Return a rich table of rows with quantity, published, measured, ok (None: no comparison) and note."""
    from rich.table import Table

    table = Table(title=title, show_lines=False)
    for name in ("quantity", "published", "measured", "ok", "note"):
        table.add_column(name, overflow="fold")
    for row in rows:
        ok = row["ok"]
        style = {True: "green", False: "red", None: ""}[ok]
        word = {True: "yes", False: "no", None: "-"}[ok]
        cells = [row["quantity"], cell(row["published"]), cell(row["measured"]), word, row.get("note", "")]
        table.add_row(*cells, style=style)
    return table


def cell(value: Any) -> str:
    """Return a value as short text: intervals as ``216-314``, none as ``-``."""
    if value is None or value == []:
        return "-"
    if isinstance(value, Mapping):
        return ", ".join(f"{k} {cell(v)}" for k, v in value.items())
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "-".join(cell(v) for v in value)
    return f"{value:g}" if isinstance(value, float) else str(value)
