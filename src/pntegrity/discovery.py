"""Finding what a folder holds: a class in a module of its own is there by being there."""

from __future__ import annotations

import importlib
import pkgutil
from functools import lru_cache
from typing import Any

__all__ = ["classes_with"]


@lru_cache(maxsize=8)
def classes_with(package: str, method: str) -> dict[str, type[Any]]:
    """Return the class with a method in each public module of a package, by the name of the module.

    Parameters
    ----------
    package : str
        Dotted name of the package.
    method : str
        What the class must have.
    """
    found: dict[str, type[Any]] = {}
    for module in pkgutil.iter_modules(importlib.import_module(package).__path__):
        if not module.name.startswith("_"):
            loaded = importlib.import_module(f"{package}.{module.name}")
            for value in vars(loaded).values():
                if isinstance(value, type) and value.__module__ == loaded.__name__ and hasattr(value, method):
                    found[module.name] = value
    return found
