"""A calibration as a table, and as facts for the noise file."""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING, Any

from pntegrity.evaluate.calibrate import Calibration
from pntegrity.evaluate.calibrate_sources import Judged, Sigma, SourceCalibration

if TYPE_CHECKING:
    from rich.console import Group
    from rich.table import Table

__all__ = ["calibration_facts", "calibration_table", "source_facts", "source_table"]


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


def source_facts(result: SourceCalibration) -> dict[str, Any]:
    """Return what the noise file of a vehicle tells of how it was found."""
    numbers = ("given", "likely", "error", "lasting", "fitted", "ratio_given", "ratio_fitted")
    return {
        "training_epochs": result.training,
        "validation_epochs": result.validation,
        "log_likelihood_gain_per_epoch": round(result.gain, 3),
        "training_left_out": result.left_out,
        "validation_given": _judged_facts(result.given),
        "validation_fitted": _judged_facts(result.fitted),
        "sigma": {
            f"{s.source}.{s.field}": {
                n: float(f"{x:.4g}") for n in numbers for x in [getattr(s, n)] if isfinite(x)
            }
            | ({"reason": s.reason} if s.reason else {})
            for s in result.sigmas
        },
    }


def _judged_facts(judged: Judged) -> dict[str, Any]:
    return {"alarms": judged.alarms, "left_out": judged.left_out, "whiteness": judged.whiteness}


def source_table(result: SourceCalibration) -> Group:
    """Return the sigmas of a vehicle, innovations by source before and after, and alarms on the validation
    part.
    """
    from rich.console import Group
    from rich.table import Table

    def table(*columns: str, title: str | None = None) -> Table:
        return Table(*columns, title=title, box=None, pad_edge=False, title_justify="left")

    head = f"fitted on {result.training} epochs, judged on the next {result.validation}"
    left = ", ".join(f"{name} {n}" for name, n in result.left_out.items())
    head += f"; left out of the first, epochs: {left}" if left else ""
    columns = ("given", "likely", "+-", "lasting", "fitted", "ratio:\ngiven, fitted")
    sizes = table("source", "key", *columns, title=head)
    sizes.columns[1].no_wrap = True
    for s in result.sigmas:
        sizes.add_row(*_sigma_cells(s))
    what = "innovations on these, correlated after so many intervals of the source"
    white = table("source", "sigmas", "1", "5", "30", "mean square", "left out, epochs", title=what)
    alarms = table("monitor", "alarms, given", "fitted")
    for source in dict.fromkeys(s.source for s in result.sigmas):
        for name, judged in (("given", result.given), ("fitted", result.fitted)):
            if source in judged.whiteness:
                out = sum(n for who, n in judged.left_out.items() if who.partition(".")[0] == source)
                white.add_row(source, name, *(_cell(c) for c in _row(judged.whiteness[source])), str(out))
    for monitor, n in result.given.alarms.items():
        alarms.add_row(monitor, str(n), str(result.fitted.alarms[monitor]))
    notes = [f"{s.source} {s.field} stays: {s.reason}" for s in result.sigmas if s.reason]
    notes += [f"{s.source} {s.field}: {s.caution}" for s in result.sigmas if s.caution]
    return Group(sizes, "", white, "", alarms, *(["", *notes] if notes else []))


def _sigma_cells(s: Sigma) -> list[str]:
    error = f"{100.0 * s.error:.0f} %" if isfinite(s.error) else ""
    found = (
        ["stays", "", "", ""]
        if s.reason
        else [f"{s.likely:.3g}", error, f"{s.lasting:.2f}", f"{s.fitted:.3g}"]
    )
    ratios = (f"{r:.2f}" if isfinite(r) else "-" for r in (s.ratio_given, s.ratio_fitted))
    return [s.source, s.field, f"{s.given:.3g}", *found, ", ".join(ratios)]
