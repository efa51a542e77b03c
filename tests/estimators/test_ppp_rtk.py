"""PPP-RTK on simulated epochs: what rows mean, products, references, correlation, births, exclusion."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.stats import chi2

from gnss_logs import PLACE, SECOND, START, groups, log, navigation, options, without
from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators._uncombined import ionosphere_free, uncombined_rows
from pntegrity.estimators.ppp_rtk import PppRtk
from pntegrity.physics.frames import enu_rotation
from pntegrity.physics.orbits import satellite_states
from pntegrity.records import Epoch, State, Update
from pntegrity.sensors.noise import PPP_RTK, PPP_RTK_PUBLISHED, NoiseModel
from pntegrity.simulate.faults import apply_faults, parse_fault
from pntegrity.simulate.precise import PreciseReceiver
from pntegrity.simulate.uncombined import Air, Uncombined, simulate_uncombined

STEP = 30
PAIR = {"G": "1C+2W", "E": "1C+7Q", "R": "1C"}
NO_PRODUCTS = Air(iono_m=0.0, wet_m=0.0)
QUIET = replace(
    PPP_RTK_PUBLISHED, code_white_m=1e-3, carrier_m=1e-5, zwd_walk_m=1e-9, iono_walk_m=1e-4, isb_m=1e-6
)


@lru_cache(maxsize=24)
def simulated(
    n: int = 40, noise: NoiseModel = PPP_RTK, air: Air | None = None, seed: int = 1, systems: str = "GE",
    step_s: int = STEP, **receiver
) -> Uncombined:  # fmt: skip
    """Return what a receiver at `PLACE` sees, whose errors are those of the filter's model."""
    nav = navigation(systems, 7200)
    names = sorted({r.satellite for r in (*nav.kepler, *nav.glonass)})
    t_ns = START + step_s * SECOND * np.arange(n, dtype=np.int64)

    def states(sats, t, ranges):
        return satellite_states(nav, sats, t, ranges, [PAIR[s[0]] for s in sats.tolist()])

    made = PreciseReceiver(noise=noise, **receiver)
    rng = np.random.default_rng(seed)
    return simulate_uncombined(states, names, t_ns, np.tile(PLACE, (n, 1)), made, rng, air)


def rtk(noise: NoiseModel = PPP_RTK, **changes) -> PppRtk:
    return PppRtk(replace(GnssOptions(noise=noise, max_gap_s=PppRtk.max_gap_s), **changes))


def updates(estimator: PppRtk, epochs, exclude=lambda k: frozenset()) -> list[Update]:
    state, out = State.empty(), []
    for k, epoch in enumerate(epochs):
        out.append(estimator.correct(estimator.predict(state, epoch), epoch, exclude(k)))
        state = out[-1].posterior
    return out


def enu(found: list[Update]) -> np.ndarray:
    return np.array([u.posterior.mean[:3] - PLACE for u in found]) @ enu_rotation(PLACE).T


def from_epoch(k0: int, *names: str):
    return lambda k: frozenset(names) if k >= k0 else frozenset()


def row(update: Update, key: str) -> int:
    return update.keys.index(key)


def edited(epochs, sensor: str, change) -> list[Epoch]:
    """Return the epochs with `change(k, observation)` in the place of a sensor's observation."""
    return [
        replace(e, observations=tuple(change(k, o) if o.sensor == sensor else o for o in e.observations))
        for k, e in enumerate(epochs)
    ]


def kept(o, wanted):
    return o.select(np.array([wanted(key) for key in o.keys], dtype=bool))


# --- what a row means


