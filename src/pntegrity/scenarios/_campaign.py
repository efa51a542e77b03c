"""What an evidence campaign is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from pntegrity.scenarios._real_logs import Row

__all__ = ["Campaign", "from_module"]


@dataclass(frozen=True)
class Campaign:
    """One campaign.

    Parameters
    ----------
    name, title, text : str
        For the command line, the page's heading, and what was done.
    run : callable
        Data folder -> rows.
    real : bool
        Whether it needs the data folder.
    """

    name: str
    title: str
    text: str
    run: Callable[[Path], Sequence[Row]]
    real: bool = True


def from_module(module: str, function: str) -> Callable[[Path], Sequence[Row]]:
    """Return a campaign of a module of this folder, imported when it runs."""

    def run(data: Path) -> Sequence[Row]:
        found = import_module(f"pntegrity.scenarios.{module}")
        rows: Sequence[Row] = getattr(found, function)(data)
        return rows

    return run
