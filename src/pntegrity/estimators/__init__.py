"""From epochs to updates. One estimator a module.

A module of this folder that holds a class with `predict` and `correct` is an estimator of the module's name:
nothing else lists it.
"""

from __future__ import annotations

from typing import Any

from pntegrity.discovery import classes_with

__all__ = ["discover"]


def discover() -> dict[str, type[Any]]:
    """Return every estimator class of this folder by the name of its module."""
    return classes_with(__name__, "correct")