def test_the_jacobian_is_the_slope_of_the_prediction():
    s = simulated(systems="GE", air=Air(total=True))
    options_ = GnssOptions(noise=replace(PPP_RTK, gradient_m=0.01, code_bias_m=0.2))
    update = updates(PppRtk(options_), s.epochs[:3])[-1]
    x, names = update.prior.mean, update.prior.layout.names
    ambiguity = {k: n for k in update.keys for n in names if n.startswith(f"amb:{k}:")}

    def predicted(mean):
        """Written on its own: each state by its name."""
        of = dict(zip(names, mean, strict=True))
        rows = uncombined_rows(s.epochs[2], mean[:3], options_)
        clock = next(v for n, v in of.items() if n.startswith("clk:"))
        out = []
        for i, key in enumerate(rows.keys):
            kind, sat = ("product", key[5:]) if key[:4] in ("iono", "trop") else (key[4], key[:3])
            air = rows.wet[i] * of["zwd"] + rows.north[i] * of["grad:n"] + rows.east[i] * of["grad:e"]
            if key == "trop:ZTD":
                out.append(rows.predicted[i] + of["zwd"] + of["prod:trop"])
            elif kind == "product":
                out.append(of[f"ion:{sat}"] + of[f"off:{sat[0]}"] + of[f"prod:{key}"])
            else:
                band = {"1": 1.0, "2": (154 / 120) ** 2, "5": (154 / 115) ** 2}[key[5]]
                ionosphere = band * of[f"ion:{sat}"] * (1.0 if kind == "C" else -1.0)
                own = of.get(f"isb:{sat[0]}", 0.0) + of.get(f"bias:{key}", 0.0)
                out.append(rows.predicted[i] + air + clock + own + ionosphere + of.get(ambiguity.get(key), 0.0))
        return np.array(out)

    for i, name in enumerate(names):
        h, e = (10.0 if name.startswith("pos") else 1.0), np.eye(len(x))[i]
        slope = (predicted(x + h * e) - predicted(x - h * e)) / (2.0 * h)
        # the dry delay falls with height, by 3e-4 towards the zenith, 1.5e-3 at the mask
        np.testing.assert_allclose(update.H[:, i], slope, atol=1.6e-3, err_msg=name)
    rows = uncombined_rows(s.epochs[2], x[:3], options_)
    assert update.keys == rows.keys
    np.testing.assert_allclose(update.nu, rows.y - predicted(x), atol=1e-6)


def test_without_noise_slant_delays_and_ambiguities_are_the_true_ones():
    s = simulated(60, noise=QUIET, air=NO_PRODUCTS)
    found = updates(rtk(replace(QUIET, code_white_m=0.05, carrier_m=1e-4), motion="static"), s.epochs)
    state = found[-1].posterior
    assert np.linalg.norm(enu(found)[-1]) < 0.01
    assert state.mean[state.layout.index["zwd"]] == pytest.approx(s.wet_m[-1], abs=2e-3)
    sats = [n[4:] for n in state.layout.names if n.startswith("ion:")]
    assert len(sats) > 12
    for sat in sats:
        at = s.sats.index(sat)
        assert state.mean[state.layout.index[f"ion:{sat}"]] == pytest.approx(s.slant_m[-1, at], abs=0.02)
        ambiguities = state.layout.block("amb")
        own = [i for i in ambiguities if state.layout.names[i][4:7] == sat]
        assert [state.layout.names[i][8:10] for i in own] == ["L1", "L2" if sat[0] == "G" else "L5"]
        np.testing.assert_allclose(state.mean[own], s.ambiguity_m[-1, at], atol=0.05)


@pytest.mark.parametrize("noise", [PPP_RTK_PUBLISHED, PPP_RTK], ids=["white", "correlated"])
@pytest.mark.parametrize("air", [Air(), NO_PRODUCTS], ids=["products", "none"])
def test_errors_are_as_large_as_said(noise, air):
    errors = []
    for seed in range(8):
        s = simulated(30, noise=noise, air=air, seed=20 + seed)
        for u in updates(rtk(noise), s.epochs)[4::25]:
            at = u.posterior.mean[:3] - PLACE
            errors.append(at @ np.linalg.solve(u.posterior.P[:3, :3], at))
    # 16 draws of three: two epochs of a run are apart
    low, high = chi2.ppf([1e-4, 1.0 - 1e-4], 3 * len(errors))
    assert low < sum(errors) < high


def test_white_innovations_are_as_large_as_their_covariance():
    total = dof = 0.0
    for seed in range(4):
        s = simulated(40, noise=PPP_RTK_PUBLISHED, seed=40 + seed)
        for u in updates(rtk(PPP_RTK_PUBLISHED, motion="static"), s.epochs)[1:]:
            total, dof = total + float(u.white @ u.white), dof + len(u.white) - u.consumed
    low, high = chi2.ppf([5e-5, 1.0 - 5e-5], dof) / dof
    assert low < total / dof < high, (total / dof, dof)


# --- products


def test_products_make_the_start_sharp():
    spread = []
    for air in (NO_PRODUCTS, Air(wet_m=0.0), Air()):
        first = updates(rtk(), simulated(3, air=air).epochs)[0].posterior
        spread.append(np.sqrt(np.diagonal(enu_rotation(PLACE) @ first.P[:3, :3] @ enu_rotation(PLACE).T)))
    none, slants, both = spread
    assert (both < 0.4 * none).all()
    assert both[2] < 0.8 * slants[2]


