"""Updates of a filter with carrier arcs: ambiguities are born and die, the clock is initialised each
epoch.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pntegrity.kernels.windows import respond
from pntegrity.records import Layout, Prior, State, Update

COMMON = ("pos:x", "pos:y", "pos:z", "clk")
CLOCK_M = 300.0


def arcs(
    view: Sequence[dict[str, int]], rng: np.random.Generator, carrier_m: float = 0.02
) -> tuple[Update, ...]:
    """Return updates of a code and a carrier row a satellite; `view`: the arc of each satellite, epoch by
    epoch.

    The clock is white and takes its mean from each epoch's data, an ambiguity from its first row; the first
    epoch is a start. Innovations are drawn as such a filter's are: nothing of what was taken is left in them.
    """
    directions = {f"G{i:02d}": rng.standard_normal(3) for i in range(1, 13)}
    out: list[Update] = []
    for k, seen in enumerate(view):
        out.append(_update(k, seen, directions, carrier_m, out[-1] if out else None, rng))
    return tuple(out)


def _update(
    k: int, seen: dict[str, int], directions: dict[str, np.ndarray], carrier_m: float, last: Update | None,
    rng: np.random.Generator,
) -> Update:  # fmt: skip
    names = (*COMMON, *(f"amb:{g}:L1C:{arc}" for g, arc in seen.items()))
    old = last.posterior.layout.index if last is not None else {}
    F = np.zeros((len(names), len(old)))
    for i, name in enumerate(names):
        if name in old and name != "clk":
            F[i, old[name]] = 1.0
    born = ~F.any(axis=1)
    Q = np.diag([_noise(name, bool(b)) ** 2 for name, b in zip(names, born, strict=True)])
    P = F @ last.posterior.P @ F.T + Q if last is not None else Q
    rows, variance, keys = [], [], []
    for signal, sigma in (("C1C", 1.0), ("L1C", carrier_m)):
        for j, g in enumerate(seen):
            h = np.zeros(len(names))
            unit = directions[g] / np.linalg.norm(directions[g])
            h[:3], h[3], h[4 + j] = -unit, 1.0, float(signal == "L1C")
            rows.append(h), variance.append(sigma**2), keys.append(f"{g}:{signal}")
    state = State((k + 1) * 10**9, np.zeros(len(names)), 0.5 * (P + P.T), Layout(names))
    prior = Prior(state, F, Q, consumed=int(born.sum()))
    update = Update.of(prior, tuple(keys), np.zeros(len(keys)), np.array(rows), np.diag(variance))
    white = rng.standard_normal(len(keys))
    known = np.linalg.qr(np.linalg.solve(update.L, update.H[:, born]))[0]
    return update.altered(nu=update.L @ (white - known @ (known.T @ white)))


def _noise(name: str, born: bool) -> float:
    if name == "clk":
        return CLOCK_M
    if name.startswith("pos"):
        return 100.0 if born else 0.5
    return 100.0 if born else 1e-4


def otherwise_initialised(updates: Sequence[Update], k: int, name: str, by: float) -> tuple[Update, ...]:
    """Return the updates of a filter whose state `name` got a mean that is larger by `by` at epoch `k`."""
    out = list(updates)
    u = updates[k]
    prior = np.zeros((len(u.prior), 1))
    prior[u.prior.layout.index[name]] = by
    g = -u.H @ prior
    e = prior + u.K @ g
    out[k] = u.altered(nu=u.nu + g[:, 0])
    for i in range(k + 1, len(updates)):
        v = updates[i]
        g, e = respond(e, v.F, v.H, v.K, np.zeros((len(v.keys), 1)))
        out[i] = v.altered(nu=v.nu + g[:, 0])
    return tuple(out)
