"""Parts of the report page that tell of protection levels: the head's figure, tables, what is promised."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from pntegrity.report.cards import escaped, flat, table_of
from pntegrity.report.facts import RunFacts
from pntegrity.report.sentences import names
from pntegrity.report.units import duration, length, level_text, percent

__all__ = ["card", "level_table", "mode_table", "product_list", "promise", "region_table"]

MODES = 12
"""How many fault modes the table shows."""
Row = tuple[str, str, str]


def card(numbers: Mapping[str, Any]) -> tuple[str, str, str, str]:
    """Return the figure of the page's head: label, value, unit, note."""
    p = numbers["protection"]
    value, _, unit = level_text(p["hpl_m"]["p95"]).partition(" ")
    note = (
        f"horizontal; median {level_text(p['hpl_m']['median'])}; up 95\u00a0% {level_text(p['vpl_m']['p95'])}"
    )
    if p["available"]:
        note += f"; within alert limits {percent(p['available']['share'])} %"
    return "Protection level, 95\u00a0%", value, unit, note


def level_table(numbers: Mapping[str, Any]) -> str:
    """Return how large the levels are, and how near to what they could be at best, as far as it is known."""
    p = numbers["protection"]
    ways = (("Horizontal", "hpl_m", "h"), ("Vertical", "vpl_m", "v"))
    more = (("Along track", "along_m", ""), ("Across track", "cross_m", ""))
    limits = {"hpl_m": p["hal_m"], "vpl_m": p["val_m"]}
    rows = [
        (
            name, level_text(p[key]["median"]), level_text(p[key]["p95"]),
            length(limits[key]) if limits.get(key) else "–",
            _times(p["over_sigma"].get(short)), _times(p["over_smallest"].get(short)),
        )
        for name, key, short in ways + more
        if p[key]
    ]  # fmt: skip
    titles = ("Level", "Median", "95 %", "Alert limit", "Times sigma", "Times the smallest possible")
    told = [i for i in range(len(titles)) if any(row[i] != "–" for row in rows)]
    shown = [tuple(row[i] for i in told) for row in rows]
    table = table_of(tuple(titles[i] for i in told), shown, "white")
    return table + f"<p class='quiet'>{escaped(' '.join(_about(p, numbers)))}</p>"


def _times(ratio: float | None) -> str:
    return "–" if ratio is None else f"{ratio:.2f}"


def _about(p: Mapping[str, Any], numbers: Mapping[str, Any]) -> list[str]:
    """Return sentences: availability, where there is no level, how many modes."""
    said = []
    if p["available"]:
        epochs, share = p["available"]["epochs"], percent(p["available"]["share"])
        of = f"{epochs} of {numbers['epochs']} epochs ({share} %)"
        said.append(f"Status ok and levels within the alert limits at {of}.")
    else:
        said.append("No alert limits were given, so nothing is said of availability.")
    for key, what in (("unbounded", "No finite level"), ("without", "No level at all")):
        if p[key]["epochs"]:
            why = "; ".join(f"{r} ({n})" for r, n in list(p[key]["reasons"].items())[:3])
            said.append(f"{what} at {p[key]['epochs']} epochs: {why}.")
    if p["monitored"]:
        said.append(f"Up to {p['monitored']} fault modes were monitored at an epoch.")
    return said


def region_table(numbers: Mapping[str, Any]) -> str:
    """Return how many epochs are in each region of the Stanford diagram."""
    m = numbers["protection"]["misleading"]
    words = (
        ("normal", "Normal operation: error within the level"),
        ("misleading", "Misleading: error beyond the level"),
        ("hazardous", "Hazardously misleading: error beyond the alert limit, level within it"),
        ("unavailable", "Unavailable: level beyond the alert limit, unbounded or none"),
        ("unavailable_misleading", "Unavailable, and error beyond the level"),
        ("alerted", "An alert was given"),
        ("unknown", "True error not known"),
    )
    rows = [(text, str(m["horizontal"][key]), str(m["vertical"][key])) for key, text in words]
    kept = [r for r, (key, _) in zip(rows, words, strict=True) if key not in ("alerted", "unknown") or any(
        m[a][key] for a in ("horizontal", "vertical")
    )]  # fmt: skip
    return table_of(("Epochs", "Horizontal", "Vertical"), kept, "white regions")