def differenced(update: Update, references: dict[str, str], diagonal: bool = False) -> np.ndarray:
    """Return the covariance of the position where products are between-satellite differences, no offsets."""
    prior, names = update.prior, update.prior.layout.names
    states = [i for i, n in enumerate(names) if not n.startswith("off:")]
    A = []
    for i, key in enumerate(update.keys):
        line = np.eye(len(update.keys))[i]
        if key.startswith("iono:"):
            if key[5:] in references.values():
                continue
            line[row(update, f"iono:{references[key[5]]}")] = -1.0
        A.append(line)
    A = np.array(A)
    H, R = (A @ update.H)[:, states], A @ update.R @ A.T
    assert not (A @ update.H)[:, [i for i in range(len(names)) if i not in states]].any()
    R = np.diag(np.diagonal(R)) if diagonal else R
    P = prior.P[np.ix_(states, states)]
    K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
    I_KH = np.eye(len(states)) - K @ H
    return (I_KH @ P @ I_KH.T + K @ R @ K.T)[:3, :3]


@pytest.mark.parametrize("systems", ["G", "GE"])
def test_offsets_are_differences_with_their_full_covariance_whatever_the_reference(systems):
    s = simulated(3, noise=PPP_RTK_PUBLISHED, systems=systems)
    for update in updates(rtk(PPP_RTK_PUBLISHED), s.epochs):
        sats = [k[5:] for k in update.keys if k.startswith("iono:")]
        ours = np.sqrt(np.diagonal(update.posterior.P[:3, :3]))
        second = next((x for x in sats if x[0] == "E"), "")
        choices = [{"G": g, "E": second} for g in sats if g[0] == "G"]
        full = [np.sqrt(np.diagonal(differenced(update, c))) for c in choices]
        np.testing.assert_allclose(full, np.tile(ours, (len(full), 1)), atol=1e-9)


def test_differences_taken_for_independent_are_wrong_by_percents_and_depend_on_the_reference():
    s = simulated(3, noise=PPP_RTK_PUBLISHED)
    update = updates(rtk(PPP_RTK_PUBLISHED), s.epochs)[0]
    sats = [k[5:] for k in update.keys if k.startswith("iono:")]
    ours = np.sqrt(np.diagonal(update.posterior.P[:3, :3]))
    galileo = next(x for x in sats if x[0] == "E")
    wrong = np.array([
        np.sqrt(np.diagonal(differenced(update, {"G": g, "E": galileo}, diagonal=True))) / ours - 1.0
        for g in sats if g[0] == "G"
    ])  # fmt: skip
    assert np.abs(wrong).max() > 0.03
    assert np.ptp(wrong, axis=0).max() > 0.005


def test_a_total_delay_says_what_a_wet_one_does():
    wet, total = (updates(rtk(), simulated(6, air=Air(total=t)).epochs) for t in (False, True))
    assert "trop:ZTD" in total[-1].keys
    np.testing.assert_allclose(total[-1].posterior.mean[:3], wet[-1].posterior.mean[:3], atol=1e-4)


def test_the_error_of_a_product_is_a_gauss_markov_process_of_the_stated_size():
    s = simulated(30)
    found = updates(rtk(), s.epochs)
    keep = np.exp(-STEP / PPP_RTK.product_tau_s)
    for u in found[1:]:
        names = u.prior.layout.names
        for i in u.prior.layout.block("prod"):
            sigma = 0.1 if names[i] == "prod:trop" else 0.2
            if not u.F[i].any():
                assert u.Q[i, i] == pytest.approx(sigma**2)
                continue
            assert u.F[i].sum() == pytest.approx(keep)
            assert u.Q[i, i] == pytest.approx(sigma**2 * (1.0 - keep**2))
            assert u.posterior.P[i, i] < sigma**2 * (1.0 + 1e-9)
    last = found[-1]
    at = row(last, "trop:ZWD")
    assert np.sqrt(last.R[at, at]) == pytest.approx(0.1 * PPP_RTK.product_white)
    white = updates(rtk(PPP_RTK_PUBLISHED), s.epochs[:3])[-1]
    at = row(white, "trop:ZWD")
    assert np.sqrt(white.R[at, at]) == pytest.approx(0.1)
    assert not len(white.prior.layout.block("prod"))


