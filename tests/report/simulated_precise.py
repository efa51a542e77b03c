"""A small filter with carriers: seven satellites, a clock without memory, arcs that come, go and are cut."""

from __future__ import annotations

import numpy as np

from pntegrity.exclusion import Exclusion
from pntegrity.physics.time import civil_to_ns
from pntegrity.pipeline import Outcome
from pntegrity.records import Layout, Prior, State, Update, Verdict

TRUTH = np.array([3582105.0, 532590.0, 5232755.0])
START_NS = civil_to_ns(2020, 6, 25)
STEP_S = 30.0
SATELLITES = ("G01", "G02", "G03", "G04", "E05", "E06", "E07")
BORN_M2 = 1e4
CUT_AT, RISES_AT, GONE_AT, SETS_AT = 10, 5, 20, 30


def arcs(k: int) -> dict[str, str]:
    """Return each carrier's arc: G02 is cut, E07 rises, G04 sets."""
    number = {"G02": 2 if k >= CUT_AT else 1}
    there = [s for s in SATELLITES if not (s == "E07" and k < RISES_AT) and not (s == "G04" and k >= SETS_AT)]
    return {s: f"amb:{s}:L1C+L2W:{number.get(s, 1)}" for s in there}


def step(old: State | None, k: int, rng: np.random.Generator) -> Update:
    """Return the update of epoch `k`; E05 is left out and reborn at `GONE_AT`."""
    ambiguity = arcs(k)
    layout = Layout(("pos:x", "pos:y", "pos:z", "clk:G", "zwd", "grad:n", "grad:e", *ambiguity.values()))
    n = len(layout)
    names = old.layout.index if old is not None else {}
    F = np.zeros((n, len(names)))
    for i, name in enumerate(layout.names):
        if name in names and not name.startswith("clk") and not (k == GONE_AT and ":E05:" in name):
            F[i, names[name]] = 1.0
    first = {"pos": 100.0**2, "clk": 30.0**2, "zwd": 0.2**2, "grad": 0.001**2, "amb": BORN_M2}
    born = ~F.any(axis=1) if len(names) else np.ones(n, dtype=bool)
    Q = np.diag([first[s.partition(":")[0]] if b else 1e-8 for s, b in zip(layout.names, born, strict=True)])
    mean = np.concatenate([TRUTH, [0.0, 0.15], np.zeros(n - 5)])
    if old is not None:
        mean = np.where(born, mean, F @ old.mean)
    P = F @ old.P @ F.T + Q if old is not None else Q
    prior = Prior(
        State(START_NS + round(k * STEP_S * 1e9), mean, P, layout), F, Q, events=("start",) * (old is None)
    )
    return _corrected(prior, ambiguity, rng)


def _corrected(prior: Prior, ambiguity: dict[str, str], rng: np.random.Generator) -> Update:
    where = np.random.default_rng(2).standard_normal((len(SATELLITES), 3))
    los = dict(zip(SATELLITES, where / np.linalg.norm(where, axis=1)[:, None], strict=True))
    index, used = (
        prior.state.layout.index,
        [s for s in ambiguity if s != "E05" or prior.state.t_ns < START_NS + 600 * 10**9],
    )
    H = np.zeros((2 * len(used), len(index)))
    for i, s in enumerate([*used, *used]):
        H[i, :3], H[i, 3], H[i, 4] = -los[s], 1.0, 2.0
        if i >= len(used):
            H[i, index[ambiguity[s]]] = 1.0
    sigma = np.repeat([0.02, 0.003], len(used))
    keys = tuple(f"{s}:{c}" for c in ("C1C+C2W", "L1C+L2W") for s in used)
    off = H @ (np.concatenate([TRUTH, [5.0, 0.15], np.zeros(len(index) - 5)]) - prior.state.mean)
    aux = {"el_rad": np.full(len(keys), 0.7), "az_rad": np.arange(len(keys)) % len(used) * 0.8}
    return Update.of(prior, keys, off + sigma * rng.standard_normal(len(keys)), H, np.diag(sigma**2), aux=aux)


def run(n: int = 40) -> list[Outcome]:
    """Return outcomes with one exclusion, a slow ramp."""
    rng = np.random.default_rng(4)
    out: list[Outcome] = []
    for k in range(n):
        u = step(out[-1].update.posterior if out else None, k, rng)
        verdict = Verdict("rctm", "exact", u.t_ns, "ok", 1.0, 30.0, 1e-6, 5)
        gone = Exclusion(u.t_ns, "E05", "glr", 40.0, 0.02 / 30.0, "ramp", u.t_ns - 10**11, False)
        made = (gone,) if k == GONE_AT else ()
        out.append(Outcome(u.t_ns, "ok", (u,), 0, (verdict,), (verdict,), exclusions=made))
    return out
