"""Tests of updates. One monitor a module; each sees records and kernels only.

A module of this folder that holds a class with a `name`, `start` and `step` is a monitor: nothing else lists
it.
"""

from __future__ import annotations

import importlib
import pkgutil
from functools import lru_cache
from typing import Any

__all__ = ["discover"]


@lru_cache(maxsize=1)
def discover() -> dict[str, type[Any]]:
    """Return every monitor class of this folder by its name."""
    found = {}
    for module in pkgutil.iter_modules(__path__):
        if module.name.startswith("_"):
            continue
        loaded = importlib.import_module(f"{__name__}.{module.name}")
        for value in vars(loaded).values():
            if isinstance(value, type) and value.__module__ == loaded.__name__ and hasattr(value, "step"):
                monitor: type[Any] = value
                found[monitor.name] = monitor
    return found
