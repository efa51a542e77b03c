"""Products of the atmosphere: which sample holds when, and how they come to the epochs of a log."""

import pickle
import time
from dataclasses import replace

import numpy as np
import pytest

from gnss_logs import SECOND, START, groups, log
from pntegrity.physics.atmosphere_products import AtmosphereProducts, Samples, metres_per_tecu, with_products
from pntegrity.records import Observation

L1 = 1575.42e6


def samples(n=4, step=30, value=10.0, sigma=0.5, t0=START):
    t_ns = t0 + step * SECOND * np.arange(n, dtype=np.int64)
    return Samples(t_ns, value + np.arange(n), np.full(n, sigma))


def products(sats, **facts):
    return AtmosphereProducts({s: samples() for s in sats}, samples(value=0.1, sigma=0.01), **facts)


def test_the_last_sample_counts_and_never_one_of_the_future():
    found = [products(["G05"]).at(START + s * SECOND, 45.0) for s in (-1, 0, 29, 30, 119, 135, 136)]
    assert [v.stec_tecu.get("G05", (None,))[0] for v in found] == [None, 10.0, 10.0, 11.0, 13.0, 13.0, None]
    assert found[0].missing == ("iono:G05", "trop:ZWD")
    assert found[-1].stale == ("iono:G05", "trop:ZWD")
    assert found[0].troposphere_m is None
    assert found[3].troposphere_m == (1.1, 0.01)


def test_by_default_two_intervals_or_a_minute_are_not_too_old():
    assert products(["G05"]).interval_s == 30.0
    assert products(["G05"]).max_age_s == 60.0
    assert AtmosphereProducts({"G05": samples(step=300)}).max_age_s == 600.0
    assert AtmosphereProducts({"G05": samples(1)}).max_age_s == 60.0


def test_unusable_samples_are_left_out_and_counted_and_the_rest_is_in_order():
    t_ns = START + SECOND * np.array([60, 0, 30, 90, 120, 150, 30])
    value = np.array([3.0, 1.0, 2.0, np.nan, 5.0, 6.0, 2.5])
    sigma = np.array([0.1, 0.1, 0.1, 0.1, 0.0, np.inf, 0.1])
    made = AtmosphereProducts({"G05": (t_ns, value, sigma), "G07": (t_ns[:1], value[3:4], sigma[:1])})
    assert list(made.ionosphere) == ["G05"]
    np.testing.assert_array_equal(made.ionosphere["G05"][0], START + SECOND * np.array([0, 30, 60]))
    np.testing.assert_array_equal(made.ionosphere["G05"][1], [1.0, 2.5, 3.0])
    assert made.notes[0].startswith("4 samples left out: value or sigma is not finite")
    assert made.notes[1].startswith("1 samples left out: another one")
    assert replace(made, source="again").notes == made.notes


def test_what_does_not_fit_is_refused():
    with pytest.raises(ValueError, match="must be as long"):
        AtmosphereProducts({"G05": (np.zeros(2, dtype=np.int64), np.zeros(1), np.ones(2))})
    with pytest.raises(ValueError, match="ZWD or ZTD"):
        AtmosphereProducts(troposphere_kind="zwd")


def test_products_can_be_pickled_and_not_changed():
    made = products(["G05"], source="here", self_derived=True, latency_s=30.0)
    again = pickle.loads(pickle.dumps(made))
    np.testing.assert_array_equal(again.ionosphere["G05"], made.ionosphere["G05"])
    assert (again.source, again.self_derived, again.latency_s) == ("here", True, 30.0)
    with pytest.raises(ValueError, match="read-only"):
        made.ionosphere["G05"][1][0] = 0.0


# --- to the epochs


def test_rows_are_slant_delays_on_the_first_frequency_and_the_zenith_delay():
    (epoch,) = log(1, systems="GC")
    sats = groups(epoch)
    (out,), notes = with_products([epoch], products(sats, troposphere_kind="ZTD"))
    o, code = out.sensor("atmosphere"), epoch.sensor("code")
    assert o.keys == ("trop:ZTD", *(f"iono:{s}" for s in sats))
    np.testing.assert_allclose(o.y[1:], 40.3082e16 / code.aux["freq_hz"] ** 2 * 10.0, rtol=1e-12)
    np.testing.assert_allclose(o.sigma[1:], 40.3082e16 / code.aux["freq_hz"] ** 2 * 0.5, rtol=1e-12)
    assert (o.y[0], o.sigma[0]) == (0.1, 0.01)
    assert notes == ()
    assert metres_per_tecu(L1) == pytest.approx(0.16241, abs=2e-5)  # 1 TECU delays L1 by 16.24 cm


