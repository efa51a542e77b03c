"""Figures of methods over drives through towns: errors by section, what is gained, subsets, availability."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from pntegrity.kernels.factor_set import araim_subsets
from pntegrity.records import FloatArray
from pntegrity.scenarios._city_runs import EKF, Tracked
from pntegrity.scenarios._real_logs import Row, rms, row
from pntegrity.simulate.urban_scenario import CHALLENGING, DENIED, OPEN

__all__ = [
    "HEADING", "HORIZONTAL", "QUANTITIES", "SECTIONS", "SPACE", "VELOCITY", "WHOLE", "Found", "error_rows",
    "gain", "gain_row", "median_row", "rmse", "subset_rows", "use_row", "wrong_row",
]  # fmt: skip

Found = Mapping[str, Sequence[Tracked]]
WHOLE = "whole drive"
SECTIONS = (WHOLE, OPEN, CHALLENGING, DENIED)
HORIZONTAL, SPACE, VELOCITY, HEADING = "horizontal", "3-D", "velocity", "heading"
#: Errors (n,) of a run: m, m, m/s, degrees.
QUANTITIES: Mapping[str, Callable[[Tracked], FloatArray]] = {
    HORIZONTAL: lambda t: t.horizontal_m,
    SPACE: lambda t: np.asarray(np.linalg.norm(t.position_m, axis=1)),
    VELOCITY: lambda t: np.asarray(np.linalg.norm(t.velocity_mps, axis=1)),
    HEADING: lambda t: np.rad2deg(np.abs(t.attitude_rad[:, 2])),
}
UNITS = {VELOCITY: "m/s", HEADING: "degrees"}
#: Faults at once that ARAIM's subsets are counted for.
ARAIM_FAULTS = 3
DRAWS, CONFIDENCE = 10_000, 0.99


def of_section(run: Tracked, values: FloatArray, section: str) -> FloatArray:
    """Return the values (n,) of a run's epochs that are in a section."""
    return values if section == WHOLE else values[run.kind == section]


def rmse(runs: Sequence[Tracked], quantity: str, section: str = WHOLE) -> FloatArray:
    """Return the root mean square error of each run, shape (len(runs),), nan where there is no such epoch."""
    errors = QUANTITIES[quantity]
    return np.array([rms(of_section(r, errors(r), section)) for r in runs])


def gain(method: FloatArray, reference: FloatArray) -> tuple[float, tuple[float, float]]:
    """Return by how much the mean error over seeds is smaller than a reference's, per cent, and its interval.

    The interval is a bootstrap's over seeds, of 99 %: the same seeds are drawn for both.

    Parameters
    ----------
    method, reference : ndarray, shape (seeds,)
        Errors of the same seeds.
    """
    drawn = np.random.default_rng(1).integers(0, len(method), (DRAWS, len(method)))
    ratio = method[drawn].mean(axis=1) / reference[drawn].mean(axis=1)
    low, high = np.quantile(100.0 * (1.0 - ratio), [0.5 - 0.5 * CONFIDENCE, 0.5 + 0.5 * CONFIDENCE])
    return 100.0 * (1.0 - float(method.mean() / reference.mean())), (float(low), float(high))


def error_rows(campaign: str, found: Found, label: str) -> list[Row]:
    """Return the mean over seeds of the root mean square errors of all methods, section by section."""
    out = []
    present = set(next(iter(found.values()))[0].kind.tolist()) | {WHOLE}
    sections = [s for s in SECTIONS if s in present] if len(present) > 2 else [WHOLE]
    for section in sections:
        cells = {
            n: f"{_mean(r, HORIZONTAL, section):.2f} / {_mean(r, SPACE, section):.2f}"
            for n, r in found.items()
        }
        quantity = f"{label}: position RMSE horizontal / 3-D, {section}, m"
        out.append(row(campaign, quantity, "stated", cells))
    for name in (VELOCITY, HEADING):
        for section in sections:
            cells = {n: f"{_mean(r, name, section):.3f}" for n, r in found.items()}
            out.append(row(campaign, f"{label}: {name} RMSE, {section}, {UNITS[name]}", "stated", cells))
    return out


