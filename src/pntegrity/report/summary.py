"""The run in numbers: a dictionary with stable keys, written as ``summary.json``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import polars as pl

from pntegrity.evaluate.whiteness import whiteness
from pntegrity.physics.time import to_iso
from pntegrity.pipeline import Outcome
from pntegrity.records import FloatArray, Update, Verdict
from pntegrity.report.columns import family_counts, groups_in
from pntegrity.report.facts import RunFacts
from pntegrity.report.inertial import inertial
from pntegrity.report.levels import only_beyond
from pntegrity.report.protection import protection
from pntegrity.report.screening import screening_numbers
from pntegrity.report.sections import by_section
from pntegrity.report.sentences import names
from pntegrity.report.sources import source_numbers
from pntegrity.report.story import absences, story
from pntegrity.report.tables import solution

__all__ = ["committed", "headline", "monitor_counts", "summary"]

STATUSES = ("ok", "alert", "unavailable")


def committed(outcomes: Sequence[Outcome]) -> list[Update]:
    """Return the updates that stood at the end: a repair replaces those of the epochs it went over."""
    out: list[Update] = []
    for o in outcomes:
        del out[len(out) - o.rewound :]
        out += o.updates
    return out


def summary(
    outcomes: Sequence[Outcome], facts: RunFacts, table: pl.DataFrame | None = None
) -> dict[str, Any]:
    """Return the run in numbers; `table` is what `solution` gives, where it is at hand.

    ============== ========================================================================================
    key            value
    ============== ========================================================================================
    version        1; grows when a key changes its meaning
    estimator      name of the estimator
    noise_model    name of the noise model
    blind_spots    what this set-up cannot see, in words
    faults         injected faults, in words
    interrupted    whether the run was stopped before its end
    started, ended GPS time of the first and last epoch, ISO format; null without epochs
    epochs         number of epochs
    duration_s     from the first to the last epoch
    availability   ``ok``, ``alert``, ``unavailable``: ``{"epochs", "share"}``
    limit_alerts   how many of the alerts are there only because a protection level is above its alert limit
    monitors       one entry a monitor: ``monitor``, ``variant``, ``p_fa`` (nominal, an epoch), ``first`` and
                   ``final`` (before and after exclusion): ``{"tests", "alarms", "rate", "worst_ratio"}``
                   (rate: alarms a test; worst_ratio: largest statistic over its threshold)
    exclusions     ``key``, ``monitor``, ``kind``, ``size``, ``from``, ``to`` (null: until the end),
                   ``onset``, ``ambiguous``, ``epochs`` (how many it was left out)
    readmissions   how many of these came back
    satellites     ``used_mean``, ``used_min``, ``systems``: ``{"G": {"mean", "min"}, ...}``; of a vehicle
                   with sources how many of these, and of each source its sensors
    position       null without truth; else ``e``, ``n``, ``u``, ``h``: ``{"rms_m", "p95_m", "max_m"}`` and
                   ``epochs``, the number of epochs compared
    sigma_m        mean standard deviation of ``e``, ``n``, ``u`` as the filter states it; null where unknown
    protection     see `pntegrity.report.protection.protection`; null where no monitor gives levels
    products       which atmosphere products were used, in words
    sections       see `pntegrity.report.sections.by_section`; null where there are no sections
    inertial       see `pntegrity.report.inertial.inertial`; null without an INS
    screening      see `pntegrity.report.screening.screening_numbers`; null where the estimator detects no
                   faults of its own
    sources        see `pntegrity.report.sources.source_numbers`; null where there are no sources with sensors
    whiteness      see `pntegrity.evaluate.whiteness.whiteness`
    notes          what the readers dropped
    events         what happened, in words
    ============== ========================================================================================
    """
    table = solution(outcomes, facts) if table is None else table
    t_ns = [o.t_ns for o in outcomes]
    gone = absences(outcomes)
    return {
        "version": 1,
        "estimator": facts.estimator,
        "noise_model": facts.noise_name,
        "blind_spots": list(facts.blind_spots),
        "faults": list(facts.faults),
        "interrupted": facts.interrupted,
        "started": to_iso(t_ns[0]) if t_ns else None,
        "ended": to_iso(t_ns[-1]) if t_ns else None,
        "epochs": len(outcomes),
        "duration_s": (t_ns[-1] - t_ns[0]) * 1e-9 if t_ns else 0.0,
        "availability": _availability(outcomes),
        "limit_alerts": sum(only_beyond(o) for o in outcomes),
        "monitors": monitor_counts(outcomes),
        "exclusions": [
            {
                "key": a.group, "monitor": a.exclusion.monitor, "kind": a.exclusion.kind,
                "size": a.exclusion.size,
                "from": to_iso(outcomes[a.start].t_ns),
                "to": to_iso(outcomes[a.stop - 1].t_ns) if a.back else None,
                "onset": to_iso(a.exclusion.onset_ns), "ambiguous": a.exclusion.ambiguous,
                "epochs": a.stop - a.start,
            }
            for a in gone
        ],
        "readmissions": sum(a.back for a in gone),
        "satellites": _satellites(outcomes),
        "position": _position({a: table[f"error_{a}_m"].to_numpy() for a in "enuh"}),
        "sigma_m": {a: table[f"sigma_{a}_m"].mean() for a in "enu"},
        "protection": protection(outcomes, table, facts),
        "products": list(facts.products),
        "sections": by_section(table, facts),
        "inertial": inertial(outcomes, table),
        "screening": screening_numbers(outcomes),
        "sources": source_numbers(outcomes, facts),
        "whiteness": whiteness(committed(outcomes)),
        "notes": list(facts.notes),
        "events": [s.text for s in story(outcomes, facts, table)],
    }  # fmt: skip


def _availability(outcomes: Sequence[Outcome]) -> dict[str, dict[str, float]]:
    counts: Counter[str] = Counter(o.status for o in outcomes)
    return {
        s: {"epochs": counts[s], "share": counts[s] / len(outcomes) if outcomes else 0.0} for s in STATUSES
    }


def monitor_counts(outcomes: Sequence[Outcome]) -> list[dict[str, Any]]:
    """Return for each monitor how often it tested and alarmed, before and after exclusion."""
    found: dict[tuple[str, str], tuple[list[Verdict], list[Verdict]]] = {}
    for o in outcomes:
        for first, last in zip(o.first, o.verdicts, strict=True):
            both = found.setdefault((last.monitor, last.variant), ([], []))
            both[0].append(first)
            both[1].append(last)
    return [
        {
            "monitor": monitor, "variant": variant, "p_fa": max((v.p_fa for v in last), default=0.0),
            "first": _counted(first), "final": _counted(last),
        }
        for (monitor, variant), (first, last) in found.items()
    ]  # fmt: skip


def _counted(verdicts: Sequence[Verdict]) -> dict[str, Any]:
    tested = [v for v in verdicts if v.status != "unavailable"]
    alarms = sum(v.status == "alert" for v in tested)
    return {
        "tests": len(tested),
        "alarms": alarms,
        "rate": alarms / len(tested) if tested else None,
        "worst_ratio": max((v.statistic / v.threshold for v in tested if v.threshold > 0.0), default=None),
    }


def _satellites(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    used = [len(groups_in(o.update.keys)) for o in outcomes]
    families = [family_counts(o.update.keys) for o in outcomes]
    counts = {s: [c[s] for c in families] for s in sorted({s for c in families for s in c})}
    return {
        "used_mean": float(np.mean(used)) if used else 0.0,
        "used_min": min(used, default=0),
        "systems": {s: {"mean": float(np.mean(n)), "min": min(n)} for s, n in counts.items()},
    }


def _position(errors: dict[str, FloatArray]) -> dict[str, Any] | None:
    known = {a: np.abs(e[np.isfinite(e)]) for a, e in errors.items()}
    if not len(known["h"]):
        return None
    out: dict[str, Any] = {
        a: {
            "rms_m": float(np.sqrt(np.mean(e**2))),
            "p95_m": float(np.quantile(e, 0.95)),
            "max_m": float(e.max()),
        }
        for a, e in known.items()
    }
    return out | {"epochs": len(known["h"])}


def headline(numbers: Mapping[str, Any]) -> tuple[str, str, str]:
    """Return the verdict on a run from its `summary`: a title, a sentence, and a tone (a status)."""
    n, share = numbers["epochs"], numbers["availability"]
    untested, alerts = share["unavailable"]["epochs"], share["alert"]["epochs"]
    gone = names([e["key"] for e in numbers["exclusions"]])
    cut = " The run was interrupted: this is what was done until then." if numbers["interrupted"] else ""
    nothing = "The monitors excluded nothing." if numbers["screening"] else "Nothing was excluded."
    left_out = f"{gone} left out for a time." if numbers["exclusions"] else nothing
    left_out += _screened(numbers)
    if not n:
        return "No epoch was processed", f"There is nothing to judge.{cut}", "unavailable"
    misled = _misled(numbers)
    if misled:
        return f"Misleading at {misled} of {n} epochs", f"{_beyond(numbers)}{cut}", "alert"
    if alerts:
        detail = f"{_alarmed(numbers)} {left_out}{_also(untested)}{cut}"
        return f"Do not trust {alerts} of {n} epochs", detail, "alert"
    if untested == n:
        return (
            "No integrity test was possible",
            f"None of {n} epochs could be tested, so none is called OK.{cut}",
            "unavailable",
        )
    if untested:
        return (
            f"No alarm remained, but {untested} of {n} epochs could not be tested",
            f"{left_out}{cut}",
            "unavailable",
        )
    if numbers["exclusions"]:
        detail = f"{left_out} After that no monitor alarmed at any of {n} epochs.{cut}"
        return "Every alarm was resolved by exclusion", detail, "ok"
    return (
        f"No alarm in {n} epoch{'s' * (n != 1)}",
        f"Every epoch was tested by at least one monitor. {left_out}{cut}",
        "ok",
    )


def _alarmed(numbers: Mapping[str, Any]) -> str:
    """Return why there were alerts: alarms that stayed, levels above their alert limits, or both."""
    alerts, limit = numbers["availability"]["alert"]["epochs"], numbers["limit_alerts"]
    stayed = "No exclusion could resolve the alarms there."
    what = stayed if numbers["exclusions"] else "Monitors alarmed there."
    if not limit:
        return what
    if limit == alerts:
        return "The protection level is above its alert limit there."
    return f"{what} The protection level is above its alert limit at {limit} of them."


def _screened(numbers: Mapping[str, Any]) -> str:
    """Return what the estimator left out before any monitor looked."""
    s = numbers["screening"]
    if s is None:
        return ""
    d = s["dropped"]
    if not d["rows"]:
        return " The estimator's own fault detection, before them, left out no row."
    row = "row" if d["rows"] == 1 else "rows"
    return (
        f" Before them, the estimator's own fault detection left out {d['rows']} {row} at {d['epochs']} of "
        f"{s['epochs']} epochs."
    )


def _misled(numbers: Mapping[str, Any]) -> int:
    """Return at how many epochs the error was beyond its protection level without an alert."""
    p = numbers["protection"]
    return p["misleading"]["epochs"] if p and p["misleading"] else 0


def _beyond(numbers: Mapping[str, Any]) -> str:
    hazardous, alerts = numbers["protection"]["misleading"]["hazardous"], numbers["availability"]["alert"]
    limit = f" At {hazardous} of them it was beyond the alert limit too." if hazardous else ""
    others = f" Alerts stand at {alerts['epochs']} other epochs." if alerts["epochs"] else ""
    return f"The error was beyond its protection level there, and no alert was given.{limit}{others}"


def _also(untested: int) -> str:
    return f" {untested} epoch{'s' * (untested != 1)} could not be tested." if untested else ""