def mode_table(numbers: Mapping[str, Any]) -> str:
    """Return at how many epochs each fault mode sets the level."""
    p = numbers["protection"]
    rows = [
        (m["mode"], *(f"{100.0 * m[way] / p['epochs']:.1f} %" for way in ("east", "north", "up")))
        for m in p["modes"][:MODES]
    ]
    rest = len(p["modes"]) - len(rows)
    more = f" {rest} other modes dominate less often." if rest > 0 else ""
    note = "Share of epochs at which a fault mode contributes most to the risk of that direction."
    return f"<p class='quiet'>{note}{more}</p>" + table_of(("Mode", "East", "North", "Up"), rows, "white")


def product_list(facts: RunFacts) -> str:
    """Return which atmosphere products were used."""
    items = "".join(f"<li>{escaped(line)}</li>" for line in facts.products)
    return f"<ul class='spots'>{items}</ul>"


# --- what the levels promise ------------------------------------------------------------------------------


def promise(numbers: Mapping[str, Any], facts: RunFacts) -> str:
    """Return the risk budget with each probability, and what the levels assume."""
    claim, told = _claim(facts.protection), dict(facts.protection)
    if numbers["sources"] is not None:
        told = {k: v for k, v in told.items() if k not in FAULTS or k == "p_other"}
    rows = [*_budget(told, numbers["protection"]), *_faults(told), *_rest(told)]
    if not rows:
        return "<p class='quiet'>The probabilities behind the levels were not stated.</p>"
    return f"<p>{escaped(claim)}</p>{table_of(('', '', ''), rows, 'promise')}{_assumed(facts.protection)}"


def _claim(told: Mapping[str, Any]) -> str:
    risk, epochs = _number(told, "p_hmi"), _number(told, "independent_epochs")
    what = "The position error is beyond a level without an alert with a probability of at most"
    if risk is None:
        return f"{what} the integrity risk."
    time = duration(float(told["exposure_s"])) if "exposure_s" in told else "the exposure time"
    if epochs is None or epochs == 1.0:
        return f"{what} {risk:.3g} an epoch."
    each = f"{risk / epochs:.2g} at each"
    return f"{what} {risk:.3g} in {time}, which counts as {epochs:g} independent epochs: {each}."


def _number(told: Mapping[str, Any], name: str) -> float | None:
    """Return a number, taken off the table; None where it is not told."""
    value = told.get(name)
    return None if value is None else float(value)


def _budget(told: dict[str, Any], p: Mapping[str, Any]) -> list[Row]:
    """Return the rows of the risk and its shares; what they hold leaves `told`."""
    risk, epochs = _number(told, "p_hmi"), _number(told, "independent_epochs") or 1.0
    rows: list[Row] = []
    if risk is not None:
        rows.append(("Integrity risk", f"{risk:.3g}", "error beyond a level and no alert"))
        share = told.get("unmonitored_share")
        limit = f"; at most {float(share) * risk:.2g} allowed" if share is not None else ""
        rows.append(
            ("of it, modes not monitored", f"{p['unmonitored'] or 0.0:.2g}", f"largest of all epochs{limit}")
        )
    if risk is not None and "split" in told:
        shares = [float(s) * risk / epochs for s in told["split"]]
        rows.append(_three("an epoch east, north, up", shares, "before what is not monitored comes off"))
    rate = _number(told, "p_fa")
    if rate is not None:
        rows.append(("False alerts, an epoch", f"{rate:.3g}", _per_hour(p)))
    if rate is not None and "fa_split" in told:
        rows.append(_three("of them east, north, up", [float(s) * rate for s in told["fa_split"]], ""))
    for name in ("p_hmi", "split", "p_fa", "fa_split", "unmonitored_share", "independent_epochs"):
        told.pop(name, None)
    return rows


def _three(name: str, values: Sequence[float], note: str) -> Row:
    return name, ", ".join(f"{v:.2g}" for v in values), note


