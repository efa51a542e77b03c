"""Levels while products of the atmosphere stop, come late or lack a satellite: finite or inf with a
reason.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from rtk_logs import edited, kept, rtk, simulated, without_products

from gnss_logs import PLACE, groups, only, run, without
from pntegrity.bounds.ism import Ism
from pntegrity.monitors.separation import Separation
from pntegrity.pipeline import Outcome
from pntegrity.records import Bound, Epoch

N = 30


def log(n: int = N) -> list[Epoch]:
    return list(simulated(40).epochs[:n])


def judged(epochs: Sequence[Epoch], ism: Ism | None = None) -> list[Outcome]:
    return run(rtk(), [Separation(ism=ism or Ism())], epochs)


def whole(outcomes: Sequence[Outcome]) -> list[Bound | None]:
    """Return the bounds, after a look at each: no nan, no level without a reason, never ok without a test."""
    out = []
    for o in outcomes:
        (verdict,) = o.verdicts
        bound = verdict.bound
        out.append(bound)
        if verdict.status == "unavailable":
            assert verdict.reason
            assert o.status != "ok"
        if bound is None:
            assert verdict.status == "unavailable"
            continue
        found = [bound.east_m, bound.north_m, bound.up_m, *bound.sigma_m, *bound.smallest_m]
        assert not np.isnan(found).any()
        assert np.isfinite([bound.hpl_m, bound.vpl_m]).all() or bound.reason
    return out


def excluded(outcomes: Sequence[Outcome]) -> set[str]:
    return {e.group for o in outcomes for e in o.exclusions}


def bounds(epochs: Sequence[Epoch], ism: Ism | None = None) -> list[Bound]:
    outcomes = judged(epochs, ism)
    found = whole(outcomes)
    assert not excluded(outcomes)
    assert all(b is not None for b in found)
    return [b for b in found if b is not None]


CLEAN: list[Bound] = []


def clean() -> list[Bound]:
    if not CLEAN:
        CLEAN.extend(bounds(log()))
    return CLEAN


def test_without_products_the_position_is_less_certain_and_nothing_else_happens() -> None:
    none = bounds([without_products(e, "iono", "trop") for e in log()])
    assert all(
        np.array(a.sigma_m).sum() > np.array(b.sigma_m).sum() for a, b in zip(none, clean(), strict=True)
    )
    assert {b.modes for b in none} == {clean()[0].modes - 2}


@pytest.mark.parametrize("which", [("iono",), ("trop",), ("iono", "trop")])
def test_a_gap_of_the_products_is_passed_over(which: tuple[str, ...]) -> None:
    epochs = [without_products(e, *which) if 10 <= k < 20 else e for k, e in enumerate(log())]
    found = bounds(epochs)
    # what they told before is remembered, and levels come back to those without a gap
    assert found[19].hpl_m >= 0.99 * clean()[19].hpl_m
    assert found[-1].hpl_m == pytest.approx(clean()[-1].hpl_m, rel=0.1)
    assert all(b.since_ns == epochs[0].t_ns for b in found)


def test_a_satellite_without_a_product_is_monitored_all_the_same() -> None:
    epochs = [without_products(e, "iono:G07") for e in log()]
    outcomes = judged(epochs)
    whole(outcomes)
    memory = {v.bound.modes for o in outcomes for v in o.verdicts if v.bound is not None}
    assert memory == {b.modes for b in clean()}
    shown = edited(epochs, "code", lambda k, o: shifted(o, "G07", 30.0 * (k >= 20)))
    shown = edited(shown, "carrier", lambda k, o: shifted(o, "G07", 30.0 * (k >= 20)))
    assert excluded(judged(shown)) == {"G07"}


def shifted(o, group: str, by: float):
    return replace(o, y=o.y + by * np.array([k.startswith(group) for k in o.keys]))


def test_stale_products_that_stand_still_do_not_make_levels_a_lie() -> None:
    # GIVEN products that repeat those of the tenth epoch for ten minutes
    epochs = log()
    old = {
        k: y
        for o in epochs[10].observations
        if o.sensor == "atmosphere"
        for k, y in zip(o.keys, o.y, strict=True)
    }

    def stale(k: int, o):
        o = kept(o, lambda key: key in old or k <= 10)
        return replace(o, y=np.array([old[key] for key in o.keys])) if k > 10 else o

    outcomes = judged(edited(epochs, "atmosphere", stale))
    for o, bound in zip(outcomes, whole(outcomes), strict=True):
        error = o.update.posterior.block("pos")[0] - PLACE
        assert bound is not None
        assert np.linalg.norm(error) < np.hypot(bound.hpl_m, bound.vpl_m)


def test_a_constellation_that_vanishes_leaves_the_other_and_comes_back() -> None:
    epochs = log()
    gone = [g for g in groups(epochs[0]) if g[0] == "E"]
    shown = [drop(e, gone) if 10 <= k < 20 else e for k, e in enumerate(epochs)]
    found = bounds(shown)
    assert all(b.hpl_m >= a.hpl_m - 1e-9 for a, b in zip(clean()[10:20], found[10:20], strict=True))
    assert np.isfinite([b.hpl_m for b in found]).all()


def drop(epoch: Epoch, gone: Sequence[str]) -> Epoch:
    return without_products(without(epoch, gone), *(f"iono:{g}" for g in gone))


def test_a_constellation_that_vanishes_where_constellations_may_fail_leaves_what_it_knew() -> None:
    epochs = log()
    gone = [g for g in groups(epochs[0]) if g[0] == "E"]
    shown = [drop(e, gone) if k >= 15 else e for k, e in enumerate(epochs[:25])]
    ism = Ism(p_constellation=1e-5)
    found = whole(run(rtk(), [Separation(ism=ism, pairs=False)], shown, exclude=False))
    assert found[14] is not None
    assert np.isfinite(found[14].hpl_m)
    assert found[-1] is not None
    # without GPS there is only the position of before, from which one may have walked away
    assert found[-1].hpl_m > 100.0 * found[14].hpl_m
    assert set(found[-1].dominant) == {"G"}


@pytest.mark.parametrize("left", [0, 1, 2, 3, 4])
def test_an_outage_is_unavailable_or_a_level_and_ends(left: int) -> None:
    epochs = log()
    few = groups(epochs[0])[:left]
    shown = [short(e, few) if 10 <= k < 14 else e for k, e in enumerate(epochs)]
    outcomes = judged(shown)
    found = whole(outcomes)
    assert found[-1] is not None
    assert np.isfinite(found[-1].hpl_m)
    for o, bound in zip(outcomes[10:14], found[10:14], strict=True):
        assert o.status in ("unavailable", "alert") or (
            bound is not None and (np.isfinite(bound.hpl_m) or bound.reason)
        )


def short(epoch: Epoch, few: Sequence[str]) -> Epoch:
    """Return the epoch with a few satellites and their products."""
    seen = [o for o in only(epoch, few).observations if o.sensor != "atmosphere"]
    products = [
        kept(o, lambda k: k.startswith("trop") or k.partition(":")[2] in few)
        for o in epoch.observations
        if o.sensor == "atmosphere"
    ]
    return replace(epoch, observations=(*seen, *products))
