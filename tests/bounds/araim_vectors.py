"""The numerical examples of the ARAIM reference algorithm, and their least squares in plain numpy.

Working Group C, Reference airborne algorithm description document v3.0 and v3.1, appendix D; Blanch et al.,
ION GNSS 2012. The published levels were found by a bisection that stops at 5 cm; `exact` is the root itself.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from pntegrity.bounds import FaultModes, Ism, Mode, events_of, fault_modes
from pntegrity.kernels.protection import false_alert_factor, largest_threshold, protection_level
from pntegrity.states import rows_touched_by

FILE = Path(__file__).resolve().parents[2] / "../shared/reference/araim_vectors.toml"
GROUPS = ("G01", "G02", "G03", "G04", "G05", "E01", "E02", "E03", "E04", "E05")
KEYS = tuple(f"{g}:C1C" for g in GROUPS)
COMMON: dict[str, Any] = {
    "geometry_enu": [
        [0.0225, 0.9951, -0.0966], [0.6750, -0.6900, -0.2612], [0.0723, -0.6601, -0.7477],
        [-0.9398, 0.2553, -0.2269], [-0.5907, -0.7539, -0.2877], [-0.3236, -0.0354, -0.9455],
        [-0.6748, 0.4356, -0.5957], [0.0938, -0.7004, -0.7075], [0.5571, 0.3088, -0.7709],
        [0.6622, 0.6958, -0.2780],
    ],
    "b_nom_m": 0.5, "p_sat": 1e-5, "p_const": 1e-4, "p_hmi_vertical": 9.8e-8, "p_hmi_horizontal": 2e-9,
    "p_fa_vertical": 3.9e-6, "p_fa_horizontal": 9e-8, "p_threshold": 8e-8, "p_emt": 1e-5,
}  # fmt: skip
VERSIONS: dict[str, Any] = {
    "add_v3_0": {
        "c_int_m2": [3.8865, 1.4377, 0.8604, 1.6383, 1.3229, 0.8434, 0.8963, 0.8669, 0.8573, 1.3616],
        "c_acc_m2": [3.5740, 1.1252, 0.5479, 1.3258, 1.0104, 0.5309, 0.5838, 0.5544, 0.5448, 1.0491],
        "published": {"vpl_m": 19.2, "hpl_m": 14.5, "emt_m": 7.8, "sigma_acc_m": 1.47},
        "exact_root": {"vpl_m": 19.2171, "hpl_m": 14.4158, "emt_m": 7.8194, "sigma_acc_m": 1.46976},
    },
    "add_v3_1": {
        "c_int_m2": [3.2899, 1.2792, 0.7901, 1.443, 1.1847, 0.7737, 0.8233, 0.7962, 0.7871, 1.2166],
        "c_acc_m2": [2.9774, 0.9667, 0.4776, 1.1305, 0.8722, 0.4612, 0.5108, 0.4837, 0.4746, 0.9041],
        "published": {"vpl_m": 18.3, "hpl_m": 13.45, "emt_m": 7.2998, "sigma_acc_m": 1.3694},
        "exact_root": {"vpl_m": 18.2926, "hpl_m": 13.4063, "emt_m": 7.29972, "sigma_acc_m": 1.369368},
    },
}
VECTORS = {name: {**COMMON, **values} for name, values in VERSIONS.items()}


def vectors_of_the_file() -> dict[str, dict[str, Any]]:
    """Return the same from the reference folder."""
    table = tomllib.loads(FILE.read_text(encoding="utf-8"))
    common = {k: v for k, v in table.items() if not isinstance(v, dict)}
    return {k: {**common, **v} for k, v in table.items() if isinstance(v, dict)}


def ism_of(vector: dict[str, Any]) -> Ism:
    """Return the integrity support message that the example amounts to."""
    hmi = vector["p_hmi_vertical"] + vector["p_hmi_horizontal"]
    p_fa = vector["p_fa_vertical"] + vector["p_fa_horizontal"]
    level, alert = 0.5 * vector["p_hmi_horizontal"] / hmi, 0.5 * vector["p_fa_horizontal"] / p_fa
    return Ism(
        p_sat=vector["p_sat"],
        p_constellation=vector["p_const"],
        p_hmi=hmi,
        split=(level, level, 1.0 - 2.0 * level),
        p_fa=p_fa,
        fa_split=(alert, alert, 1.0 - 2.0 * alert),
        unmonitored_share=vector["p_threshold"] / hmi,
        b_code_m=vector["b_nom_m"],
        p_emt=vector["p_emt"],
    )


def design(vector: dict[str, Any]) -> np.ndarray:
    """Return the Jacobian: east, north, up and one clock a constellation."""
    G = np.zeros((10, 5))
    G[:, :3] = vector["geometry_enu"]
    G[:5, 3] = G[5:, 4] = 1.0
    return G


def estimator_of(G: np.ndarray, variance: np.ndarray, keep: np.ndarray) -> np.ndarray:
    """Return the position rows of the weighted least-squares estimator of the rows kept, shape (3, 10)."""
    weight = np.where(keep, 1.0 / variance, 0.0)
    G = G[:, np.abs(G[keep]).sum(axis=0) > 0.0]
    return np.linalg.solve((G.T * weight) @ G, G.T * weight)[:3]


def araim_reference(vector: dict[str, Any]) -> dict[str, Any]:
    """Return what the example's snapshot gives, each direction east, north, up.

    ``ism``, ``modes`` (`FaultModes`), ``sigma0``, ``sigma_acc``, ``bias0`` (3,), ``p`` (M,), ``sigma``,
    ``sigma_ss``, ``bias``, ``threshold`` (M, 3), ``levels`` (3,), ``hpl_m``, ``vpl_m``, ``emt_m``.
    """
    ism, G = ism_of(vector), design(vector)
    c_int, c_acc = np.array(vector["c_int_m2"]), np.array(vector["c_acc_m2"])
    modes = fault_modes(events_of(ism, GROUPS), ism.p_hmi, ism.p_unmonitored, ism.max_modes)
    S0 = estimator_of(G, c_int, np.ones(10, dtype=bool))
    S = np.array([estimator_of(G, c_int, ~rows_touched_by(m.patterns, KEYS)) for m in modes.monitored])
    out = {
        "ism": ism,
        "modes": modes,
        "sigma0": np.sqrt(S0**2 @ c_int),
        "sigma_acc": np.sqrt(S0**2 @ c_acc),
        "bias0": np.abs(S0).sum(axis=1) * ism.b_code_m,
        "p": np.array([m.probability for m in modes.monitored]),
        "sigma": np.sqrt(S**2 @ c_int),
        "sigma_ss": np.sqrt((S - S0) ** 2 @ c_acc),
        "bias": np.abs(S).sum(axis=2) * ism.b_code_m,
    }
    return {**out, **levels_of(out, ism, modes)}


def levels_of(out: dict[str, Any], ism: Ism, modes: FaultModes) -> dict[str, Any]:
    """Return thresholds and levels, from the code under test."""
    factors = [false_alert_factor(p, len(modes.monitored)) for p in ism.false_alerts()]
    threshold = out["sigma_ss"] * factors
    levels = [
        protection_level(
            risk, out["sigma0"][q], out["bias0"][q], out["p"], out["sigma"][:, q], out["bias"][:, q],
            threshold[:, q],
        )
        for q, risk in enumerate(ism.risks(modes.unmonitored))
    ]  # fmt: skip
    return {
        "threshold": threshold,
        "levels": np.array(levels),
        "hpl_m": float(np.hypot(levels[0], levels[1])),
        "vpl_m": levels[2],
        "emt_m": largest_threshold(out["p"], threshold[:, 2], ism.p_emt),
    }


def names(modes: tuple[Mode, ...]) -> set[str]:
    """Return the names of modes."""
    return {m.name for m in modes}
