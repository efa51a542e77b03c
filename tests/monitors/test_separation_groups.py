"""Solution separation while groups come and go, and on the move."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from test_separation_monitor import ISM, last, noisy, quiet, stepped

from pntegrity.monitors.separation import Separation
from pntegrity.records import Layout, Prior, State, Update
from pntegrity.simulate.linear import LinearModel, spp_model

# --- groups come and go


def without(u: Update, *groups: str) -> Update:
    keep = np.array([k[:3] not in groups for k in u.keys])
    prior, keys = Prior(u.prior, u.F, u.Q), tuple(k for k, kept in zip(u.keys, keep, strict=True) if kept)
    return Update.of(prior, keys, u.nu[keep], u.H[keep], u.R[np.ix_(keep, keep)])


def run_without(model: LinearModel, epochs: int, gone: Any) -> list[Update]:
    """Return the updates of a filter to which some groups are not there at some epochs."""
    out: list[Update] = []
    n = len(model.layout)
    for k in range(epochs):
        if out:
            F, Q, P = model.F, model.Q, model.F @ out[-1].posterior.P @ model.F.T + model.Q
        else:
            F, Q, P = np.zeros((n, 0)), model.P0, model.P0
        state = State(model.t_ns(k), np.zeros(n), 0.5 * (P + P.T), model.layout)
        whole = Update.of(Prior(state, F, Q), model.keys, np.zeros(len(model.keys)), model.H, model.R)
        out.append(without(whole, *gone(k)))
    return out


@pytest.mark.parametrize("p_constellation", [0.0, 1e-9])
def test_a_satellite_that_set_is_remembered_until_it_moves_nothing_any_more(p_constellation: float) -> None:
    # GIVEN a satellite that sets after a minute
    updates = run_without(spp_model(9), 400, lambda k: ["G04"] if k >= 60 else [])
    monitor = Separation(ism=replace(ISM, p_constellation=p_constellation), pairs=False)
    found = stepped(monitor, updates)
    assert "G04" in found[61][1].groups
    # THEN it is forgotten when its past moves the position by less than a twentieth of its sigma
    gone = next((k for k, (_, m) in enumerate(found) if k >= 60 and "G04" not in m.groups), None)
    assert gone is not None
    assert all("G04" not in m.groups for _, m in found[gone:])
    memory = found[gone - 1][1]
    assert memory.bank is not None
    P = memory.bank.P[memory.members.index(("G04",))] - memory.bank.P[0]
    assert (np.diagonal(P)[:3] < 0.06**2 * np.diagonal(memory.bank.P[0])[:3]).all()
    # until then it is a mode
    modes = [v.bound.modes for v, _ in found if v.bound is not None]
    assert modes[61] == modes[59] > modes[-1]


def test_a_satellite_that_comes_back_before_it_is_forgotten_has_its_own_past() -> None:
    model = spp_model(9)
    updates = run_without(model, 16, lambda k: ["G04"] if k in (10, 11) else [])
    memory = stepped(Separation(ism=ISM, pairs=False), updates)[-1][1]
    never = run_without(model, 16, lambda k: ["G04"])
    assert memory.bank is not None
    got = memory.bank.P[memory.members.index(("G04",))]
    np.testing.assert_allclose(got, never[-1].posterior.P, rtol=1e-7, atol=1e-9)


def test_a_start_begins_the_bank_anew() -> None:
    updates = list(quiet(8, 10))
    again = [replace(u, t_ns=u.t_ns + 60 * 10**9) for u in quiet(8, 3)]
    found = stepped(Separation(ism=ISM), [*updates, *again])
    assert int(found[9][1].began_ns.max()) == updates[0].t_ns
    assert [int(m.began_ns.max()) for _, m in found[10:]] == [again[0].t_ns] * 3


def test_a_clock_that_goes_back_and_states_that_do_not_fit_begin_it_anew() -> None:
    updates = quiet(8, 10)
    monitor = Separation(ism=ISM)
    memory = stepped(monitor, updates)[-1][1]
    assert int(monitor.step(memory, updates[5])[1].began_ns.max()) == updates[5].t_ns
    other = replace(memory, layout=Layout(("pos:x",)))
    assert int(monitor.step(other, replace(updates[5], t_ns=10**12))[1].began_ns.max()) == 10**12


# --- course


def moved(updates: Sequence[Update], step_m: tuple[float, float, float]) -> list[Update]:
    """Return the updates of a vehicle that makes a step every epoch."""
    out = []
    for k, u in enumerate(updates):
        shift = np.zeros(len(u.prior))
        shift[:3] = k * np.array(step_m)
        prior, posterior = (replace(s, mean=s.mean + shift) for s in (u.prior, u.posterior))
        out.append(replace(u, prior=prior, posterior=posterior))
    return out


def test_a_course_gives_levels_along_and_across_and_standing_gives_none() -> None:
    still = last(Separation(ism=ISM), quiet())[1]
    assert still.along_m is None
    assert still.cross_m is None
    first = stepped(Separation(ism=ISM), moved(quiet(), (50.0, 0.0, 0.0)))[0][0].bound
    assert first is not None
    assert first.along_m is None  # one position has no course
    east = last(Separation(ism=ISM), moved(quiet(), (50.0, 0.0, 0.0)))[1]
    north = last(Separation(ism=ISM), moved(quiet(), (0.0, -50.0, 3.0)))[1]
    assert (east.along_m, east.cross_m) == pytest.approx((east.east_m, east.north_m), rel=1e-9)
    # north has the share of across, then: the same levels where the shares are
    assert (north.along_m, north.cross_m) == pytest.approx((north.north_m, north.east_m), rel=1e-9)


def test_tests_along_and_across_share_the_false_alerts_of_east_and_north() -> None:
    # the probability of a false alert is that of all tests: thresholds are wider with a course
    still, moving = (last(Separation(ism=ISM), u) for u in (noisy(), moved(noisy(), (40.0, 30.0, 0.0))))
    modes = still[1].modes
    assert (still[0].dof, moving[0].dof) == (3 * modes, 5 * modes)
    assert moving[1].east_m > still[1].east_m
    assert moving[1].up_m == pytest.approx(still[1].up_m, rel=1e-12)
