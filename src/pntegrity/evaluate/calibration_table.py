"""A calibration as a table, and as facts for the noise file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pntegrity.evaluate.calibrate import Calibration

if TYPE_CHECKING:
    from rich.console import Group

__all__ = ["calibration_facts", "calibration_table"]


def calibration_facts(result: Calibration) -> dict[str, Any]:
    """Return what the noise file tells of how it was found."""
    return {
        "training_epochs": result.training,
        "validation_epochs": result.validation,
        "log_likelihood_gain_per_epoch": round(result.gain, 3),
        "validation_alarms": result.alarms,
        "validation_whiteness": result.whiteness,
    }


def calibration_table(result: Calibration) -> Group:
    """Return fitted parameters, whiteness before and after, and alarms on the validation part."""
    from rich.console import Group
    from rich.table import Table

    head = f"fitted on {result.training} epochs, judged on the next {result.validation}"
    fitted = Table("parameter", "value", title=head, box=None, pad_edge=False, title_justify="left")
    for name in type(result.noise).__dataclass_fields__:
        value = getattr(result.noise, name)
        if isinstance(value, float):
            fitted.add_row(name, f"{value:.4g}")
    lags = (f"lag {lag:g} s" for lag in _lags_s(result))
    white = Table("innovations", "model", *lags, "mean square", box=None, pad_edge=False)
    for kind in _kinds(result):
        for model, numbers in result.whiteness.items():
            white.add_row(kind, model, *(_cell(c) for c in _row(numbers[kind])))
    alarms = Table(
        "monitor", "threshold factor", *(f"alarms at {p}" for p in _levels(result)), box=None, pad_edge=False
    )
    for name, counts in result.alarms.items():
        alarms.add_row(name, f"{result.noise.factor(name):.2f}", *(str(n) for n in counts.values()))
    return Group(fitted, "", white, "", alarms)


def _lags_s(result: Calibration) -> list[float]:
    return list(next(iter(result.whiteness.values()))["lags_s"])


def _kinds(result: Calibration) -> list[str]:
    """Return the kinds of level rows that there are innovations of."""
    return [k for k in ("code", "carrier") if any(w[k]["count"] for w in result.whiteness.values())]


def _row(numbers: dict[str, Any]) -> list[float | None]:
    return [*numbers["autocorrelation"], numbers["mean_square"]]


def _levels(result: Calibration) -> list[str]:
    return list(next(iter(result.alarms.values()), {}))


def _cell(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"
