"""Campaigns on other receivers, whose noise nobody fitted, and the speed of the whole job."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pntegrity.errors import InputError
from pntegrity.estimators.spp_kf import SppKf
from pntegrity.evaluate.calibrate import updates_of
from pntegrity.evaluate.intervals import binomial_interval
from pntegrity.exclusion import Policy
from pntegrity.pipeline import Outcome, Pipeline
from pntegrity.scenarios._real_logs import BRUX, CLAS, TST, WALK, Log, Row, Site, monitors, rms, row, skipped
from pntegrity.scenarios.evidence_real import P_FA, ratios, site_of
from pntegrity.sensors.noise import NoiseModel

__all__ = ["receivers", "speed"]

#: What each log is, in words.
RECEIVERS: dict[str, Log] = {
    "static CORS, mosaic-X5": CLAS,
    "hand-held walk, low-cost multi-frequency": WALK,
    "vehicle in a deep urban canyon, low-cost single-frequency": TST,
}
LIMIT_S = 4.0
RUN = "import sys; from pntegrity.cli import main; sys.argv[0] = 'pntegrity'; main()"


def receivers(data: Path) -> list[Row]:
    """Return alarm rates, exclusions and positions of other receivers, with the defaults and with a fit to
    their first half.

    Parameters
    ----------
    data : Path
        Folder that holds the folders of the logs.
    """
    rows = []
    for words, log in RECEIVERS.items():
        missing = log.missing(data)
        rows += (
            skipped("receivers", f"{words}: {missing}") if missing else _receiver(words, site_of(data, log))
        )
    return rows


def _receiver(words: str, site: Site) -> list[Row]:
    models = {"default": NoiseModel()}
    rows = []
    try:
        models["calibrated"] = site.noise
    except InputError as error:
        rows.append(row("receivers", f"{words}: calibration", "stated", None, note=str(error)))
    for name, noise in models.items():
        rows += _alarms(words, site, name, noise) + _whole(words, site, name, noise)
    return rows


def _alarms(words: str, site: Site, name: str, noise: NoiseModel) -> list[Row]:
    updates = updates_of(site.epochs, site.options(noise), ())
    rows = []
    for m in monitors(P_FA, noise):
        ratio = ratios(m, updates)[site.half :]
        tested, alarms = int(np.isfinite(ratio).sum()), int((ratio > 1.0).sum())
        quantity = f"{words}: alarm rate of exact {m.name} without exclusion, second half, {name} noise model"
        rate = alarms / tested if tested else None
        rows.append(
            row(
                "receivers",
                quantity,
                "stated",
                rate,
                interval=binomial_interval(alarms, tested),
                note=f"{alarms} of {tested} tested epochs",
            )
        )
    return rows


def _whole(words: str, site: Site, name: str, noise: NoiseModel) -> list[Row]:
    """Run everything with exclusion; tell what the second half was like."""
    pipeline = Pipeline(SppKf(site.options(noise)), monitors(P_FA, noise), Policy(p_fa=P_FA))
    outcomes = [pipeline.push(e) for e in site.epochs]
    later = outcomes[site.half :]
    share = {s: sum(o.status == s for o in later) / len(later) for s in ("ok", "alert", "unavailable")}
    made = [e.group for o in later for e in o.exclusions]
    starts = sum("start" in o.update.events for o in later)
    status = f"alert {share['alert']:.1%}, unavailable {share['unavailable']:.1%}"
    note = f"{len(made)} exclusions of {len(set(made))} satellites, {starts} new starts of the filter"
    note += f"; {_crowd(later)}"
    rows = [
        row(
            "receivers",
            f"{words}: epochs trusted after exclusion, second half, {name} noise model",
            "stated",
            share["ok"],
            note=f"{status}; {note}",
        )
    ]
    return rows + _positions(words, site, name, outcomes)


def _crowd(outcomes: Sequence[Outcome]) -> str:
    out = [len(o.update.excluded) for o in outcomes]
    used = [len(o.update.groups()) for o in outcomes]
    return f"median {np.median(used):.0f} satellites used and {np.median(out):.0f} left out"


def _positions(words: str, site: Site, name: str, outcomes: Sequence[Outcome]) -> list[Row]:
    errors = site.horizontal_m([_position(o) for o in outcomes])
    trusted = np.array([o.status == "ok" for o in outcomes])
    rows = []
    for what, mask in (("all epochs", np.ones(len(errors), dtype=bool)), ("trusted epochs", trusted)):
        known = int(np.isfinite(errors[mask]).sum())
        if known:
            worst = f"largest {np.nanmax(errors[mask]):.2f} m, {known} epochs with known truth"
            quantity = f"{words}: horizontal RMS, {what}, {name} noise model, m"
            rows.append(row("receivers", quantity, "stated", rms(errors[mask]), note=worst))
    return rows


def _position(outcome: Outcome) -> np.ndarray:
    mean = outcome.update.posterior.mean
    return mean[:3] if len(mean) else np.full(3, np.nan)


def speed(data: Path, repeats: int = 3) -> list[Row]:
    """Return how long a process of the main job takes on BRUX: five monitors, exclusion, report.

    Parameters
    ----------
    data : Path
    repeats : int
        Processes timed after a first one, which may have to compile.
    """
    missing = BRUX.missing(data)
    if missing:
        return skipped("speed", missing)
    first, *later = [_timed(data) for _ in range(repeats + 1)]
    found = float(np.median(later))
    note = (
        f"median of {repeats} processes, {min(later):.2f} to {max(later):.2f} s; the first took {first:.1f} s"
    )
    quantity = "wall time of `pntegrity run` on 900 epochs: five monitors, exclusion, report, s"
    return [row("speed", quantity, f"at most {LIMIT_S:g}", found, found <= LIMIT_S, note=note)]


def _timed(data: Path) -> float:
    folder = data / BRUX.folder
    nav = [word for n in BRUX.nav for word in ("--nav", str(folder / n))]
    with tempfile.TemporaryDirectory() as out:
        command = [sys.executable, "-c", RUN, "run", "--obs", str(folder / BRUX.obs), *nav, "--out", out]
        # byte code is kept, as it is after an ordinary installation
        environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
        start = time.perf_counter()
        subprocess.run(command, check=True, capture_output=True, env=environment)
        return time.perf_counter() - start
