"""Precise point positioning on simulated epochs: models, births, exclusion and return, motion, gaps."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.stats import chi2

from gnss_logs import PLACE, SECOND, START, groups, navigation, only, run, without
from pntegrity.estimators._carrier import precise_rows
from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators.ppp import Ppp
from pntegrity.monitors.rctm import Rctm
from pntegrity.monitors.srctm import Srctm
from pntegrity.physics.frames import enu_rotation
from pntegrity.physics.orbits import satellite_states
from pntegrity.records import Epoch, State, Update
from pntegrity.sensors.noise import PPP
from pntegrity.simulate.faults import apply_faults, parse_fault
from pntegrity.simulate.precise import PreciseReceiver, simulate_precise

STEP = 30
PAIR = {"G": "1C+2W", "E": "1C+7Q", "R": "1C"}


@lru_cache(maxsize=12)
def log(
    n: int = 60, systems: str = "GE", seed: int = 1, motion: str = "static", step_s: int = STEP, **receiver
):
    """Return epochs of a receiver at `PLACE` whose errors are those of the filter's model, and its track."""
    nav = navigation(systems, 7200)
    names = sorted({r.satellite for r in (*nav.kepler, *nav.glonass)})
    t_ns = START + step_s * SECOND * np.arange(n, dtype=np.int64)
    rng = np.random.default_rng(seed)
    seconds = step_s * np.arange(n)[:, None]
    move = {
        "static": np.zeros((n, 3)),
        "walk": np.cumsum(np.sqrt(step_s) * rng.standard_normal((n, 3)), axis=0),
        "jump": np.where(np.arange(n)[:, None] < 20, 0.0, 5e4 * enu_rotation(PLACE)[0]),
        "velocity": seconds * np.array([1.0, -2.0, 0.5]),
    }[motion]
    track = PLACE + move

    def states(sats, t, ranges):
        return satellite_states(nav, sats, t, ranges, [PAIR[s[0]] for s in sats.tolist()])

    made = simulate_precise(states, names, t_ns, track, PreciseReceiver(**receiver), rng)
    return made, track


def ppp(**changes) -> Ppp:
    return Ppp(replace(GnssOptions(noise=PPP, max_gap_s=Ppp.max_gap_s), **changes))


def updates(estimator: Ppp, epochs, exclude=lambda k: frozenset()) -> list[Update]:
    state, out = State.empty(), []
    for k, epoch in enumerate(epochs):
        out.append(estimator.correct(estimator.predict(state, epoch), epoch, exclude(k)))
        state = out[-1].posterior
    return out


def enu(found, track) -> np.ndarray:
    return (np.array([u.posterior.mean[:3] for u in found]) - track) @ enu_rotation(PLACE).T


def new_arc(epochs, sat: str, at: int) -> list[Epoch]:
    """Return the epochs with an arc of a satellite that begins at `at`."""
    out = []
    for k, e in enumerate(epochs):
        made = []
        for o in e.observations:
            if o.sensor == "carrier":
                arc = np.array([2 if x.startswith(sat) and k >= at else 1 for x in o.keys])
                o = replace(o, aux={**o.aux, "arc": arc})
            made.append(o)
        out.append(replace(e, observations=tuple(made)))
    return out


# --- what a row means


def test_the_jacobian_is_the_slope_of_the_prediction():
    epochs, _ = log(systems="GRE")
    options = GnssOptions(noise=replace(PPP, gradient_m=0.01, code_bias_m=0.5), motion="static")
    estimator = Ppp(options)
    update = updates(estimator, epochs[:3])[-1]
    x, names = update.prior.mean, update.prior.layout.names
    carriers = {k: n for k in update.keys for n in names if n.startswith(f"amb:{k}:")}

    def predicted(mean):
        """Written on its own: each state by its name."""
        of = dict(zip(names, mean, strict=True))
        rows = precise_rows(epochs[2], mean[:3], options)
        clock = next(v for n, v in of.items() if n.startswith("clk:"))
        out = rows.predicted + rows.wet * of["zwd"] + rows.north * of["grad:n"] + rows.east * of["grad:e"]
        out += [clock + of.get(f"isb:{k[0]}", 0.0) + of.get(f"bias:{k}", 0.0) for k in rows.keys]
        return out + [of.get(carriers.get(k, ""), 0.0) for k in rows.keys]

    for i, name in enumerate(names):
        h, e = (10.0 if name.startswith("pos") else 1.0), np.eye(len(x))[i]
        slope = (predicted(x + h * e) - predicted(x - h * e)) / (2.0 * h)
        # the dry delay falls with height, by 3e-4 towards the zenith, 1.5e-3 at the mask
        np.testing.assert_allclose(update.H[:, i], slope, atol=1.6e-3, err_msg=name)
    rows = precise_rows(epochs[2], x[:3], options)
    assert update.keys == rows.keys
    np.testing.assert_allclose(update.nu, rows.y - predicted(x), atol=1e-6)


