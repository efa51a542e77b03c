"""Tests of updates. One monitor a module; each sees records and kernels only.

A module of this folder that holds a class with a `name`, `start` and `step` is a monitor: nothing else lists
it.
"""

from __future__ import annotations

from typing import Any

from pntegrity.discovery import classes_with

__all__ = ["discover"]


def discover() -> dict[str, type[Any]]:
    """Return every monitor class of this folder by its name."""
    return {monitor.name: monitor for monitor in classes_with(__name__, "step").values()}
