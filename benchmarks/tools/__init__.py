"""Other tools behind one face: read, fix a position, fix it with fault exclusion.

A tool says in `given` what it is handed from elsewhere, and in `absent` why it cannot run, where it cannot.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from pntegrity.records import FloatArray

__all__ = ["Fix", "Tool"]


@dataclass(frozen=True, eq=False)
class Fix:
    """A position, or none, and who was left out of it."""

    position_m: FloatArray | None
    excluded: tuple[str, ...] = ()
    said: str = ""


class Tool(Protocol):
    """A tool on one log. `prepare` makes what a call needs; only the call after it is timed."""

    name: str
    version: str
    given: str

    def read_observations(self) -> int:
        """Read the observation file; return how many epochs were read."""
        ...

    def read_navigation(self) -> object:
        """Read the navigation file."""
        ...

    def prepare(self, k: int, faulted: bool) -> object:
        """Return the input of epoch `k`."""
        ...

    def states(self, prepared: object) -> object:
        """Compute satellite positions and clocks of an epoch alone."""
        ...

    def fix(self, prepared: object) -> Fix:
        """Return the position without a test."""
        ...

    def fix_excluding(self, prepared: object) -> Fix:
        """Return the position after fault detection and exclusion."""
        ...