def test_products_that_last_are_not_averaged_away():
    s = simulated(40, noise=PPP_RTK)
    ours, white = (
        updates(rtk(replace(PPP_RTK, product_tau_s=tau)), s.epochs)[20].posterior.P for tau in (1800.0, 0.0)
    )
    assert np.trace(ours[:3, :3]) > 1.2 * np.trace(white[:3, :3])


def test_a_product_that_pauses_keeps_its_error():
    s = simulated(12)
    paused = edited(s.epochs, "atmosphere", lambda k, o: kept(o, lambda key: k not in (6, 7)))
    found = updates(rtk(), paused)
    names = found[7].prior.layout.names
    assert [k for k in found[7].keys if k.startswith(("iono", "trop"))] == []
    assert "prod:trop" in names
    assert {n[10:] for n in names if n.startswith("prod:iono:")} == {n[4:] for n in names if n[:4] == "ion:"}
    assert not len(found[7].prior.layout.block("off"))
    at = found[8].prior.layout.index["prod:iono:" + groups(paused[8])[0]]
    assert found[8].F[at].any()


def test_unusable_products_are_left_out_and_the_rest_is_used():
    s = simulated(4)

    def spoiled(k, o):
        y, sigma = o.y.copy(), o.sigma.copy()
        y[0], sigma[1] = np.nan, 0.0
        return replace(o, y=y, sigma=sigma, keys=(*o.keys[:2], "iono:G99", *o.keys[3:]))

    found = updates(rtk(), edited(s.epochs, "atmosphere", spoiled))[-1]
    there = [k for k in found.keys if k.startswith("iono:")]
    seen = {k[:3] for k in found.keys if k[4:5] == "C"}
    assert {k[5:] for k in there} <= seen
    assert len(there) == len(seen) - len(set(k[5:] for k in s.epochs[-1].observations[2].keys[:3]) & seen)
    assert np.isfinite(found.nu).all()


def test_products_alone_do_not_make_a_position():
    s = simulated(6)
    alone = [e if k < 4 else replace(e, observations=e.observations[2:]) for k, e in enumerate(s.epochs)]
    assert updates(rtk(), alone)[-1].reason == "0 satellites do not determine a position"
    still = updates(rtk(motion="static"), alone)[-1]
    assert (still.keys, still.reason) == ((), "no satellite above the mask")


# --- correlated noise


def test_code_and_carrier_weigh_less_where_a_satellite_goes_on():
    s, sat = simulated(12), "G07"
    late = [without(e, [sat]) if k < 8 else e for k, e in enumerate(s.epochs)]
    found = updates(rtk(), late)
    grown = 1.0 - 0.7 + 0.7 * 2.0 * 60.0 / STEP
    plain = updates(rtk(replace(PPP_RTK, correlated_part=0.0)), late)

    def ratio(k, key):
        at = row(found[k], key)
        return found[k].R[at, at] / plain[k].R[at, at]

    other = next(g for g in groups(s.epochs[8]) if g != sat and g[0] == "G")
    for signal in ("C1C", "C2W", "L1C", "L2W"):
        assert ratio(8, f"{sat}:{signal}") == pytest.approx(1.0, rel=1e-4)
        assert ratio(9, f"{sat}:{signal}") == pytest.approx(grown, rel=1e-4)
        assert ratio(8, f"{other}:{signal}") == pytest.approx(grown, rel=1e-4)
    assert ratio(8, "trop:ZWD") == pytest.approx(1.0)
    # after 300 s nothing is correlated any more
    apart = updates(rtk(), [late[0], late[10]])[-1]
    at = row(apart, f"{other}:C1C")
    assert apart.R[at, at] == pytest.approx(plain[10].R[at, at], rel=1e-4)


def test_a_new_arc_is_not_inflated_but_its_code_is():
    s = simulated(12)

    def second(k, o):
        arc = np.array([2 if key.startswith("G07") and k >= 8 else 1 for key in o.keys])
        return replace(o, aux={**o.aux, "arc": arc})

    cut = edited(s.epochs, "carrier", second)
    found, plain = (updates(rtk(n), cut)[8] for n in (PPP_RTK, replace(PPP_RTK, correlated_part=0.0)))
    ratio = {k: found.R[i, i] / plain.R[i, i] for i, k in enumerate(found.keys)}
    assert ratio["G07:L1C"] == pytest.approx(1.0, rel=1e-4)
    assert ratio["G07:C1C"] == pytest.approx(0.3 + 0.7 * 4.0, rel=1e-4)
    assert "amb:G07:L1C:2" in found.prior.layout.names
    assert found.consumed == updates(rtk(), s.epochs)[8].consumed + 2


