"""Campaigns of moving receivers: a real road drive whose every alarm is explained, a van run on its real
track.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators.ppp import Ppp
from pntegrity.evaluate.calibrate import updates_of
from pntegrity.exclusion import Exclusion
from pntegrity.formats.truth import read_truth
from pntegrity.physics.frames import enu_rotation
from pntegrity.pipeline import Outcome
from pntegrity.records import FloatArray
from pntegrity.scenarios._ppp_logs import CARD, PreciseSite, opened, positions_of
from pntegrity.scenarios._ppp_runs import VAN, real_drive
from pntegrity.scenarios._real_logs import Row, row, skipped
from pntegrity.scenarios.evidence_ppp import DRIVE_M, fitted
from pntegrity.sensors.noise import PPP
from pntegrity.simulate.precise import PreciseReceiver, simulate_precise

__all__ = ["drive", "van"]

#: GINav's own kinematic PPP of the van, RMS east, north, up, m.
GINAV_M = (0.23, 0.14, 0.41)
GINAV_FILE = "ginav_result/cpt0870_PPP_K.pos.gz"
#: Errors of the simulated van: carrier and code of the pair at the zenith, a code bias that lasts, clocks
#: sampled every 15 min.
VAN_NOISE = replace(
    PPP, carrier_m=0.002, ambiguity_m=2e-4, code_white_m=0.33, code_bias_m=0.33, code_bias_tau_s=86400.0,
    satellite_clock_m=0.0017,
)  # fmt: skip
VAN_CLOCK_S, VAN_SEEDS = 900.0, 10


def drive(data: Path) -> list[Row]:
    """Return what the whole pipeline makes of the road drive."""
    missing = CARD.missing(data)
    if missing:
        return skipped("ppp-drive", missing)
    site = opened(CARD, data, "GREC")
    noise = fitted(CARD, data, "GREC")
    pipeline = site.pipeline(noise)
    outcomes = [pipeline.push(e) for e in site.epochs]
    return _state_rows(site, outcomes) + _alarm_rows(site, outcomes)


def _state_rows(site: PreciseSite, outcomes: Sequence[Outcome]) -> list[Row]:
    n = len(outcomes)
    counts = Counter(o.status for o in outcomes)
    words = ", ".join(f"{s} {counts[s]}" for s in ("ok", "alert", "unavailable"))
    reasons = Counter(o.reason for o in outcomes if o.status == "unavailable")
    why = "; ".join(f"{reason} ({k})" for reason, k in reasons.most_common(3))
    errors = site.errors_m(positions_of([o.update for o in outcomes]))
    h = np.hypot(errors[:, 0], errors[:, 1])
    trusted = h[[o.status == "ok" for o in outcomes]]
    size = float(np.sqrt(np.nanmean(trusted**2)))
    note = f"median {np.nanmedian(trusted):.2f}, largest {np.nanmax(trusted):.1f} m"
    return [
        row("ppp-drive", "epochs run, and their status", "all 1201", words, n == 1201, note=why),
        row("ppp-drive", "horizontal difference to the float PPK of trusted epochs, RMS, m",
            f"at most {DRIVE_M:g}", round(size, 2), size <= DRIVE_M, note=note),
    ]  # fmt: skip


def _alarm_rows(site: PreciseSite, outcomes: Sequence[Outcome]) -> list[Row]:
    """Explain the second half: the noise model knows the first."""
    half = len(outcomes) // 2
    later = outcomes[half:]
    alarms = sum(any(v.status == "alert" for v in o.first) for o in later)
    made = [e for o in later for e in o.exclusions]
    explained = [_explained(site, e) for e in made]
    kinds = Counter(filter(None, explained))
    open_ones = [f"{e.group} {e.t_ns}" for e, why in zip(made, explained, strict=True) if not why]
    left = sum(o.status == "alert" for o in later)
    return [
        row("ppp-drive", "epochs of the second half with an alarm at first look", "stated", alarms,
            note=f"of {len(later)}; {left} stay alerts, which tell their reason"),
        row("ppp-drive", "exclusions of the second half explained by code, Doppler or wide lane", "all",
            f"{len(made) - len(open_ones)} of {len(made)}", not open_ones,
            note="; ".join(f"{why} {n}" for why, n in kinds.most_common())),
    ]  # fmt: skip


def _explained(site: PreciseSite, e: Exclusion) -> str:
    """Say what else shows that a satellite was wrong about the time of its exclusion; empty: nothing does."""
    t_ns = np.array([epoch.t_ns for epoch in site.epochs])
    last, first = int(np.searchsorted(t_ns, e.t_ns)), int(np.searchsorted(t_ns, min(e.onset_ns, e.t_ns)))
    around = site.epochs[max(first - 3, 0) : last + 4]
    found: dict[str, list[float]] = {"code": [], "doppler": [], "carrier": []}
    arcs, low = set(), False
    for epoch in around:
        for name, values in found.items():
            o = epoch.sensor(name)
            rows = [] if o is None else [i for i, k in enumerate(o.keys) if k.startswith(e.group + ":")]
            values.append(float(o.y[rows[0]]) if o is not None and rows else float("nan"))
            if name == "carrier" and rows and o is not None:
                arcs.add(int(o.aux["arc"][rows[0]]))
            if rows and o is not None:
                low |= bool(o.aux["cn0_dbhz"][rows[0]] < LOW_DBHZ)
    code, rate, carrier = (np.array(v) for v in found.values())
    if np.isnan(carrier).any() or len(arcs) > 1:
        return "loss of lock nearby"
    apart = np.abs(np.diff(code - carrier))
    if np.nanmax(apart, initial=0.0) > JUMP_M:
        return "code multipath against carrier"
    steps = np.diff(carrier) - 0.5 * (rate[1:] + rate[:-1])
    if np.nanmax(np.abs(steps - np.nanmedian(steps)), initial=0.0) > STEP_M:
        return "carrier against Doppler"
    return "weak signal" if low else ""


#: What counts as a proof: a change of code minus carrier or of carrier minus Doppler within a second, m;
#: C/N0.
JUMP_M, STEP_M, LOW_DBHZ = 1.5, 0.1, 33.0


def van(data: Path) -> list[Row]:
    """Return the clean error of the simulated van run beside that of GINav on the real data."""
    if not (data / VAN).is_dir():
        return skipped("ppp-van", f"{VAN} is not here")
    drive_ = real_drive(data, "GR")
    noise = VAN_NOISE
    receiver = PreciseReceiver(noise, mask_rad=float(np.deg2rad(10.0)), clock_interval_s=VAN_CLOCK_S)
    options = GnssOptions(noise=noise, max_gap_s=Ppp.max_gap_s)
    turn = enu_rotation(drive_.track_m[0])
    series = []
    for seed in range(VAN_SEEDS):
        rng = np.random.default_rng(seed)
        epochs = simulate_precise(drive_.states, drive_.sats, drive_.t_ns, drive_.track_m, receiver, rng)
        series.append((positions_of(updates_of(epochs, options, (), Ppp)) - drive_.track_m) @ turn.T)
    return _van_rows(np.array(series), _ginav(data, turn))


def _ginav(data: Path, turn: FloatArray) -> FloatArray:
    """Return GINav's errors, east, north, up; nan where it has no epoch."""
    truth = read_truth(data / VAN / "cpt_pva_ref.csv.gz")
    position, known = read_truth(data / VAN / GINAV_FILE).at(truth.t_ns)
    return np.asarray(np.where(known[:, None], (position - truth.position_m) @ turn.T, np.nan))


def _van_rows(series: FloatArray, ginav: FloatArray) -> list[Row]:
    out = []
    for label, part in (
        ("whole run", slice(None)),
        ("first 200 s", slice(0, 200)),
        ("after 200 s", slice(200, None)),
    ):
        ours = np.sqrt(np.mean(series[:, part] ** 2, axis=(0, 1)))
        theirs = np.sqrt(np.nanmean(ginav[part] ** 2, axis=0))
        text = " / ".join(f"{v:.2f}" for v in theirs)
        ok = None
        if label == "whole run":
            size = float(np.linalg.norm(ours) / np.linalg.norm(theirs))
            ok = bool(np.all(np.abs(theirs - np.array(GINAV_M)) < 0.006)) and abs(size - 1.0) < 0.2
        measured = " / ".join(f"{v:.2f}" for v in ours)
        note = f"{len(series)} seeds; clock samples of 15 min, white carrier {1e3 * VAN_NOISE.carrier_m:g} mm"
        out.append(row("ppp-van", f"RMS E N U, {label}, m", f"GINav: {text}", measured, ok, note=note))
    return out