@pytest.mark.parametrize("motion", ["white", "walk", "velocity", "static"])
def test_f_and_q_are_the_step_of_mean_and_covariance(motion):
    epochs, _ = log()
    estimator = ppp(motion=motion)
    before, after = updates(estimator, epochs[:12])[-2:]
    old, prior = before.posterior, after.prior
    np.testing.assert_allclose(
        after.F @ old.P @ after.F.T + after.Q, prior.P, atol=1e-9 * np.abs(prior.P).max()
    )
    moved = after.F @ old.mean
    lasting = [i for i, n in enumerate(prior.layout.names) if not n.startswith("clk")]
    np.testing.assert_allclose(prior.mean[lasting], moved[lasting], atol=1e-9)
    clock = prior.layout.block("clk")
    assert not after.F[clock].any()
    scale = np.sqrt(np.diagonal(prior.P))
    assert np.linalg.eigvalsh(prior.P / np.outer(scale, scale)).min() > 0.0


# --- truth


def test_without_noise_it_is_on_truth_as_soon_as_geometry_changes():
    quiet = replace(
        PPP, code_white_m=1e-3, code_bias_m=0.0, carrier_m=1e-5, ambiguity_m=1e-9, glonass_code_bias_m=0.0,
        zwd_walk_m=1e-9,
    )  # fmt: skip
    epochs, track = log(systems="GRE", noise=quiet)
    found = updates(ppp(noise=replace(PPP, code_bias_m=0.0, code_white_m=0.5)), epochs)
    # the wet delay is told from the height as satellites move
    assert np.abs(enu(found, track)[20:]).max() < 0.01
    assert np.abs(enu(found, track)[:, :2]).max() < 0.03
    assert found[-1].posterior.mean[found[-1].posterior.layout.index["zwd"]] == pytest.approx(0.15, abs=2e-3)


@pytest.mark.parametrize("motion", ["white", "walk", "velocity", "static"])
def test_every_motion_model_converges(motion):
    epochs, track = log(n=120, systems="GE", motion="static" if motion == "white" else motion)
    options = {"motion": motion} | ({"noise": replace(PPP, accel_mps2=0.01)} if motion == "velocity" else {})
    found = updates(ppp(**options), epochs)
    late = enu(found, track)[60:]
    assert np.sqrt(np.mean(late[:, :2] ** 2)) < 0.06
    assert np.sqrt(np.mean(late[:, 2] ** 2)) < 0.12
    nees = late[-1] @ np.linalg.solve(
        enu_rotation(PLACE) @ found[-1].posterior.P[:3, :3] @ enu_rotation(PLACE).T, late[-1]
    )
    assert nees < chi2.ppf(1.0 - 1e-4, 3)


def test_static_knows_more_than_kinematic_and_both_agree():
    epochs, track = log(n=120)
    still, moving = (updates(ppp(motion=m), epochs) for m in ("static", "white"))
    a, b = (u[-1].posterior for u in (still, moving))
    assert np.trace(a.P[:3, :3]) < np.trace(b.P[:3, :3])
    apart = a.mean[:3] - b.mean[:3]
    assert apart @ np.linalg.solve(b.P[:3, :3] - a.P[:3, :3], apart) < chi2.ppf(1.0 - 1e-4, 3)
    # a static position does not move: its last hour spreads less
    assert np.std(enu(still, track)[60:], axis=0).max() < np.std(enu(moving, track)[60:], axis=0).max()


def test_the_innovations_are_as_large_as_their_covariance():
    total = dof = 0.0
    for seed in range(6):
        for u in updates(ppp(motion="static"), log(seed=10 + seed)[0])[1:]:
            total, dof = total + float(u.white @ u.white), dof + len(u.white) - u.consumed
    low, high = chi2.ppf([5e-5, 1.0 - 5e-5], dof) / dof
    assert low < total / dof < high, (total / dof, dof)


