"""Parts of the report page for runs with an INS or with fault detection before the filter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pntegrity.report.cards import Figures, escaped, plot, section, table_of
from pntegrity.report.sections import HOW
from pntegrity.report.units import degrees, length, level_text, percent, rounded, unit

__all__ = ["attitude_part", "cards", "screening_part", "sections_part", "track_part"]

SATELLITES = 12
"""How many satellites the table of dropped rows shows."""
_MAP = (
    "Metres east and north of the first point, the same scale both ways; no map is loaded. Point at the "
    "track for time, status and protection level, drag to zoom, double-click to go back."
)
_DETECTION = (
    "What the estimator's own fault detection did with the rows of each epoch before the filter used them. "
    "Shaded orange: the epoch was not used."
)
_ATTITUDE = "As the filter states it, within its three-sigma band."
_ATTITUDE_ERROR = "Error against the true attitude within the filter's own three-sigma band."


def cards(numbers: Mapping[str, Any]) -> list[Figures]:
    """Return figures of the page's head: label, value, unit, note."""
    out: list[Figures] = []
    s, ins = numbers["screening"], numbers["inertial"]
    if s is not None:
        d = s["dropped"]
        rates = f"; {d['rates']} of them range rates" if d["rates"] else ""
        note = f"at {d['epochs']} of {s['epochs']} epochs, of {len(d['satellites'])} satellites{rates}"
        out.append(("Dropped before the filter", str(d["rows"]), "rows" if d["rows"] != 1 else "row", note))
    if ins is not None:
        out += [
            _heading(ins),
            _longest(ins["outages"], "GNSS" if numbers["sources"] is None else "any source"),
        ]
    return out


def _heading(ins: Mapping[str, Any]) -> Figures:
    sigma, error = ins["attitude_sigma_deg"], ins["attitude_error_deg"]
    said = {a: degrees(value) for a, value in sigma.items()}
    tilt = f"roll {said['roll']}, pitch {said['pitch']}"
    if error is None:
        note = f"median, as the filter states it; {tilt}"
        return "Heading sigma", said["heading"].rstrip("°"), "°", note
    value = degrees(error["heading"]["rms"]).rstrip("°")
    return "Heading error, RMS", value, "°", f"sigma {said['heading']}; sigma of {tilt}"


def _longest(found: Mapping[str, Any] | None, what: str) -> Figures:
    if found is None:
        return (
            f"Longest without {what}",
            "0",
            "s",
            "GNSS updated the filter without a break" if what == "GNSS" else "there was always one",
        )
    worst = found["longest"]
    return f"Longest without {what}", f"{worst['seconds']:.4g}", "s", grown(worst)


def grown(worst: Mapping[str, Any]) -> str:
    """Say how far the uncertainty of the position grew in a stretch without GNSS."""
    if worst["sigma_from_m"] is None or worst["sigma_to_m"] is None:
        return "the uncertainty of the position is not known"
    return f"horizontal sigma grew from {length(worst['sigma_from_m'])} to {length(worst['sigma_to_m'])}"


# --- sections of the page ---------------------------------------------------------------------------------


def track_part(there: set[str]) -> str:
    """Return the map."""
    return section("Map", plot("track", _MAP), "track" in there)


def attitude_part(there: set[str]) -> str:
    """Return attitude, and its error where the truth is known."""
    error = f"<h3>Error</h3>{plot('attitude-error', _ATTITUDE_ERROR)}" if "attitude-error" in there else ""
    return section("Attitude", plot("attitude", _ATTITUDE) + error, "attitude" in there)


def sections_part(numbers: Mapping[str, Any]) -> str:
    """Return the errors by section, and where the sections come from."""
    found = numbers["sections"]
    if found is None:
        return ""
    told = [r for r in found["rows"] if r["epochs"]]
    known = [(t, k, u) for t, k, u in _ERRORS if any(r[k] is not None for r in told)]
    titles = [
        "Section",
        "Epochs",
        "With GNSS",
        *(t for t, _, _ in known),
        *_SIGMA[bool(known) :],
        "HPL, median",
    ]
    rows = [_section_row(r, known) for r in told]
    how = HOW if found["source"] == "derived" else "The sections are those that the run was given."
    note = (
        " Errors are given as mean / RMS / largest."
        if known
        else " No truth was given, so errors are not known."
    )
    text = f"<p class='quiet'>{escaped(how + note)}</p>"
    return section("Errors by section" if known else "By section", table_of(titles, rows, "white") + text)