# --- births


def test_what_the_data_initialise_is_counted():
    s, sat = simulated(12), "G07"
    late = [without(e, [sat]) if k < 8 else e for k, e in enumerate(s.epochs)]
    found = updates(rtk(), late)
    n = len([k for k in found[0].keys if k.startswith("iono:")])
    assert found[0].consumed == 3 + 1 + 1 + n + 2 * n + 2
    assert found[5].consumed == 1 + 2  # the clock and what products share, each epoch
    assert found[8].consumed == 1 + 2 + 3  # a slant delay and two ambiguities
    without_products = updates(rtk(), simulated(3, air=NO_PRODUCTS).epochs)
    assert without_products[2].consumed == 1


def test_the_fix_of_a_start_is_made_of_ionosphere_free_code():
    s = simulated(2, noise=QUIET, air=Air(zenith_m=60.0))
    free = ionosphere_free(s.epochs[0])
    code = free.sensor("code")
    assert all("+" in k for k in code.keys)
    assert not code.aux["iono_factor"].any()
    first = rtk(QUIET).predict(State.empty(), s.epochs[0])
    assert np.linalg.norm(first.state.mean[:3] - PLACE) < 3.0  # the wet delay is not in it


def test_one_frequency_with_a_product_has_a_slant_delay_and_without_has_none():
    s = simulated(8)
    single = edited(
        edited(s.epochs, "code", lambda k, o: kept(o, lambda key: key[:3] != "G07" or key[5] == "1")),
        "carrier", lambda k, o: kept(o, lambda key: key[:3] != "G07" or key[5] == "1"),
    )  # fmt: skip
    told = updates(rtk(), single)
    assert "ion:G07" in told[-1].prior.layout.names
    error = np.linalg.norm(enu(told), axis=1).max()
    assert error < 1.5
    untold = edited(single, "atmosphere", lambda k, o: kept(o, lambda key: key != "iono:G07"))
    found = updates(rtk(), untold)[-1]
    assert "ion:G07" not in found.prior.layout.names
    assert "G07:C1C" in found.keys


def test_one_frequency_alone_has_the_broadcast_ionosphere():
    epochs = log(6)
    nav = navigation()
    with_model, without_model = (
        uncombined_rows(epochs[3], PLACE, options(nav, klobuchar=k))
        for k in (nav.klobuchar["G"], None)
    )  # fmt: skip
    delay = with_model.predicted - without_model.predicted
    signs = np.where(with_model.names.carrier, -1.0, 1.0)
    assert ((delay * signs > 0.5) & (delay * signs < 60.0)).all()
    assert not any(n.startswith("ion:") for n in with_model.names.ionosphere)


# --- exclusion


def same_for_the_others(a: Update, b: Update) -> None:
    """Compare all but the errors of products that pause: nobody states how large they are then."""
    names = [n for n in a.posterior.layout.names if n in b.posterior.layout.index and n[:4] != "prod"]
    i, j = ([u.posterior.layout.index[n] for n in names] for u in (a, b))
    sigma = np.sqrt(np.diagonal(a.posterior.P)[i])
    np.testing.assert_allclose((a.posterior.mean[i] - b.posterior.mean[j]) / sigma, 0.0, atol=1e-5)
    np.testing.assert_allclose(np.sqrt(np.diagonal(b.posterior.P)[j]) / sigma, 1.0, atol=1e-6)


def without_products(epoch: Epoch, kind: str) -> Epoch:
    return edited([epoch], "atmosphere", lambda k, o: kept(o, lambda key: not key.startswith(kind)))[0]


@pytest.mark.parametrize("kind", ["iono", "trop"])
def test_products_left_out_are_absent_ones(kind):
    s = simulated(20)
    out = updates(rtk(), s.epochs, from_epoch(12, kind))
    away = updates(rtk(), [without_products(e, kind) if k >= 12 else e for k, e in enumerate(s.epochs)])
    for a, b in zip(out[10:], away[10:], strict=True):
        same_for_the_others(a, b)
        assert set(a.keys) == set(b.keys)
        assert a.consumed == b.consumed
    assert out[-1].excluded == (kind,)
    assert all(k.startswith(kind) for k in out[-1].spare_keys)
    assert np.isfinite(out[-1].spare_nu).all()
    assert (out[-1].spare_var > 0.0).all()
    assert not any("~" in n for n in out[-1].posterior.layout.names)


