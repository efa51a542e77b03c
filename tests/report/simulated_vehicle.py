"""A vehicle with four sources, put together by hand: every figure of the report can be told beforehand.

``nav`` is one sensor, ``lbl`` has three beacons, ``slow`` measures every third epoch, ``late`` comes at epoch
20 and is silent from 60 to 75.
"""

from __future__ import annotations

import numpy as np
from simulated import START_NS, TRUTH

from pntegrity.bounds.ism import Ism
from pntegrity.exclusion import Exclusion
from pntegrity.pipeline import Outcome
from pntegrity.proving import Proof
from pntegrity.records import Layout, Prior, State, Suspect, Update, Verdict
from pntegrity.report.facts import RunFacts

N = 100
BEACON = range(10, 21)
"""Epochs at which ``lbl.AP1`` is left out; the last of them proves it."""
TRIALS = {14: "too short to tell", 17: "", 20: ""}
DOUBT, SILENT, NAV = 30, range(60, 75), range(80, N)
"""An epoch that nobody can be named at, one at which ``late`` is silent, and those without ``nav``."""
NAV_ONSET = 77
ISM = Ism(p_hmi=1e-7, sources=(("lbl", 1e-4), ("nav", 2e-4)), p_other=1e-5)


def time_ns(k: int) -> int:
    return START_NS + k * 10**9


def keys_at(k: int) -> tuple[str, ...]:
    """All that is measured."""
    keys = ["nav:RX", "nav:RY", "nav:RZ", "nav:DX", *(f"lbl:R.AP{i}" for i in (1, 2, 3))]
    keys += ["slow:A.bearing"] * (k % 3 == 0)
    keys += ["late:R.one", "late:R.two"] * (k >= 20 and k not in SILENT)
    return tuple(keys)


def left_out_at(k: int) -> set[str]:
    """The rows that are not used."""
    if k in BEACON:
        return {"lbl:R.AP1"}
    return {key for key in keys_at(k) if key.startswith("nav:")} if k in NAV else set()


def update(k: int) -> Update:
    """Innovations of two standard deviations; of what is left out, residuals of ten."""
    keys = keys_at(k)
    out = left_out_at(k)
    used, spare = (tuple(x for x in keys if (x in out) is left) for left in (False, True))
    state = State(time_ns(k), TRUTH, np.eye(3), Layout(("pos:x", "pos:y", "pos:z")))
    F = np.eye(3) if k else np.zeros((3, 3))
    prior = Prior(state, F, np.zeros((3, 3)), events=("start",) if not k else ())
    m = len(used)
    made = Update.of(prior, used, np.full(m, 1.0), np.zeros((m, 3)), 0.25 * np.eye(m))
    made = made.altered(excluded=("lbl.AP1",) * (k in BEACON) + ("nav",) * (k in NAV), posterior=state)
    n = len(spare)
    return made.altered(spare_keys=spare, spare_nu=np.full(n, 5.0), spare_var=np.full(n, 0.25))


def alarm(k: int, monitor: str, *suspects: Suspect) -> Verdict:
    return Verdict(monitor, "exact", time_ns(k), "alert", 50.0, 20.0, 1e-6, 1, suspects, len(suspects) > 1)


def suspect(k: int, *groups: str, sensors: tuple[str, ...] = (), kind: str = "bias") -> Suspect:
    return Suspect(groups, kind, 0.012, time_ns(k), 45.0, sensors)


def exclusion(k: int, name: str, monitor: str, since: int, size: float = 0.012) -> Exclusion:
    return Exclusion(time_ns(k), name, monitor, 45.0, size, "bias", time_ns(since))


def outcome(k: int) -> Outcome:
    t_ns = time_ns(k)
    fine = tuple(Verdict(m, "exact", t_ns, "ok", 5.0, 20.0, 1e-6, 1) for m in ("sources", "window"))
    first, made = fine, ()
    if k == BEACON.start:
        first = (
            alarm(k, "sources", suspect(k, "lbl")),
            alarm(k, "window", suspect(k, "lbl", sensors=("AP1",))),
        )
        made = (exclusion(k, "lbl.AP1", "window", k, 0.0),)
    if k in (DOUBT, DOUBT + 1):
        first = (alarm(k, "sources", suspect(k, "nav"), suspect(k, "lbl")), fine[1])
    if k == NAV.start:
        first = (alarm(k, "sources", suspect(k, "nav", kind="ramp")), fine[1])
        made = (exclusion(k, "nav", "sources", NAV_ONSET),)
    last = first if k in (DOUBT, DOUBT + 1) else fine
    proofs = ()
    if k in TRIALS:
        passed = k == BEACON[-1]
        proofs = (Proof("lbl.AP1", t_ns, k - 10, passed, 1.5 if passed else 4.0, 3.0, 2e-4, TRIALS[k]),)
    back = ("lbl.AP1",) * (k == BEACON[-1])
    status = "alert" if last is first and k in (DOUBT, DOUBT + 1) else "ok"
    rewound = k - NAV_ONSET if k == NAV.start else 0
    again = tuple(update(j) for j in range(k - rewound, k))
    return Outcome(t_ns, status, (*again, update(k)), rewound, last, first, made, back, proofs=proofs)


def outcomes() -> list[Outcome]:
    return [outcome(k) for k in range(N)]


def facts(**changes: object) -> RunFacts:
    given: dict[str, object] = {
        "estimator": "multi_source", "noise_name": "declared",
        "sources": ("nav", "lbl", "slow", "late", "mute"),
        "protection": ISM.to_table() | {"levels": "observed"},
    }  # fmt: skip
    return RunFacts(**(given | changes))  # type: ignore[arg-type]
