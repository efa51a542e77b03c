"""Integrity monitoring for every estimator that navigates.

The front door for a filter that you already have: hand each of its steps over as an `Update`, and `Watch` it
with any monitors. Names are imported when they are first used, so that ``import pntegrity`` costs nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pntegrity.bounds.ism import Ism
    from pntegrity.monitors.aime import Aime
    from pntegrity.monitors.factor_set import FactorSetTest
    from pntegrity.monitors.glr import Glr
    from pntegrity.monitors.rctm import Rctm
    from pntegrity.monitors.sensor_window import SensorWindow
    from pntegrity.monitors.separation import Separation
    from pntegrity.monitors.source_separation import SourceSeparation
    from pntegrity.monitors.sraime import Sraime
    from pntegrity.monitors.srctm import Srctm
    from pntegrity.pipeline import Pipeline
    from pntegrity.records import Update, Verdict
    from pntegrity.watch import Watch

__version__ = "0.5.0"
__all__ = [
    "Aime", "FactorSetTest", "Glr", "Ism", "Pipeline", "Rctm", "SensorWindow", "Separation",
    "SourceSeparation", "Sraime", "Srctm", "Update", "Verdict", "Watch", "__version__",
]  # fmt: skip

_HOME = {
    "Aime": "monitors.aime",
    "FactorSetTest": "monitors.factor_set",
    "Glr": "monitors.glr",
    "Ism": "bounds.ism",
    "Pipeline": "pipeline",
    "Rctm": "monitors.rctm",
    "SensorWindow": "monitors.sensor_window",
    "Separation": "monitors.separation",
    "SourceSeparation": "monitors.source_separation",
    "Sraime": "monitors.sraime",
    "Srctm": "monitors.srctm",
    "Update": "records",
    "Verdict": "records",
    "Watch": "watch",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
