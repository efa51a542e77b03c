"""PPP-RTK on simulated epochs: births, one frequency alone, exclusion and return."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rtk_logs import (
    NO_PRODUCTS,
    QUIET,
    absent,
    edited,
    enu,
    from_epoch,
    kept,
    rtk,
    simulated,
    updates,
    without_products,
)

from gnss_logs import PLACE, log, navigation, options, without
from pntegrity.estimators._uncombined import ionosphere_free, uncombined_rows
from pntegrity.records import State, Update
from pntegrity.simulate.faults import apply_faults, parse_fault
from pntegrity.simulate.uncombined import Air

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
    gone = [absent(e, "G07") if k >= 12 else e for k, e in enumerate(s.epochs)]
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
    away = updates(rtk(), [absent(e, "G07") for e in s.epochs])
    np.testing.assert_allclose(found[0].posterior.mean[:3], away[0].posterior.mean[:3], atol=1e-3)
