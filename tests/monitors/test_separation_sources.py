"""Separation where sources take the place of satellites: priors, sensors, sources that come and are lost."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_separation_groups import run_without
from test_separation_monitor import levels, stepped

from gnss_logs import PLACE, SECOND, START, navigation, options, with_imu
from pntegrity import estimators
from pntegrity.bounds import Ism
from pntegrity.estimators._ins_options import InsOptions
from pntegrity.exclusion import Policy
from pntegrity.monitors.separation import Separation
from pntegrity.pipeline import Outcome, Pipeline
from pntegrity.records import Epoch, Observation, Update
from pntegrity.report.facts import RunFacts
from pntegrity.report.story import story
from pntegrity.sensors.fix import SIGNALS, Fix
from pntegrity.simulate.linear import Disturbance, LinearModel, gains, shifts, spp_model

KEYS = (
    *(f"gnss:R.G{i:02d}" for i in range(1, 6)), *(f"lbl:R.AP{i}" for i in range(1, 6)),
    *(f"gnss:D.G{i:02d}" for i in range(1, 6)), *(f"lbl:D.AP{i}" for i in range(1, 6)),
)  # fmt: skip
ISM = Ism(sources=(("gnss", 1e-4), ("gnss.*", 1e-5), ("lbl", 1e-5), ("lbl.AP2", 1e-4)), p_hmi=1e-6)
SENSORS = Separation(ism=ISM, pairs=False, levels="observed")


@lru_cache(maxsize=1)
def quiet() -> tuple[Update, ...]:
    return gains(vehicle(), 12)


def vehicle() -> LinearModel:
    """Five satellites and five beacons, ranges and rates of each."""
    return replace(spp_model(10, accel_mps2=0.3, code_m=2.0), keys=KEYS)


def of(*names: str) -> list[int]:
    """Return the rows of sources and sensors."""
    return [i for i, k in enumerate(KEYS) if {k.partition(":")[0], sensor(k)} & set(names)]


def sensor(key: str) -> str:
    return f"{key.partition(':')[0]}.{key.partition('.')[2]}"


# --- sensors of sources


def test_a_subfilter_of_a_sensor_never_uses_its_rows() -> None:
    memory = stepped(SENSORS, quiet())[-1][1]
    assert {("gnss",), ("lbl",), ("lbl.AP2",), ("gnss.G03",)} <= set(memory.members)
    assert ("lbl.AP1",) not in memory.members
    never = run_rows(lambda key: sensor(key) != "lbl.AP2")
    assert memory.bank is not None
    got = memory.bank.P[memory.members.index(("lbl.AP2",))]
    np.testing.assert_allclose(got, never[-1].posterior.P, rtol=1e-7, atol=1e-9)


def run_rows(kept: Callable[[str], bool]) -> Sequence[Update]:
    model = vehicle()
    keep = np.array([kept(k) for k in KEYS])
    few = replace(
        model, H=model.H[keep], R=model.R[np.ix_(keep, keep)], keys=tuple(k for k in KEYS if kept(k))
    )
    return gains(few, 12)


@settings(deadline=None, max_examples=60)
@given(
    st.sampled_from(["gnss", "gnss.G01", "gnss.G04", "lbl", "lbl.AP2"]), st.integers(0, 2**31),
    st.floats(-3.0, 3.0), st.integers(0, 11),
)  # fmt: skip
def test_levels_hold_any_fault_of_a_source_or_of_a_stated_sensor(
    name: str, seed: int, size: float, first: int
) -> None:
    # GIVEN any errors of what may fail, and no noise
    rows = np.zeros((12, len(KEYS)))
    at = of(name)
    rows[first:, at] = 10.0**size * np.random.default_rng(seed).normal(size=(12 - first, len(at)))
    g, error = shifts(quiet(), Disturbance(rows=rows))
    updates = [u.altered(nu=s) for u, s in zip(quiet(), g, strict=True)]
    # THEN no error is above its level at any epoch
    for k, (verdict, _) in enumerate(stepped(SENSORS, updates)):
        assert (np.abs(error[k, :3]) <= np.array(levels(verdict.bound)) * (1.0 + 1e-9)).all()


def test_two_sensors_at_once_are_held_as_their_source_and_two_sources_that_agree_are_not() -> None:
    rows = np.zeros((12, len(KEYS)))
    rows[:, of("lbl.AP1", "lbl.AP3")] = 500.0
    g, error = shifts(quiet(), Disturbance(rows=rows))
    one = stepped(SENSORS, [u.altered(nu=s) for u, s in zip(quiet(), g, strict=True)])[-1][0]
    assert (np.abs(error[-1, :3]) <= levels(one.bound)).all()
    # GIVEN both sources wrong by the same way, which the message holds too improbable to be looked at
    rows[:] = vehicle().H[:, :3] @ [50.0, 50.0, 50.0]
    g, error = shifts(quiet(), Disturbance(rows=rows))
    two = stepped(SENSORS, [u.altered(nu=s) for u, s in zip(quiet(), g, strict=True)])[-1][0]
    assert (np.abs(error[-1, :3]) > levels(two.bound)).all()


@pytest.mark.parametrize("fault_m", [0.0, 3e4, 1e6])
def test_a_source_that_is_lost_is_remembered_as_long_as_its_fault_is_in_the_position(fault_m: float) -> None:
    # GIVEN one epoch of beacons that hardly count beside the satellites, and what they do to a filter
    coarse = [1e4 if k.startswith("lbl") else 1.0 for k in KEYS]
    model = replace(vehicle(), R=np.diag(np.diagonal(vehicle().R) * coarse))
    memory, error, known = SENSORS.start(), np.zeros(len(model.layout)), []
    for k, u in enumerate(run_without(keyed(model), 60, lambda k: [] if k == 5 else ["lbl"])):
        prior = u.F @ error if k else error
        lbl = np.array([key == "lbl:R.AP1" for key in u.keys])
        nu = fault_m * lbl - u.H @ prior
        error = prior + u.K @ nu
        verdict, memory = SENSORS.step(memory, u.altered(nu=nu))
        # THEN no error is above its level, also after they are gone
        assert (np.abs(error[:3]) <= np.array(levels(verdict.bound)) * (1.0 + 1e-9)).all()
        known.append("lbl" in memory.groups)
    assert known[5]
    assert known[6] == (fault_m > 0.0)
    assert not known[4]


def keyed(model: LinearModel) -> LinearModel:
    """Return the model with groups of three letters, as `run_without` has them."""
    return replace(model, keys=tuple(k.replace("gnss:", "sat:") for k in KEYS))


def test_the_suspect_is_the_sensor_and_not_its_source() -> None:
    rows = np.zeros((12, len(KEYS)))
    rows[8:, of("lbl.AP2")] = 60.0
    g, _ = shifts(quiet(), Disturbance(rows=rows))
    tested = Separation(ism=ISM)
    verdict, memory = stepped(tested, [u.altered(nu=s) for u, s in zip(quiet(), g, strict=True)])[-1]
    assert verdict.status == "alert"
    assert verdict.suspect_groups == ("lbl.AP2",)
    assert all(s.groups != ("lbl", "lbl.AP2") for s in verdict.suspects)
    # and the filter can go over to the one that never knew it, or never knew the source
    for name in ("lbl.AP2", "lbl"):
        state = tested.subfilter(memory, quiet()[-1].posterior, frozenset([name]))
        assert memory.bank is not None
        np.testing.assert_array_equal(state.P, memory.bank.P[memory.members.index((name,))])


def test_names_that_never_appear_do_not_change_a_bit() -> None:
    more = replace(ISM, sources=(*ISM.sources, ("sonar", 1e-2), ("sonar.*", 1e-2), ("lbl.AP9", 1e-2)))
    one, two = (stepped(replace(SENSORS, ism=m), quiet())[-1][0] for m in (ISM, more))
    assert one == two


def test_a_larger_prior_never_makes_a_level_smaller() -> None:
    found = []
    for p in (1e-6, 1e-5, 1e-4, 1e-3):
        ism = replace(ISM, sources=(("gnss", p), ("lbl", 1e-5)))
        found.append(levels(stepped(replace(SENSORS, ism=ism), quiet())[-1][0].bound))
    assert (np.diff(np.array(found), axis=0) >= 0.0).all()


def test_what_order_the_rows_are_in_does_not_matter() -> None:
    mixed = []
    for k, u in enumerate(noisy()):
        at = np.random.default_rng(k).permutation(len(u.keys))
        mixed.append(
            u.altered(
                keys=tuple(u.keys[i] for i in at),
                nu=u.nu[at],
                H=u.H[at],
                R=np.ascontiguousarray(u.R[np.ix_(at, at)]),
            )
        )
    one, two = (stepped(SENSORS, updates)[-1][0] for updates in (noisy(), mixed))
    np.testing.assert_allclose(levels(one.bound), levels(two.bound), rtol=1e-12)


def noisy() -> list[Update]:
    rng = np.random.default_rng(3)
    return [u.altered(nu=u.L @ rng.standard_normal(len(u.keys))) for u in quiet()]


# --- the tree changes with the sources that are there


def test_a_source_that_comes_late_is_a_mode_from_then_on_and_one_that_is_lost_until_it_is_forgotten() -> None:
    def gone(k: int) -> list[str]:
        return ["lbl"] if k < 20 or k >= 40 else []

    model = keyed(vehicle())
    ism = Ism(sources=(("lbl", 1e-4), ("sat", 1e-12)), p_hmi=1e-6, unmonitored_share=0.0)
    updates = run_without(model, 300, gone)
    found = stepped(replace(SENSORS, ism=ism), updates)
    known = [m.groups for _, m in found]
    assert known[19] == ("sat",)
    assert known[20] == known[40] == ("lbl", "sat")
    assert known[-1] == ("sat",)
    # who is lost makes the level grow, and as long as it moves the position it may still be at fault
    hpl = [v.bound.hpl_m for v, _ in found]
    assert hpl[45] > hpl[39]
    modes = [v.bound.modes for v, _ in found]
    assert modes[19] < modes[20] == modes[40]
    assert modes[-1] == modes[19]


# --- an INS with sources of fixes


def log(n: int, present: Callable[[int, str], bool], ramp_mps: float = 0.0) -> tuple[Epoch, ...]:
    """Three sources of fixes beside an IMU that stands; the first drifts away from 30 s on."""
    rng = np.random.default_rng(8)
    sigma, epochs = np.repeat([0.5, 0.05], 3), []
    for k in range(n):
        said = []
        for name in ("alpha", "beta", "gamma"):
            y = np.concatenate([PLACE, np.zeros(3)]) + sigma * rng.standard_normal(6)
            y[:3] += ramp_mps * max(k - 30, 0) * (name == "alpha")
            keys = tuple(f"{name}:{s}" for s in SIGNALS)
            if present(k, name):
                said.append(Observation(name, START + k * SECOND, keys, y, aux={"cov": np.diag(sigma**2)}))
        epochs.append(Epoch(START + k * SECOND, tuple(said)))
    return with_imu(epochs)


def run(epochs: Sequence[Epoch], **changes: float) -> list[Outcome]:
    ism = Ism(sources=(("alpha", 1e-4), ("beta", 1e-4), ("gamma", 1e-5)), **changes)
    given = options(
        navigation(),
        ins=InsOptions(heading_rad=0.3),
        sources=tuple(Fix(n) for n in ("alpha", "beta", "gamma")),
    )
    filtered = estimators.discover()["multi_source"](given)
    monitor = Separation(ism=ism, pairs=False, levels="observed")
    pipeline = Pipeline(filtered, [monitor], Policy(exclude=False))
    return [pipeline.push(e) for e in epochs]


def hpl(outcomes: Sequence[Outcome]) -> np.ndarray:
    return np.array([o.verdicts[0].bound.hpl_m for o in outcomes])


def errors(outcomes: Sequence[Outcome]) -> np.ndarray:
    return np.array([np.linalg.norm(o.update.posterior.mean[:3] - PLACE) for o in outcomes])


def everyone(_k: int, _name: str) -> bool:
    return True


def test_levels_are_finite_where_sources_check_each_other() -> None:
    found = run(log(40, everyone))
    assert {o.status for o in found} == {"ok"}
    assert np.isfinite(hpl(found)).all()
    assert hpl(found)[-1] < 1.5


def test_a_ramp_that_nobody_leaves_out_makes_the_level_grow_with_the_separations() -> None:
    clean, found = run(log(75, everyone)), run(log(75, everyone, ramp_mps=0.5))
    np.testing.assert_array_equal(hpl(clean)[:31], hpl(found)[:31])
    growth = hpl(found)[31:] - hpl(clean)[31:]
    assert (np.diff(growth[20:]) > 0.0).all()
    assert growth[-1] > 3.0
    assert found[-1].verdicts[0].bound.dominant[2] == "alpha"
    # the error stays below: horizontally and vertically together it cannot exceed both
    for o, e in zip(found, errors(found), strict=True):
        assert e <= np.hypot(o.verdicts[0].bound.hpl_m, o.verdicts[0].bound.vpl_m)


def test_where_sources_are_lost_or_come_late_levels_change_with_them() -> None:
    late = run(log(60, lambda k, name: name != "gamma" or k >= 30))
    assert [o.verdicts[0].bound.modes for o in (late[29], late[30])] == [2, 3]
    assert hpl(late)[45] < hpl(late)[29]
    # with one source left, that it may be wrong is what the INS alone holds against it
    lost = run(log(60, lambda k, name: name == "beta" or k < 30))
    assert (np.diff(hpl(lost)[32:]) > 0.0).all()
    assert "beta" in lost[-1].verdicts[0].bound.dominant
    # and a run that never had another has no level at all
    alone = run(log(20, lambda _k, name: name == "beta"))
    assert np.isinf(hpl(alone)).all()
    assert {o.verdicts[0].status for o in alone} == {"unavailable"}
    assert "nothing is left to check against without beta" in alone[-1].verdicts[0].reason


def test_without_any_source_levels_grow_without_bound_and_the_verdict_says_since_when() -> None:
    found = run(log(200, lambda k, _name: k < 40))
    grown = hpl(found)[40:]
    assert (np.diff(grown) > 0.0).all()
    assert (np.diff(grown, 2)[5:] > 0.0).all()  # faster and faster, as an INS drifts
    assert grown[-1] > 50.0 * hpl(found)[39]
    assert found[39].verdicts[0].reason == ""
    for k in (40, 41, 199):
        assert f"no row of any source was used for {k - 39} s" in found[k].verdicts[0].reason
    assert (errors(found) <= hpl(found) + [o.verdicts[0].bound.vpl_m for o in found]).all()


def test_a_level_above_its_limit_is_an_alert_of_the_run_and_nobody_is_at_fault() -> None:
    found = run(log(100, lambda k, _name: k < 40 or k >= 80), hal_m=10.0)
    passed = hpl(found) > 10.0
    assert passed.any()
    for o, p in zip(found, passed, strict=True):
        verdict = o.verdicts[0]
        assert o.status == ("alert" if p else "ok")
        assert verdict.status == ("unavailable" if p else "ok")
        assert verdict.suspects == o.exclusions == ()
        assert ("horizontal protection level above the alert limit of 10 m" in o.reason) == p
        assert ("is above the alert limit of 10 m" in verdict.reason) == p
    # it ends with the sources' return: nothing was left out, nothing begins anew
    assert found[-1].status == "ok"
    assert not any(o.update.is_start for o in found[1:])
    told = [s.text for s in story(found, RunFacts())]
    assert any("horizontal protection level above the alert limit of 10 m" in t for t in told)
    assert sum("Do not use the position" in t for t in told) == 1


def test_levels_of_the_separations_as_they_are_are_usual_for_a_vehicle() -> None:
    usual = estimators.discover()["multi_source"]
    assert "separation" in usual.monitors
    assert Separation(**usual.monitoring["separation"]) == Separation(pairs=False, levels="observed")


@pytest.mark.parametrize("limit", ["hal_m", "val_m"])
def test_without_a_limit_no_level_is_too_large(limit: str) -> None:
    found = run(log(60, lambda k, _name: k < 20), **{limit: float("inf")})
    assert {o.status for o in found} == {"ok"}
