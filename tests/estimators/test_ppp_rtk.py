"""PPP-RTK on simulated epochs: what rows mean, truth, products and their references, correlation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rtk_logs import (
    NO_PRODUCTS,
    QUIET,
    STEP,
    edited,
    enu,
    kept,
    row,
    rtk,
    simulated,
    updates,
)
from scipy.stats import chi2

from gnss_logs import PLACE, groups, without
from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators._uncombined import uncombined_rows
from pntegrity.estimators.ppp_rtk import PppRtk
from pntegrity.physics.frames import enu_rotation
from pntegrity.records import Update
from pntegrity.sensors.noise import PPP_RTK, PPP_RTK_PUBLISHED
from pntegrity.simulate.uncombined import Air

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
                out.append(
                    rows.predicted[i] + air + clock + own + ionosphere + of.get(ambiguity.get(key), 0.0)
                )
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
    assert len(there) == len(seen) - len({k[5:] for k in s.epochs[-1].observations[2].keys[:3]} & seen)
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
