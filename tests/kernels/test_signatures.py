"""Which faults are looked for, and that fewer of them see as much."""

from __future__ import annotations

import numpy as np
import pytest
from arcs import arcs

from pntegrity.evaluate.montecarlo import plans
from pntegrity.evaluate.power import Probe, Shape
from pntegrity.kernels.bank import Schedule
from pntegrity.kernels.signatures import catalogue
from pntegrity.kernels.windows import respond
from pntegrity.monitors.glr import Glr
from pntegrity.records import Update
from pntegrity.simulate.linear import gains, spp_model

CARRIER = tuple(f"{g}:{s}" for g in ("G01", "G02", "E03", "E04") for s in ("C1C+C2W", "L1C+L2W"))


def shapes(keys: tuple[str, ...], kind: str) -> set[tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]]:
    return {(s.groups, s.level, s.rate) for s in catalogue(keys, kind)}


def test_beside_a_carrier_biases_are_of_rows_and_ramps_of_satellites() -> None:
    rows = {((k[:3],), (k,), ()) for k in CARRIER}
    families = {((g, h), tuple(sorted(k for k in CARRIER if k[:3] in (g, h))), ()) for g, h in
                (("G01", "G02"), ("E03", "E04"))}  # fmt: skip
    whole = {((g,), (f"{g}:C1C+C2W", f"{g}:L1C+L2W"), ()) for g in ("G01", "G02", "E03", "E04")}
    assert shapes(CARRIER, "bias") == rows | families
    assert shapes(CARRIER, "ramp") == whole | families


def test_without_a_carrier_every_row_and_every_satellite_has_both() -> None:
    keys = ("G01:C1C", "G01:C2W", "G01:D1C")
    rows = {(("G01",), (k,), ()) for k in keys[:2]}
    assert shapes(keys, "bias") == rows | {(("G01",), (), keys[2:]), (("G01",), keys[:2], ())}
    assert shapes(keys, "ramp") == rows | {(("G01",), keys[:2], keys[2:])}


def test_a_satellite_that_has_only_carrier_left_is_looked_at_by_row() -> None:
    keys = ("G01:C1C", "G01:L1C", "G02:L1C")
    assert shapes(keys, "ramp") >= {(("G02",), ("G02:L1C",), ())}


class Finer(Glr):
    """A bank of ramps since every epoch."""

    @property
    def schedules(self) -> tuple[Schedule, ...]:
        return Schedule(1, 0, 16), Schedule(1, 3, 64)


def delay(monitor: Glr, updates: tuple[Update, ...], onset: int) -> int:
    """Epochs after which a 0.1 m/s ramp on a pseudorange is seen with probability one half."""
    planned = list(plans(updates, monitor))
    probe = Probe([Shape("G01:C1C", "ramp")], updates[onset - 1])
    for k in range(onset - 1, len(updates)):
        reach = probe.take(planned[k])
        if reach is not None and reach.power(0, 0.1) > 0.5:
            return k - onset + 1
    return len(updates)


def test_fewer_onsets_see_a_slow_ramp_no_later() -> None:
    updates = gains(spp_model(), 120)
    onsets = range(60, 76, 3)
    few = [delay(Glr(), updates, k) for k in onsets]
    many = [delay(Finer(), updates, k) for k in onsets]
    assert sum(few) <= sum(many)
    assert max(few) < 40


@pytest.mark.parametrize(
    ("key", "kind", "size", "within"),
    [("G04:L1C", "bias", 0.5, 2), ("G04:C1C", "bias", 15.0, 4), ("G04:L1C", "ramp", 0.1, 12)],
)
def test_a_fault_beside_carriers_names_its_satellite(key: str, kind: str, size: float, within: int) -> None:
    seen = {f"G{i:02d}": 0 for i in range(1, 11)}
    updates = list(arcs([seen] * 60, np.random.default_rng(4)))
    e = np.zeros((updates[39].F.shape[0], 1))
    for k in range(40, 60):
        u = updates[k]
        f = np.zeros((len(u.keys), 1))
        f[u.keys.index(key)] = size * (k - 39 if kind == "ramp" else 1.0)
        g, e = respond(e, u.F, u.H, u.K, f)
        updates[k] = u.altered(nu=u.nu + g[:, 0])
    monitor = Glr(1e-5)
    memory, alarms = monitor.start(), []
    for k, u in enumerate(updates):
        verdict, memory = monitor.step(memory, u)
        if verdict.status == "alert":
            alarms.append((k, verdict.suspect_groups))
    assert 40 <= alarms[0][0] <= 40 + within
    assert alarms[0][1] == ("G04",)
