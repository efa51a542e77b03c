"""Campaign on real acoustic ranges: how well the model of travel times explains them where the vessel was,
and what least squares finds in what is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pntegrity.formats._acoustics import AcousticLog
from pntegrity.formats.acoustic_gnatss import read_gnatss
from pntegrity.physics.acoustics import SoundSpeed
from pntegrity.records import FloatArray
from pntegrity.scenarios._acoustic_logs import LOGS, Residuals, lbl_of, open_log, residuals
from pntegrity.scenarios._real_logs import Row, row, skipped

__all__ = ["CAMPAIGN", "acoustics", "columns", "fit", "metres"]

CAMPAIGN = "acoustics"
#: Two-way times become ranges one way with this speed.
REFERENCE_MPS = 1490.0
#: The sound speed is taken as constant over this time, s, where it is let vary.
SPEED_S = 600.0


def acoustics(data: Path) -> list[Row]:
    """Return the residuals of both real logs."""
    missing = [folder for folder in LOGS.values() if not (data / folder).is_dir()]
    if missing:
        return skipped(CAMPAIGN, f"{missing[0]} is not there")
    return [*_ncl1(data), *_saga(data)]


def metres(found: Residuals) -> FloatArray:
    """Return residuals as ranges one way, m."""
    return np.asarray(found.nu_s * REFERENCE_MPS / 2.0)


def _ncl1(data: Path) -> list[Row]:
    log = open_log("NCL1", data)
    found = residuals(log, lbl_of(log))
    raw = read_gnatss(data / LOGS["NCL1"], undulation_m=0.0)
    high = residuals(raw, lbl_of(raw, sea_height_m=log.sea_height_m))
    rms = _rms(metres(found))
    return [
        row(CAMPAIGN, "NCL1: range residual with ray tracing, RMS, m", "0.1 to 0.2", round(rms, 3),
            0.1 <= rms <= 0.2, note=f"{found.rows} ranges; {_by_beacon(found)}"),
        _straight(log, "NCL1"),
        row(CAMPAIGN, "NCL1: with the transponders' heights taken as ellipsoidal, RMS, m", "stated",
            round(_rms(metres(high)), 1), note="they are above the geoid, 26.59 m below the ellipsoid"),
        *_what_is_left("NCL1", found),
    ]  # fmt: skip


def _saga(data: Path) -> list[Row]:
    log = open_log("SAGA", data)
    found = residuals(log, lbl_of(log))
    return [
        row(CAMPAIGN, "SAGA: range residual with ray tracing, mean and std, m", "stated", _mean_std(found),
            note=f"{found.rows} ranges; {_by_beacon(found)}; the file's transponders are good to 3 m"),
        _straight(log, "SAGA"),
        *_what_is_left("SAGA", found),
    ]  # fmt: skip


def _straight(log: AcousticLog, name: str) -> Row:
    c = mean_speed(log.profile, 5.0, 1150.0 if name == "NCL1" else 1340.0)
    straight = residuals(log, lbl_of(log, profile=None, sound_speed_mps=c))
    note = f"{c:.2f} m/s, the harmonic mean of the profile; {_by_beacon(straight)}"
    quantity = f"{name}: with straight rays, mean and std, m"
    return row(CAMPAIGN, quantity, "stated", _mean_std(straight), note=note)


def mean_speed(profile: SoundSpeed, top_m: float, bottom_m: float) -> float:
    """Return the harmonic mean of the speed between two depths, m/s."""
    z = np.linspace(top_m, bottom_m, 5000)
    return float(1.0 / np.mean(1.0 / profile.at(z)))


# --- what least squares finds -------------------------------------------------------------------------------


def columns(found: Residuals, what: str) -> FloatArray:
    """Return the derivatives of the residuals by one kind of error, shape (n, k).

    Parameters
    ----------
    found : Residuals
    what : str
        ``"transponders"`` (m east, north, up of each), ``"sound speed"`` (relative), ``"sound speed in
        time"`` (each `SPEED_S`), ``"delay"`` (s), ``"lever arm"`` (m) or ``"clock"`` (s, the acoustic clock
        late).
    """
    n = found.rows
    if what == "transponders":
        own = found.beacon[:, None] == np.unique(found.beacon)[None, :]
        return np.asarray((own[:, :, None] * -found.by_place[:, None, :]).reshape(n, -1))
    if what == "sound speed in time":
        bins = ((found.t_ns - found.t_ns.min()) // int(SPEED_S * 1e9)).astype(int)
        return np.asarray((bins[:, None] == np.unique(bins)[None, :]) * found.by_speed[:, None])
    one = {
        "sound speed": found.by_speed[:, None], "delay": np.ones((n, 1)), "lever arm": found.by_arm,
        "clock": found.by_lag[:, None],
    }  # fmt: skip
    return one[what]


def fit(found: Residuals, kinds: Sequence[str]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what least squares finds, what is left (m, one way), and formal standard deviations.

    Parameters
    ----------
    found : Residuals
    kinds : sequence of str
        Of `columns`, estimated together.
    """
    A = np.hstack([columns(found, k) for k in kinds])
    size = np.linalg.norm(A, axis=0)
    x, *_ = np.linalg.lstsq(A / size, found.nu_s, rcond=1e-9)
    left = found.nu_s - A / size @ x
    spread = np.linalg.pinv((A / size).T @ (A / size), rcond=1e-14, hermitian=True)
    sigma = np.sqrt(np.diagonal(spread) * np.mean(left**2)) / size
    return x / size, left * REFERENCE_MPS / 2.0, sigma


