"""Epochs made one at a time, as a live receiver gives them, are those of the whole file."""

from __future__ import annotations

import pytest

from gnss_logs import fingerprint, navigation, options, simulated
from pntegrity.estimators.spp_kf import SppKf
from pntegrity.monitors import discover
from pntegrity.physics.gnss_epochs import gnss_epochs
from pntegrity.pipeline import Pipeline
from pntegrity.simulate.faults import parse_fault
from pntegrity.simulate.receiver import with_faults


@pytest.mark.parametrize("systems", ["GE", "GREC"])
def test_batch_and_live_give_the_same_outcomes_bit_for_bit(systems):
    # GIVEN a log with a fault
    nav = navigation(systems)
    table = with_faults(simulated(30, systems).table, [parse_fault("G07 bias 20 m 12:20")])
    whole = gnss_epochs(table, nav, systems=systems).epochs
    batch, live = (Pipeline(SppKf(options(nav)), [cls() for cls in discover().values()]) for _ in range(2))
    for t_ns, epoch in zip(table.t_ns.tolist(), whole, strict=True):
        # WHEN each epoch's satellites are computed on their own
        (alone,) = gnss_epochs(table, nav, systems=systems, start_ns=t_ns, end_ns=t_ns).epochs
        assert fingerprint(alone) == fingerprint(epoch)
        # THEN nothing that the pipeline says differs
        assert fingerprint(live.push(alone)) == fingerprint(batch.push(epoch))