_ERRORS = (
    ("Horizontal", "horizontal_m", ""),
    ("3-D", "spatial_m", ""),
    ("Velocity", "velocity_mps", "/s"),
    ("Heading", "heading_deg", "°"),
)
"""Errors of the table: title, key, what follows the unit (``"°"``: an angle)."""


_SIGMA = ("Horizontal sigma, median",)
"""What stands for them where no error is known."""


def _section_row(r: Mapping[str, Any], known: Sequence[tuple[str, str, str]]) -> list[str]:
    return [
        r["section"].capitalize(), f"{r['epochs']} ({percent(r['share'])} %)", f"{percent(r['used'])} %",
        *(_three(r[key], per) for _, key, per in known),
        *(["–" if r["sigma_m"] is None else length(r["sigma_m"])] * (not known)),
        level_text(r["hpl_m"]) if r["has_hpl"] else "–",
    ]  # fmt: skip


def _three(found: Mapping[str, float] | None, per: str) -> str:
    """Return mean, RMS and maximum with one unit."""
    if found is None:
        return "–"
    values = [found[k] for k in ("mean", "rms", "max")]
    if per == "°":
        return " / ".join(degrees(v).rstrip("°") for v in values) + "°"
    factor, name = unit(found["rms"])
    return f"{' / '.join(rounded(factor * v, name) for v in values)} {name}{per}"


def screening_part(numbers: Mapping[str, Any], there: set[str]) -> str:
    """Return what the estimator's own fault detection did."""
    s = numbers["screening"]
    if s is None:
        return ""
    inside = plot("screening", _DETECTION) + f"<p class='quiet'>{escaped(' '.join(_about(s)))}</p>"
    return section("Fault detection before the filter", inside + _satellites(s), "screening" in there)


def _about(s: Mapping[str, Any]) -> list[str]:
    """Return sentences: which detection, what it left out, how much it tested, what its checks said."""
    d, tests, araim = s["dropped"], s["tests"], s["araim_tests"]
    said = [
        f"Method {s['method']}, {s['variant']}. {d['rows'] - d['rates']} pseudoranges and {d['rates']} range "
        f"rates dropped at {d['epochs']} of {s['epochs']} epochs.",
        f"At most {tests['max']} sets of rows tested at an epoch, {tests['median']:g} in the median; "
        f"ARAIM for up to three faults among as many satellites: {araim['max']}, median {araim['median']:g}.",
        _pairs("Satellites, mean", s["satellites"]), _pairs("PDOP, median", s["pdop"]),
    ]  # fmt: skip
    for key, name in (("missed", "missed-detection"), ("false_alarm", "false-alarm")):
        if s[key]["checked"]:
            said.append(f"The {name} check failed at {s[key]['failed']} of {s[key]['checked']} epochs.")
    unused = s["epochs"] - s["used"]["epochs"]
    why = "; ".join(f"{r} ({n})" for r, n in list(s["reasons"].items())[:3])
    return [*said, f"Not used at {unused} epochs: {why}."] if unused else said


def _pairs(words: str, pair: Mapping[str, float | None]) -> str:
    before, after = ("infinite" if v is None else f"{v:.1f}" for v in (pair["before"], pair["after"]))
    return f"{words}: {before} before, {after} after."


def _satellites(s: Mapping[str, Any]) -> str:
    found = s["dropped"]["satellites"]
    if not found:
        return ""
    rows = [
        [
            r["satellite"], str(r["rows"] - r["rates"]), str(r["rates"]),
            f"{r['epochs']} ({percent(r['share'])} %)", *map(str, r["iterations"]),
        ]
        for r in found[:SATELLITES]
    ]  # fmt: skip
    rest = len(found) - len(rows)
    more = (
        f"<p class='quiet'>{rest} other satellites less often; every row is in screening_dropped.csv.</p>"
        if rest
        else ""
    )
    titles = (
        "Dropped", "Pseudoranges", "Range rates", "Epochs (of those in view)", "1st iteration", "2nd",
        "Later",
    )  # fmt: skip
    return table_of(titles, rows, "white") + more