def test_a_satellite_left_out_takes_its_product_along():
    s = simulated(20)
    out = updates(rtk(), s.epochs, from_epoch(12, "G07"))
    gone = [
        edited([without(e, ["G07"])], "atmosphere", lambda k, o: kept(o, lambda key: key != "iono:G07"))[0]
        if k >= 12 else e for k, e in enumerate(s.epochs)
    ]  # fmt: skip
    for a, b in zip(out, updates(rtk(), gone), strict=True):
        assert set(a.keys) == set(b.keys)
        same_for_the_others(a, b)
    assert out[-1].excluded == ("G07",)
    assert set(out[-1].spare_keys) == {"G07:C1C", "G07:C2W", "G07:L1C", "G07:L2W", "iono:G07"}
    assert (out[-1].spare_var > 0.0).all()


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        ("G07:L bias 20 m 300:", (0.0, 0.0)),  # a slip: from then on carriers go on as they were
        ("G07:L2W bias 20 m 300:", (0.0, 0.0)),
        ("G07:* ramp 0.01 m/s 300:", (2.4, 2.4)),  # what grew in the 240 s after its exclusion
        ("G07:L2W ramp 0.01 m/s 300:", (0.0, 2.4)),
    ],
)
def test_the_carriers_of_a_satellite_left_out_show_what_came_after(fault, expected):
    s = simulated(20)
    faulty = apply_faults(s.epochs, [parse_fault(fault)])
    found = updates(rtk(motion="static"), faulty, from_epoch(10, "G07"))

    def spare(u, key):
        i = u.spare_keys.index(key)
        return float(u.spare_nu[i]), float(np.sqrt(u.spare_var[i]))

    for key, size in zip(("G07:L1C", "G07:L2W"), expected, strict=True):
        assert spare(found[10], key)[0] == pytest.approx(0.0, abs=1e-6)  # born with it
        residual, sigma = spare(found[18], key)
        assert sigma < 0.12  # the slant delay walks 3 mm/sqrt(s), times 1.65 on the second band
        assert residual == pytest.approx(size, abs=4.0 * sigma)
    assert {"amb:G07:L1C:1~", "amb:G07:L2W:1~"} <= set(found[18].posterior.layout.names)


def test_a_satellite_that_returns_needs_no_reset():
    s = simulated(30)
    found = updates(rtk(motion="static"), s.epochs, lambda k: frozenset({"G07"} if 10 <= k < 18 else ()))
    assert "G07:L1C" in found[18].keys
    assert found[18].F[found[18].prior.layout.index["amb:G07:L1C:1"]].any()
    assert found[18].consumed == found[5].consumed
    normal = found[18].nu / np.sqrt(np.diagonal(found[18].S))
    assert np.abs(normal[[k.startswith("G07") for k in found[18].keys]]).max() < 4.0


def test_residuals_of_all_products_left_out_show_the_one_that_is_wrong():
    s = simulated(30)

    def wrong(k, o):
        return replace(o, y=o.y + 3.0 * np.array([key == "iono:G07" for key in o.keys]) * (k >= 15))

    found = updates(rtk(), edited(s.epochs, "atmosphere", wrong), from_epoch(12, "iono"))
    normal = np.abs(found[20].spare_nu) / np.sqrt(found[20].spare_var)
    assert found[20].spare_keys[int(normal.argmax())] == "iono:G07"
    assert normal.max() > 5.0
    before = np.abs(found[14].spare_nu) / np.sqrt(found[14].spare_var)
    assert before.max() < 4.0


def test_a_start_without_a_satellite_is_not_made_from_it():
    s = simulated(3)
    mixed = edited(
        s.epochs, "code", lambda k, o: replace(o, y=o.y + 5e3 * np.array([x[:3] == "G07" for x in o.keys]))
    )
    found = updates(rtk(), mixed, from_epoch(0, "G07"))
    away = updates(rtk(), [without_everywhere(e, "G07") for e in s.epochs])
    np.testing.assert_allclose(found[0].posterior.mean[:3], away[0].posterior.mean[:3], atol=1e-3)


def without_everywhere(epoch: Epoch, sat: str) -> Epoch:
    return edited([without(epoch, [sat])], "atmosphere", lambda k, o: kept(o, lambda x: x != f"iono:{sat}"))[0]
