"""The regions of the Stanford diagram, at their edges."""

from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pntegrity.evaluate.stanford import Region, Stanford, regions, stanford

INF, NAN = float("inf"), float("nan")
LIMIT = 2.0


@pytest.mark.parametrize(
    ("error", "level", "alert", "region"),
    [
        (0.0, 0.3, False, Region.NORMAL),
        (0.3, 0.3, False, Region.NORMAL),  # as large as the level is within it
        (np.nextafter(0.3, 1.0), 0.3, False, Region.MISLEADING),
        (2.0, 0.3, False, Region.MISLEADING),  # as large as the limit is not hazardous
        (np.nextafter(2.0, 3.0), 0.3, False, Region.HAZARDOUS),
        (2.0, 2.0, False, Region.NORMAL),  # a level at the limit serves
        (2.1, 2.0, False, Region.HAZARDOUS),
        (0.1, np.nextafter(2.0, 3.0), False, Region.UNAVAILABLE),
        (2.5, 3.0, False, Region.UNAVAILABLE),  # beyond the limit, but nothing was promised
        (3.5, 3.0, False, Region.UNAVAILABLE_MISLEADING),
        (1e6, INF, False, Region.UNAVAILABLE),
        (1e6, NAN, False, Region.UNAVAILABLE),
        (0.0, 0.0, False, Region.NORMAL),
        (NAN, 0.3, False, Region.UNKNOWN),
        (NAN, INF, False, Region.UNKNOWN),
        (-0.5, 0.3, False, Region.MISLEADING),
        (9.0, 0.3, True, Region.ALERTED),
        (NAN, NAN, True, Region.ALERTED),
    ],
)
def test_each_edge(error, level, alert, region):
    assert Region(regions([error], [level], LIMIT, [alert])[0]) is region


def test_counts():
    error = [0.1, 0.5, 9.0, 0.1, 9.0, NAN, 9.0, 0.2]
    level = [0.3, 0.3, 0.3, 5.0, 5.0, 0.3, 0.3, INF]
    found = stanford(error, level, LIMIT, np.arange(8) == 6)
    assert asdict(found) == {
        "normal": 1, "misleading": 1, "hazardous": 1, "unavailable": 2, "unavailable_misleading": 1,
        "unknown": 1, "alerted": 1,
    }  # fmt: skip
    assert found.judged == 6
    assert found.exceeded == 3


def test_without_an_alert_limit_every_finite_level_serves():
    found = stanford([0.1, 1e5, 0.1], [1e4, 1e4, INF], INF, [False] * 3)
    assert (found.normal, found.misleading, found.hazardous, found.unavailable) == (1, 1, 0, 1)


def test_no_epoch_has_no_region():
    assert stanford([], [], LIMIT, []) == Stanford()
    assert Stanford().judged == Stanford().exceeded == 0


@pytest.mark.parametrize("limit", [0.0, -1.0, NAN])
def test_a_limit_that_is_not_positive_is_refused(limit):
    with pytest.raises(ValueError, match="limit_m"):
        regions([0.1], [0.3], limit, [False])


@pytest.mark.parametrize("level", [[0.3, 0.3], [[0.3]]])
def test_lengths_that_differ_are_refused(level):
    with pytest.raises(ValueError, match="same length"):
        regions([0.1], level, LIMIT, [False])


SIZES = st.one_of(st.floats(0.0, 10.0), st.sampled_from([INF, NAN, LIMIT]))


@given(st.lists(st.tuples(SIZES.filter(lambda e: e != INF), SIZES, st.booleans()), max_size=30))
def test_every_epoch_is_counted_once_and_what_exceeds_is_misleading(rows):
    error, level, alert = (np.array([r[i] for r in rows]) for i in range(3))
    found = stanford(error, level, LIMIT, alert.astype(bool))
    assert sum(asdict(found).values()) == len(rows)
    beyond = [e > p and not a for e, p, a in rows]
    assert found.exceeded == sum(beyond)
    hazardous = [e > LIMIT and p <= LIMIT and not a for e, p, a in rows]
    assert found.hazardous == sum(hazardous)