def test_code_biases_of_glonass_are_recovered():
    noise = replace(PPP, code_bias_m=0.0, code_white_m=0.5)
    epochs, track = log(n=120, systems="GR", noise=replace(noise, glonass_code_bias_m=0.0))
    # GIVEN GLONASS codes that are wrong by metres, one satellite another than the next
    names = sorted({g for e in epochs for g in groups(e) if g[0] == "R"})
    wrong = dict(zip(names, 5.0 * np.random.default_rng(5).standard_normal(len(names)), strict=True))
    faults = [parse_fault(f"{sat} bias {size:.4f} m") for sat, size in wrong.items()]
    found = updates(ppp(motion="static", noise=noise), apply_faults(epochs, faults))
    last = found[-1].posterior
    biased = [n for n in last.layout.names if n.startswith("bias:R")]
    assert len(biased) > 5
    # THEN they are found, up to what is common to all: that is the bias of the constellation
    at = [last.layout.index[n] for n in biased]
    error = last.mean[at] - [wrong[n[5:8]] for n in biased]
    assert np.std(error) < 0.5
    assert np.linalg.norm(enu(found[-1:], track[-1:])) < 0.1


def test_gradients_are_two_states_that_stay_where_there_are_none():
    epochs, _ = log(n=120)
    found = updates(ppp(motion="static", noise=replace(PPP, gradient_m=0.005)), epochs)[-1].posterior
    tilt = found.layout.block("grad")
    assert len(tilt) == 2
    assert np.abs(found.mean[tilt] / np.sqrt(np.diagonal(found.P)[tilt])).max() < 4.0
    assert np.sqrt(np.diagonal(found.P)[tilt]).max() < 0.005


# --- births and deaths


def test_what_the_data_initialise_is_counted():
    epochs, _ = log(systems="GE")
    n = len(groups(epochs[0]))
    late = [
        without(e, [g for g in groups(e) if g[0] == "E"]) if k < 10 else e for k, e in enumerate(epochs[:14])
    ]
    found = updates(ppp(), new_arc(epochs[:14], "G07", 10))
    # the start: position, clock, a bias of the second constellation, an ambiguity each
    assert found[0].consumed == 3 + 1 + 1 + sum(":L" in k for k in found[0].keys)
    assert found[0].consumed <= 5 + n
    assert found[5].consumed == 1  # the clock, each epoch
    assert found[10].consumed == 2  # and an arc that begins
    assert not found[10].F[found[10].prior.layout.index["amb:G07:L1W+L2W:2"]].any()
    assert "amb:G07:L1W+L2W:1" not in found[10].prior.layout.names
    assert found[11].consumed == 1
    galileo = updates(ppp(), late)[10]
    assert galileo.consumed == 1 + 1 + sum(":L" in k and k[0] == "E" for k in galileo.keys)
    assert "first satellites of E" in galileo.events


def test_a_position_that_is_not_where_it_was_starts_anew_and_that_costs_three():
    # GIVEN a receiver without signal in a tunnel that is 50 km further on when it is seen again
    epochs, track = log(n=40, motion="jump")
    found = updates(ppp(), epochs)
    assert "position started anew from code" in found[20].events
    assert found[20].consumed == 3 + 1
    errors = np.linalg.norm(enu(found, track), axis=1)
    # ambiguities went on, so that the position is as good as before
    assert errors[20:].max() < 2.0 * errors[10:20].max() + 0.05
    assert not any("anew" in e for u in found[21:] for e in u.events)


def test_a_long_gap_starts_anew_and_a_shorter_one_does_not():
    epochs, _ = log(n=60)
    later = [replace_time(e, 3601 * SECOND) if k >= 30 else e for k, e in enumerate(epochs)]
    found = updates(ppp(motion="static"), later)
    assert any("restart after a gap of 3631 s" in event for event in found[30].events)
    assert not found[30].F.any()
    near = updates(ppp(motion="static"), [*epochs[:30], *epochs[50:]])
    assert not near[30].events
    assert near[30].F[:3, :3].any()


def replace_time(epoch: Epoch, ns: int) -> Epoch:
    return replace(
        epoch,
        t_ns=epoch.t_ns + ns,
        observations=tuple(replace(o, t_ns=o.t_ns + ns) for o in epoch.observations),
    )


@pytest.mark.parametrize(("motion", "rows"), [("white", 0), ("static", 6)])
def test_three_satellites(motion, rows):
    epochs, _ = log()
    few = groups(epochs[20])[:3]
    found = updates(ppp(motion=motion), [*epochs[:20], only(epochs[20], few), *epochs[21:25]])
    assert len(found[20].keys) == rows
    assert found[20].reason == ("3 satellites do not determine a position" if not rows else "")
    assert np.isfinite(found[20].posterior.mean).all()
    assert found[-1].reason == ""


def test_no_satellite_at_all_is_passed_over():
    epochs, _ = log()
    found = updates(ppp(), [*epochs[:10], Epoch(epochs[10].t_ns, ()), *epochs[11:14]])
    assert found[10].reason == "0 satellites do not determine a position"
    assert found[12].reason == ""
    assert updates(ppp(), [Epoch(epochs[0].t_ns, ())])[0].reason