def _what_is_left(name: str, found: Residuals) -> list[Row]:
    rows = []
    units = {"sound speed": (1e6, "ppm"), "delay": (1e6, "us"), "clock": (1e3, "ms"), "lever arm": (1.0, "m")}
    for kind, (factor, unit) in units.items():
        x, left, sigma = fit(found, (kind,))
        y, both, sigma_both = fit(found, (kind, "transponders"))
        k = len(x)
        note = (
            f"alone {_listed(x * factor, sigma * factor)} {unit}; beside the transponders' coordinates "
            f"{_listed(y[:k] * factor, sigma_both[:k] * factor)} {unit}, std left {np.std(both):.3f} m; "
            "formal sigmas, as if errors were white"
        )
        quantity = f"{name}: RMS left with the {kind} estimated, m"
        rows.append(row(CAMPAIGN, quantity, "stated", round(_rms(left), 3), note=note))
    for kinds in (("transponders",), ("transponders", "sound speed in time")):
        x, left, _ = fit(found, kinds)
        places = x[: 3 * len(np.unique(found.beacon))].reshape(-1, 3)
        note = "transponders moved east, north, up by " + "; ".join(
            " / ".join(f"{v:.2f}" for v in place) for place in places
        )
        note += " m" + (f"; the sound speed anew each {SPEED_S:g} s" if len(kinds) > 1 else "")
        quantity = f"{name}: RMS left with {' and '.join(kinds)} estimated, m"
        rows.append(row(CAMPAIGN, quantity, "stated", round(_rms(left), 3), note=note))
    return rows


def _listed(x: FloatArray, sigma: FloatArray) -> str:
    return ", ".join(f"{v:.3g} ± {s:.2g}" for v, s in zip(x, sigma, strict=True))


def _rms(x: FloatArray) -> float:
    return float(np.sqrt(np.mean(x**2)))


def _mean_std(found: Residuals) -> str:
    return f"{metres(found).mean():.2f} ± {metres(found).std():.2f}"


def _by_beacon(found: Residuals) -> str:
    values = ((b, metres(found)[found.beacon == b]) for b in np.unique(found.beacon))
    return ", ".join(f"{b} {v.mean():.2f} ± {v.std():.2f}" for b, v in values)