def _per_hour(p: Mapping[str, Any]) -> str:
    most = p["false_alerts_per_hour"]
    rate = f": at most {most:.2g} an hour" if most is not None else ""
    return f"by chance, without a fault{rate}"


FAULTS = {
    "p_sat": ("A satellite: orbit, clock", ""),
    "p_dcb": ("its code biases", "added for each satellite"),
    "p_iono_sat": ("its ionosphere product", "added for each satellite that has one"),
    "p_user": ("reflected signals, unseen slips", "added for each satellite"),
    "p_constellation": ("A whole constellation", "all its satellites at once"),
    "p_sector": ("An azimuth sector", "all its satellites at once"),
    "p_trop": ("The troposphere product", ""),
    "p_iono": ("All ionosphere products", "at once"),
    "p_other": ("Any other source", ""),
}
"""Fault probabilities of the integrity support message in words."""


def _faults(told: dict[str, Any]) -> list[Row]:
    """Return the rows of the fault probabilities."""
    if not told.get("sectors"):
        for name in ("sectors", "sector_width_deg", "p_sector"):
            told.pop(name, None)
    rows = [(words, f"{float(told.pop(k)):.3g}", note) for k, (words, note) in FAULTS.items() if k in told]
    for one in told.pop("together", None) or ():
        rows.append((one["name"], f"{float(one['probability']):.3g}", f"{names(one['groups'])} at once"))
    for name, p in dict(told.pop("satellites", None) or {}).items():
        rows.append((f"{name} alone", f"{float(p):.3g}", "in place of the sum above"))
    for name, p in dict(told.pop("sources", None) or {}).items():
        rows.append(
            (name, f"{float(p):.3g}", "a sensor by itself" if "." in name else "in place of the above")
        )
    for letter, own in dict(told.pop("constellations", None) or {}).items():
        text = ", ".join(f"{float(v):.3g}" for v in own.values())
        rows.append((f"Constellation {letter}", text, "a satellite, all at once"))
    return rows


REST = {
    "levels": ("Levels are", ""),
    "sectors": ("Azimuth sectors", ""),
    "sector_width_deg": ("Width of a sector, degrees", ""),
    "b_code_m": ("Nominal bias of code", "m"),
    "b_carrier_m": ("Nominal bias of carrier", "m"),
    "b_product_m": ("Nominal bias of products", "m"),
    "hal_m": ("Horizontal alert limit", "m"),
    "val_m": ("Vertical alert limit", "m"),
    "exposure_s": ("Exposure time", "s"),
    "max_modes": ("No more fault modes than", ""),
    "p_emt": ("Fault modes count for the monitor threshold from", ""),
}
"""The other fields in words, with their units."""


def _rest(told: Mapping[str, Any]) -> list[Row]:
    """Return the rows of all other fields; those without words of their own under their names."""
    rows = []
    for key, text in flat(told):
        words, unit = REST.get(key, (key, ""))
        value = told.get(key)
        if unit == "m" and isinstance(value, (int, float)):
            text = "none" if not math.isfinite(value) else length(value) if value else "0 m"
        elif unit == "s" and isinstance(value, (int, float)):
            text = duration(value)
        if text not in ("{}", "[]"):
            rows.append((words, text, ""))
    return rows


HEEDED = "Whoever uses the position heeds the alerts: an epoch with an alert promises nothing."
OBSERVED = "Levels grow with what the hypotheses are seen to disagree by, so they need no alert."


def _assumed(told: Mapping[str, Any]) -> str:
    """Return what must be true for the levels to hold."""
    time = duration(float(told["exposure_s"])) if "exposure_s" in told else "the exposure time"
    said = (
        f"A fault probability is that of its presence at some time within {time}; faults of different "
        "sources come independently. The true rates are at most these.",
        "Without a fault the errors are normal, at least as well known as the noise model says, sigmas and "
        "correlation times alike; nominal biases are at most those above.",
        "A fault may have any size and course, from the epoch on at which the monitor began; older ones are "
        "not covered.",
        OBSERVED if told.get("levels") == "observed" else HEEDED,
    )
    items = "".join(f"<li>{escaped(s)}</li>" for s in said)
    return f"<h3>What this assumes</h3><ul class='spots'>{items}</ul>"