def test_relax_lets_position_and_clock_go_and_nothing_else():
    epochs, _ = log()
    estimator = ppp(motion="static")
    state = updates(estimator, epochs[:20])[-1].posterior
    prior = estimator.predict(state, epochs[20])
    free = estimator.relax(prior)
    moved = [i for i, n in enumerate(prior.state.layout.names) if n.startswith(("pos", "vel", "clk"))]
    stay = [i for i in range(len(prior.state)) if i not in moved]
    assert not free.F[moved].any()
    np.testing.assert_array_equal(free.F[stay], prior.F[stay])
    np.testing.assert_array_equal(free.state.P[np.ix_(stay, stay)], prior.state.P[np.ix_(stay, stay)])
    assert not free.state.P[np.ix_(moved, stay)].any()
    assert free.consumed == prior.consumed + 3
    assert any("started anew" in event for event in free.events)


# --- exclusion


def excluded_from(k0: int, sat: str):
    return lambda k: frozenset({sat}) if k >= k0 else frozenset()


def spare_carrier(update: Update, sat: str) -> float:
    """Return the residual of an excluded satellite's carrier."""
    return float(update.spare_nu[[k.startswith(f"{sat}:L") for k in update.spare_keys].index(True)])


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        ("G07:L bias 20 m 600:", 0.0),  # a slip: from then on the carrier goes on as it was
        ("G07:* ramp 0.01 m/s 600:", 3.0),  # what grew in the 300 s after its exclusion
    ],
)
def test_the_carrier_of_an_excluded_satellite_shows_what_came_after(fault, expected):
    epochs, _ = log(n=40)
    faulty = apply_faults(epochs, [parse_fault(fault)])
    found = updates(ppp(motion="static"), faulty, excluded_from(20, "G07"))
    assert spare_carrier(found[20], "G07") == pytest.approx(0.0, abs=1e-6)  # born with it
    assert spare_carrier(found[30], "G07") == pytest.approx(expected, abs=0.05)
    # position and clock are known to decimetres here: what is open of them was the same at the exclusion
    row = [k.startswith("G07:L") for k in found[30].spare_keys].index(True)
    assert np.sqrt(found[30].spare_var[row]) < 0.02
    assert "amb:G07:L1W+L2W:1~" in found[30].posterior.layout.index


def test_exclusion_is_absence_for_the_others():
    epochs, _ = log(n=40)
    out = updates(ppp(motion="static"), epochs, excluded_from(15, "G07"))
    away = updates(
        ppp(motion="static"), [without(e, ["G07"]) if k >= 15 else e for k, e in enumerate(epochs)]
    )
    for a, b in zip(out, away, strict=True):
        np.testing.assert_allclose(a.posterior.mean[:3], b.posterior.mean[:3], atol=1e-6)
    assert not any(k.startswith("G07") for k in out[20].keys)


def test_a_start_without_a_satellite_is_not_made_from_it():
    epochs, _ = log(n=3)
    mixed = [
        replace(e, observations=tuple(
            replace(o, y=np.where([k.startswith("G07") for k in o.keys], o.y + 5e3, o.y))
            for o in e.observations
        ))
        for e in epochs
    ]  # fmt: skip
    found = updates(ppp(), mixed, lambda k: frozenset({"G07"}))
    away = updates(ppp(), [without(e, ["G07"]) for e in epochs])
    np.testing.assert_allclose(found[0].posterior.mean[:3], away[0].posterior.mean[:3], atol=1e-3)


@pytest.mark.parametrize(
    ("fault", "returns"), [("G07:L bias 3 m 900:", True), ("G07:* ramp 0.05 m/s 900:", False)]
)
def test_a_satellite_with_a_fault_is_excluded_and_comes_back_only_after_a_slip(fault, returns):
    epochs, track = log(n=110, systems="GE")
    faulty = apply_faults(epochs, [parse_fault(fault)])
    outcomes = run(ppp(motion="static"), (Rctm(p_fa=1e-6), Srctm(p_fa=1e-6)), faulty, exclude=True)
    excluded = [frozenset(o.update.excluded) for o in outcomes]
    assert frozenset().union(*excluded) == {"G07"}
    first = next(k for k, e in enumerate(excluded) if e)
    assert 30 <= first <= 36
    assert bool(excluded[-1]) != returns
    errors = np.linalg.norm([o.update.posterior.mean[:3] for o in outcomes] - track, axis=1)
    assert errors[60:].max() < 0.25
