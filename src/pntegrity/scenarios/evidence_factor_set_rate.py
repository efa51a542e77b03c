"""What the factor-set detection factor's false-alarm rate really is, and how many subsets it tests.

A fault-free sky of two constellations, satellites above 10 degrees drawn uniformly over it, pseudorange noise
of 1 m. The published factor divides residuals by the sigma of residuals, in the place of the measurement's,
and takes its threshold from the chi-square of the measurements': with `n` rows and five states the statistic
is ``n / (n - 5)`` times too large on the average. Its rate is counted with the sigmas that a long window
settles at, over skies with the same number of satellites, and with sigmas that adapt epoch by epoch: these
become smaller still, as residuals that were left out never enter the window. The exact factor is counted in
the same two ways.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np

from pntegrity.evaluate.intervals import binomial_interval
from pntegrity.kernels.factor_set import (
    FactorMemory,
    FactorSet,
    Pseudoranges,
    araim_subsets,
    screen_factor_set,
)
from pntegrity.kernels.snapshot_fix import design, project
from pntegrity.kernels.tails import chi2_threshold
from pntegrity.scenarios._real_logs import Row, row

__all__ = ["factor_set_rate"]

CAMPAIGN = "factor-set-rate"
P_FA = 1e-5
SATELLITES = (8, 12, 16, 20)
EPOCHS = 2_000_000
"""Epochs of each number of satellites, with sigmas that have settled."""
SKIES = 20
"""Skies that they are shared by."""
BLOCK = 50_000
#: Epochs of the recursive simulation: to fill the window, and to count.
SETTLING, COUNTED = 2_000, 60_000
#: Variants and false-alarm probabilities of it, high enough to count alarms.
RECURSIVE: tuple[tuple[Literal["exact", "published"], float], ...] = (
    ("published", P_FA), ("published", 1e-3), ("exact", 1e-3),
)  # fmt: skip
PAPER_SATELLITES = 16


def factor_set_rate(data: Path | None = None) -> list[Row]:
    """Return the rows of the campaign; `data` is not looked at: everything is simulated."""
    rng = np.random.default_rng(20230327)
    rows = [r for n in SATELLITES for r in _settled_rows(n, rng)]
    return [*rows, *_recursive_rows(rng), _subset_row(rng)]


def sky(n: int, rng: np.random.Generator, sigma_m: float = 1.0) -> Pseudoranges:
    """Return `n` satellites of two constellations in turn, uniform over the sky above 10 degrees, without
    data.
    """
    height, azimuth = rng.uniform(np.sin(np.deg2rad(10.0)), 1.0, n), rng.uniform(0.0, 2.0 * np.pi, n)
    level = np.sqrt(1.0 - height * height)
    los = np.stack([level * np.sin(azimuth), level * np.cos(azimuth), height], axis=1)
    clock = np.arange(n) % 2
    keys = tuple(f"{'GC'[c]}{i + 1:02d}:C1C" for i, c in enumerate(clock.tolist()))
    return Pseudoranges(keys, los, clock, np.zeros(n), np.full(n, sigma_m), np.eye(3))


def with_noise(rows: Pseudoranges, rng: np.random.Generator) -> Pseudoranges:
    """Return the rows with noise of their own sigma."""
    noise = rows.sigma_m * rng.standard_normal(len(rows.keys))
    return Pseudoranges(rows.keys, rows.los, rows.clock, noise, rows.sigma_m, rows.enu)


def alarms(rows: Pseudoranges, variant: str, p_fa: float, epochs: int, rng: np.random.Generator) -> int:
    """Return how many fault-free epochs alarm when the sigmas are those that a long window settles at.

    For ``"published"`` these are the standard deviations of residuals of least squares without weights; for
    ``"exact"`` the measurements' own.
    """
    weights = np.ones(len(rows.keys)) if variant == "published" else 1.0 / rows.sigma_m
    found = project(design(rows)[0], weights)
    assert found is not None
    residual = found.project * (weights * rows.sigma_m)  # from unit normals to whitened residuals
    settled = np.sqrt((residual * residual).sum(axis=1)) if variant == "published" else np.ones(len(weights))
    least = FactorSet().sigma_min_m if variant == "published" else 0.0
    form = residual / np.maximum(settled, least)[:, None]
    limit, count = chi2_threshold(p_fa, found.dof), 0
    for start in range(0, epochs, BLOCK):
        noise = rng.standard_normal((len(rows.keys), min(BLOCK, epochs - start)))
        count += int((((form @ noise) ** 2).sum(axis=0) > limit).sum())
    return count


def _settled_rows(n: int, rng: np.random.Generator) -> list[Row]:
    skies = [sky(n, rng) for _ in range(SKIES)]
    counted = {
        v: sum(alarms(s, v, P_FA, EPOCHS // SKIES, rng) for s in skies) for v in ("published", "exact")
    }
    what = f"with {n} satellites, {EPOCHS:,} epochs, sigmas settled"
    published, exact = (binomial_interval(counted[v], EPOCHS) for v in ("published", "exact"))
    return [
        row(
            CAMPAIGN, f"P_FA of the published factor {what}", "stated beside nominal 1e-5",
            counted["published"] / EPOCHS, interval=published,
        ),
        row(
            CAMPAIGN, f"P_FA of the exact factor {what}", "99 % interval holds 1e-5",
            counted["exact"] / EPOCHS, exact[0] <= P_FA <= exact[1], interval=exact,
        ),
    ]  # fmt: skip


def recursive(
    options: FactorSet, rows: Pseudoranges, settling: int, epochs: int, rng: np.random.Generator
) -> int:
    """Return how many fault-free epochs alarm while the sigmas adapt, after some to settle."""
    memory, count = FactorMemory(), 0
    for k in range(settling + epochs):
        screening, _, _, memory = screen_factor_set(options, memory, with_noise(rows, rng))
        count += k >= settling and screening.first > screening.first_limit
    return count


def _recursive_rows(rng: np.random.Generator) -> list[Row]:
    rows = sky(PAPER_SATELLITES, rng)
    out = []
    for variant, p_fa in RECURSIVE:
        count = recursive(FactorSet(variant, p_fa=p_fa), rows, SETTLING, COUNTED, rng)
        low, high = binomial_interval(count, COUNTED)
        must, ok = f"99 % interval holds {p_fa:g}", low <= p_fa <= high
        out.append(
            row(
                CAMPAIGN,
                f"P_FA of the {variant} factor with {PAPER_SATELLITES} satellites, {COUNTED:,} epochs, "
                f"sigmas adapting over 1000 epochs, nominal {p_fa:g}",
                must if variant == "exact" else "stated", count / COUNTED,
                ok if variant == "exact" else None, interval=(low, high),
            )
        )  # fmt: skip
    return out


def subsets(n: int, faults: int, epochs: int, rng: np.random.Generator) -> list[int]:
    """Return how many subsets were tested in epochs with so many faults of 20 to 100 m, one count each."""
    options, found = FactorSet(), []
    for _ in range(epochs):
        rows = with_noise(sky(n, rng), rng)
        bias = np.zeros(n)
        bias[rng.choice(n, faults, replace=False)] = rng.uniform(20.0, 100.0, faults)
        faulty = Pseudoranges(rows.keys, rows.los, rows.clock, rows.residual_m + bias, rows.sigma_m, rows.enu)
        found.append(screen_factor_set(options, FactorMemory(), faulty)[0].tests)
    return found


def _subset_row(rng: np.random.Generator) -> Row:
    n = PAPER_SATELLITES
    counts = {faults: subsets(n, faults, 200, rng) for faults in (1, 3, 6)}
    said = "; ".join(f"{f} faults: {np.median(c):.0f}, at most {max(c)}" for f, c in counts.items())
    largest = n * (n + 1) // 2 - 21  # one row after the other, down to six
    return row(
        CAMPAIGN, f"subsets tested in an epoch of {n} satellites, median and maximum of 200",
        f"never above {largest}; ARAIM against three faults: {araim_subsets(n, 3)}", said,
        all(max(c) <= largest for c in counts.values()) and araim_subsets(n, 3) == 696,
    )  # fmt: skip