def _mean(runs: Sequence[Tracked], quantity: str, section: str) -> float:
    return float(np.mean(rmse(runs, quantity, section)))


def gain_row(
    campaign: str, found: Found, label: str, name: str, quantity: str, least: float, most: float = np.inf,
    note: str = "",
) -> Row:  # fmt: skip
    """Return by how much a method's error is smaller than that of the plain EKF, per cent, and what it must
    be.
    """
    mine, plain = rmse(found[name], quantity), rmse(found[EKF], quantity)
    value, interval = gain(mine, plain)
    each = 100.0 * (1.0 - mine / plain)
    seeds = f"by seed {each.min():.0f} to {each.max():.0f}, median {np.median(each):.0f}"
    note = f"{note}; {seeds}" if note else seeds
    must = f"at least {least:g}" if not np.isfinite(most) else f"{least:g} to {most:g}"
    words = f"{label}: {quantity} error of *{name}* below that of the EKF, %"
    ok = least <= value <= most
    return row(campaign, words, must, f"{value:.1f}", ok, interval=interval, note=note)


def median_row(campaign: str, found: Found, label: str) -> Row:
    """Return the median of the horizontal errors of all seeds."""
    cells = {n: f"{np.nanmedian([t.horizontal_m for t in r]):.2f}" for n, r in found.items()}
    return row(campaign, f"{label}: median of the horizontal error, m", "stated", cells)


def use_row(campaign: str, found: Found, label: str) -> Row:
    """Return the share of epochs with a position, and of those in which GNSS was used."""
    cells = {
        n: _share([np.isfinite(t.horizontal_m) for t in r], [t.used for t in r]) for n, r in found.items()
    }
    quantity = f"{label}: epochs with a position / in which GNSS was used, %"
    return row(campaign, quantity, "stated", cells)


def _share(there: Sequence[np.ndarray], used: Sequence[np.ndarray]) -> str:
    return f"{100.0 * np.mean(there):.1f} / {100.0 * np.mean(used):.1f}"


#: A fix further off than this is wrong, m: the paper's threshold of what may be missed.
WRONG_M = 9.0


def wrong_row(campaign: str, found: Found, label: str) -> Row:
    """Return the share of the fixes used between houses that were wrong: what detection let through."""
    street = {n: np.concatenate([of_section(t, t.fix_m, CHALLENGING) for t in r]) for n, r in found.items()}
    shares = {
        n: f"{100.0 * np.mean(x[np.isfinite(x)] > WRONG_M):.1f} of {np.isfinite(x).sum()}"
        for n, x in street.items()
        if np.isfinite(x).any()
    }
    quantity = f"{label}: used fixes in streets more than {WRONG_M:g} m off horizontally, %"
    return row(campaign, quantity, "stated", shares)


def subset_rows(campaign: str, found: Found, label: str, names: Sequence[str]) -> list[Row]:
    """Return how many subsets detection tested in an epoch, beside those of ARAIM for three faults."""
    out = []
    for name in names:
        tests = np.concatenate([t.tests[t.tests > 0] for t in found[name]])
        seen = np.concatenate([t.satellites[t.tests > 0, 0] for t in found[name]])
        araim = np.array([araim_subsets(int(n), ARAIM_FAULTS) for n in np.unique(seen)])
        each = araim[np.searchsorted(np.unique(seen), seen)]
        measured = f"{np.median(tests):.0f} / {tests.max()}"
        note = (
            f"ARAIM for three faults: {np.median(each):.0f} / {each.max()}, with {np.median(seen):.0f} / "
            f"{seen.max()} satellites; the paper's largest is 175"
        )
        quantity = f"{label}: subsets that *{name}* tests in an epoch, median / largest"
        out.append(row(campaign, quantity, "stated", measured, note=note))
    return out
