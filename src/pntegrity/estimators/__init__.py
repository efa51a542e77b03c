"""From epochs to updates. One estimator a module.

A module of this folder that holds a class with `predict` and `correct` is an estimator of the module's name:
nothing else lists it.
"""

from __future__ import annotations

import importlib
import pkgutil
from functools import lru_cache
from typing import Any

__all__ = ["discover"]


@lru_cache(maxsize=1)
def discover() -> dict[str, type[Any]]:
    """Return every estimator class of this folder by the name of its module."""
    found = {}
    for module in pkgutil.iter_modules(__path__):
        if module.name.startswith("_"):
            continue
        loaded = importlib.import_module(f"{__name__}.{module.name}")
        for value in vars(loaded).values():
            if isinstance(value, type) and value.__module__ == loaded.__name__ and hasattr(value, "correct"):
                found[module.name] = value
    return found
