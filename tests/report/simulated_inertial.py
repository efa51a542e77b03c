"""A drive with an INS, put together by hand: open sky, a street with reflections, a tunnel, open sky again.

Nothing is estimated: positions, screenings and bounds are what the tests need, so that every figure of the
report can be told beforehand.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from bounded import bound, verdict
from simulated import START_NS, TRUTH

from pntegrity.estimators._ins_solution import Aside
from pntegrity.kernels.factor_set import FactorMemory
from pntegrity.kernels.rotations import from_angles, rotation
from pntegrity.physics.frames import enu_rotation
from pntegrity.pipeline import Outcome
from pntegrity.records import FloatArray, Layout, Prior, Screening, State, Update, Verdict
from pntegrity.report.facts import RunFacts

N, STREET, TUNNEL = 120, range(30, 60), range(70, 100)
REFUSED = 40
"""An epoch of the street that the filter did not use."""
ARM_M = np.array([0.5, -0.3, -1.2])
SPEED_MPS, HEADING_RAD, ROLL_RAD = 12.0, np.radians(350.0), np.radians(2.0)
ERROR_M, STREET_ERROR_M, TUNNEL_RATE = 0.5, 3.0, 0.2
SATELLITES = tuple(f"G{i:02d}" for i in range(1, 11))
NAMES = tuple(f"{kind}:{axis}" for kind in ("pos", "vel", "att", "bg") for axis in "xyz")
TO_ENU = enu_rotation(TRUTH)


def heading_at(k: int) -> float:
    """Turning right by 0.4 deg an epoch: over north at epoch 25."""
    return float(HEADING_RAD + np.radians(0.4 * k))


def attitude(k: int) -> FloatArray:
    """True body axes to ECEF."""
    return TO_ENU.T @ from_angles([ROLL_RAD, 0.0, heading_at(k)])


def places() -> FloatArray:
    """True antenna positions, shape (N, 3)."""
    heading = np.array([heading_at(k) for k in range(N)])
    step = SPEED_MPS * np.stack([np.sin(heading), np.cos(heading), 0.0 * heading], axis=1)
    return TRUTH + np.cumsum(step, axis=0) @ TO_ENU


def error_m(k: int) -> float:
    """How far east the filter is off."""
    if k in TUNNEL:
        return ERROR_M + TUNNEL_RATE * (k - TUNNEL.start + 1)
    return STREET_ERROR_M if k in STREET else ERROR_M


def sigma_m(k: int) -> float:
    """Of each coordinate."""
    return 0.4 + (0.3 * (k - TUNNEL.start + 1) if k in TUNNEL else 0.0)


def state(k: int, truth_m: FloatArray, spread_m: float) -> State:
    heading = heading_at(k)
    C = attitude(k)
    turned = TO_ENU.T @ np.array([0.0, 0.0, -np.radians(1.0)])  # heading 1 deg too large
    forward = SPEED_MPS * np.array([np.sin(heading), np.cos(heading), 0.0])
    found = rotation(turned) @ C
    place = truth_m + TO_ENU.T @ np.array([error_m(k), 0.0, 0.0]) - found @ ARM_M
    mean = np.concatenate([place, TO_ENU.T @ (forward + np.array([0.1, 0.0, 0.0])), turned, np.zeros(3)])
    sigma = np.repeat([spread_m, 0.05, np.radians(0.5), 1e-4], 3)
    return State(START_NS + k * 10**9, mean, np.diag(sigma**2), Layout(NAMES), Aside(
        C, np.zeros(3), ARM_M, FactorMemory()))  # fmt: skip


def screening(k: int) -> Screening:
    """Two satellites are dropped in the street, by two iterations; one fix is refused."""
    if k in TUNNEL:
        return Screening("factor-set", "published", satellites=(0, 0), used=False, reason="no satellite")
    if k not in STREET:
        return Screening("factor-set", "published", first=10.0, first_limit=40.0, last=10.0, last_limit=40.0,
                         tests=1, missed_m=6.0, missed_limit_m=18.0, false_alarm_m=2.0,
                         false_alarm_limit_m=30.0, satellites=(10, 10), pdop=(1.8, 1.8))  # fmt: skip
    refused = k == REFUSED
    return Screening("factor-set", "published", first=900.0, first_limit=40.0, last=12.0, last_limit=35.0,
                     dropped=(("G03:C1C", 1), ("G07:C1C", 2)), tests=20, missed_m=25.0 if refused else 9.0,
                     missed_limit_m=18.0, false_alarm_m=4.0, false_alarm_limit_m=30.0, satellites=(10, 8),
                     pdop=(1.8, 3.1), used=not refused,
                     reason="missed-detection factor 25 m above 18 m" if refused else "")  # fmt: skip


def update(k: int, truth_m: FloatArray) -> Update:
    s, told = state(k, truth_m, sigma_m(k)), screening(k)
    there = [g for g in SATELLITES if told.used and not any(key.startswith(g) for key, _ in told.dropped)]
    keys = tuple(f"{g}:C1C" for g in there)
    m, n = len(keys), len(s)
    F = np.eye(n) if k else np.zeros((n, n))
    grown = state(k, truth_m, sigma_m(TUNNEL.stop - 1)) if k == TUNNEL.stop else s
    prior = Prior(grown, F, np.zeros((n, n)), events=("start",) if not k else ("re-acquired after 30 s",) * (
        k == TUNNEL.stop))  # fmt: skip
    H = np.zeros((m, n))
    made = Update.of(prior, keys, np.zeros(m), H, np.eye(m), reason="" if m else told.reason)
    return made.altered(screening=told, posterior=s)


def outcomes() -> list[Outcome]:
    """The drive, with a level of 5 m horizontal and 8 m vertical, unbounded in the tunnel."""
    out = []
    for k, truth_m in enumerate(places()):
        u = update(k, truth_m)
        status = "ok" if u.keys else "unavailable"
        seen = Verdict("rctm", "exact", u.t_ns, status, 5.0 if u.keys else 0.0, 20.0 if u.keys else 0.0, 1e-6,
                       reason=u.reason)  # fmt: skip
        o = Outcome(u.t_ns, status, (u,), 0, (seen,), (seen,), reason=u.reason)
        given = bound(reason="") if k not in TUNNEL else bound(east=np.inf, reason="no satellite")
        both = (seen, verdict(o, given))
        out.append(replace(o, verdicts=both, first=both))
    return out


def facts(**changes: object) -> RunFacts:
    """What is known of the drive: true position, velocity and attitude."""
    heading = np.array([heading_at(k) for k in range(N)])
    true_attitude = np.stack([np.full(N, ROLL_RAD), np.zeros(N), heading], axis=1)
    forward = SPEED_MPS * np.stack([np.sin(heading), np.cos(heading), 0.0 * heading], axis=1)
    given: dict[str, object] = {
        "estimator": "gnss_ins", "noise_name": "city", "truth_m": places(),
        "truth_velocity_mps": forward @ TO_ENU, "truth_attitude_rad": true_attitude,
    }  # fmt: skip
    return RunFacts(**(given | changes))  # type: ignore[arg-type]