def test_of_two_frequencies_the_first_counts_whatever_the_order_of_the_rows():
    (epoch,) = log(1)
    code = epoch.sensor("code")
    second = replace(
        code,
        keys=tuple(k.replace("C1", "C5") for k in code.keys),
        aux=code.aux | {"freq_hz": code.aux["freq_hz"] * 0.75, "iono_factor": np.full(len(code.keys), 1.78)},
    )
    both = Observation(
        "code", code.t_ns, second.keys + code.keys, np.concatenate([second.y, code.y]),
        aux={k: np.concatenate([second.aux[k], v]) for k, v in code.aux.items()},
    )  # fmt: skip
    (one,), _ = with_products([epoch], products(groups(epoch)))
    (two,), notes = with_products([replace(epoch, observations=(both,))], products(groups(epoch)))
    assert sorted(one.sensor("atmosphere").keys) == sorted(two.sensor("atmosphere").keys)
    assert set(two.sensor("atmosphere").y) == set(one.sensor("atmosphere").y)
    assert notes == ()
    (alone,), notes = with_products([replace(epoch, observations=(second,))], products(groups(epoch)))
    assert alone.sensor("atmosphere").keys == ("trop:ZWD",)
    assert "no code of the first frequency" in notes[0]


def test_where_they_come_from_is_told_and_that_they_are_self_derived():
    (epoch,) = log(1)
    made = products(groups(epoch), source="OPEC")
    assert with_products([epoch], made)[1] == ("products of the atmosphere: OPEC",)
    (note,) = with_products([epoch], replace(made, self_derived=True))[1]
    assert "OPEC, made of a receiver's own data" in note


def test_every_epoch_gets_what_holds_at_its_own_time():
    epochs = log(100, systems="G")
    made = products(groups(epochs[0]))
    out, _ = with_products(epochs, made, 20.0)
    for k, e in enumerate(out):
        valid, o = made.at(e.t_ns, 20.0), e.sensor("atmosphere")
        if not valid.stec_tecu:
            assert o is None
            assert k % 30 > 20
            continue
        scale = metres_per_tecu(L1)
        assert o.y[1:] == pytest.approx(scale * (10 + k // 30))
        assert o.aux["age_s"] == pytest.approx(k % 30)
        assert o.t_ns == e.t_ns


def test_what_is_missing_or_stale_is_counted_by_cause():
    epochs = log(100, systems="G")
    first, second, *rest = groups(epochs[0])
    made = AtmosphereProducts({first: samples(2), **{s: samples(5) for s in rest}}, samples(2))
    out, notes = with_products(epochs, made, 30.0)
    assert f"no ionosphere product: {second} 100 of 100 epochs" in notes
    assert f"ionosphere product older than 30 s: {first} 39 of 100 epochs" in notes
    assert "troposphere product older than 30 s: 39 of 100 epochs" in notes
    assert not any(second in o.keys for e in out for o in e.observations if o.sensor == "atmosphere")
    late = AtmosphereProducts({s: samples(5, t0=START + 10 * SECOND) for s in rest})
    _, notes = with_products(epochs, late)
    assert "no troposphere product: 100 of 100 epochs" in notes
    assert "no product of the atmosphere at all: 10 of 100 epochs" in notes
    assert any(n.startswith("no ionosphere product: ") and f"{rest[0]} 10" in n for n in notes)


def test_epochs_without_code_get_nothing_and_old_products_are_replaced():
    epochs = log(3)
    bare = replace(epochs[1], observations=())
    made = products(groups(epochs[0]))
    once, _ = with_products([epochs[0], bare, epochs[2]], made)
    twice, _ = with_products(once, made)
    assert [len(e.observations) for e in once] == [len(e.observations) for e in twice]
    assert once[1].observations == ()
    assert with_products([], made) == ([], ())
    assert with_products([bare], made)[0][0].observations == ()


def test_a_quarter_of_an_hour_takes_no_time():
    epochs = log(900, systems="GREC")
    made = AtmosphereProducts({s: samples(31) for s in {g for e in epochs for g in groups(e)}}, samples(31))
    with_products(epochs[:9], made)
    best = min(_seconds(epochs, made) for _ in range(3))
    assert best < 0.2, best  # measured 0.02


def _seconds(epochs, made):
    start = time.perf_counter()
    with_products(epochs, made)
    return time.perf_counter() - start
