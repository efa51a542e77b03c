"""Priors of sources and of their sensors, and the risk tree that follows from them."""

from __future__ import annotations

import re
import tomllib
from itertools import combinations
from math import prod

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pntegrity.bounds import Ism, events_of, fault_modes
from pntegrity.bounds.modes import modes_of, names_of
from pntegrity.bounds.risk_tree import MOST_BRANCHES, risk_tree, tree_of
from pntegrity.config import to_toml
from pntegrity.errors import InputError
from pntegrity.states import rows_touched_by

KEYS = (
    "gnss:R.G05", "gnss:R.G12", "gnss:D.G05", "lbl:R.AP1", "lbl:R.AP2", "usbl:R.range", "usbl:A.bearing",
    "depth:R.z",
)  # fmt: skip
PRIOR = {"gnss": 1e-4, "lbl": 1e-4, "usbl": 1e-5, "lbl.AP1": 2e-5}


def of(**table: object) -> Ism:
    return Ism.from_table(table)


def events(ism: Ism) -> dict[str, object]:
    return {e.name: e for e in events_of(ism, names_of(ism, KEYS))}


def touched(ism: Ism, name: str) -> set[str]:
    patterns = events(ism)[name].patterns
    return {k for k, t in zip(KEYS, rows_touched_by(patterns, KEYS), strict=True) if t}


def test_a_source_has_its_own_probability_and_any_other_group_the_common_one() -> None:
    found = events(of(sources=PRIOR, p_other=3e-6))
    assert {n: e.probability for n, e in found.items()} == PRIOR | {"depth": 3e-6}


def test_a_sensor_fails_by_itself_only_where_it_is_stated() -> None:
    assert set(events(Ism())) == {"gnss", "lbl", "usbl", "depth"}
    assert touched(of(sources=PRIOR), "lbl.AP1") == {"lbl:R.AP1"}
    assert touched(of(sources=PRIOR), "lbl") == {"lbl:R.AP1", "lbl:R.AP2"}


def test_a_star_stands_for_every_sensor_of_a_source_that_has_none_of_its_own() -> None:
    found = events(of(sources={"gnss.*": 1e-5, "gnss.G12": 0.0, "lbl.*": 2e-5, "lbl.AP2": 3e-5}))
    sensors = {n: e.probability for n, e in found.items() if "." in n}
    assert sensors == {"gnss.G05": 1e-5, "lbl.AP1": 2e-5, "lbl.AP2": 3e-5}
    assert touched(of(sources={"gnss.*": 1e-5}), "gnss.G05") == {"gnss:R.G05", "gnss:D.G05"}


def test_names_that_never_appear_change_nothing() -> None:
    more = of(sources={"sonar": 1e-2, "lbl.AP9": 0.5, "sonar.*": 1e-3, "depth": 1e-5})
    assert names_of(more, KEYS) == names_of(Ism(), KEYS)
    assert modes_of(more, names_of(more, KEYS)) == modes_of(Ism(), names_of(Ism(), KEYS))


def test_a_sensor_can_fail_together_with_other_groups() -> None:
    both = {"name": "port", "groups": ["lbl.AP1", "usbl"], "probability": 1e-4}
    found = events(of(together=[both], p_other=0.0))
    assert set(found) == {"port"}
    assert found["port"].groups == ("lbl.AP1", "usbl")
    assert touched(of(together=[both]), "port") == {"lbl:R.AP1", "usbl:R.range", "usbl:A.bearing"}
    # and with the common probability the sensor still has no event of its own
    assert "lbl.AP1" not in events(of(together=[both]))
    with pytest.raises(InputError, match="lbl"):
        events(of(together=[both | {"name": "lbl"}]))


def test_two_sensors_of_a_source_are_counted_with_it_and_a_source_holds_its_sensors() -> None:
    ism = of(sources={"lbl": 1e-3, "lbl.*": 1e-4}, p_other=0.0, p_hmi=1e-9)
    _, modes = modes_of(ism, names_of(ism, KEYS))
    assert [m.name for m in modes.monitored] == ["lbl", "lbl.AP1", "lbl.AP2"]
    assert modes.monitored[0].probability == pytest.approx(1e-3 + 1e-8, rel=1e-12)


def test_a_name_without_quotes_is_a_table_and_means_the_same() -> None:
    plain, quoted = "[sources]\nlbl.AP1 = 1e-5\ngnss = 1e-4", '[sources]\n"lbl.AP1" = 1e-5\ngnss = 1e-4'
    one, two = (Ism.from_table(tomllib.loads(text)) for text in (plain, quoted))
    assert one == two == Ism(sources=(("gnss", 1e-4), ("lbl.AP1", 1e-5)))
    assert Ism.from_table(one.to_table()) == one
    assert Ism.from_table(tomllib.loads(to_toml(one.to_table()))) == one


@pytest.mark.parametrize(
    "table",
    [
        {"G05": 1e-5}, {"G": 1e-5}, {"trop": 1e-5}, {"az045": 1e-5}, {"": 1e-5}, {"a:b": 1e-5}, {"a+b": 1e-5},
        {"lbl.": 1e-5}, {".AP1": 1e-5}, {"lbl.a:b": 1e-5}, {"lbl": 1.5}, {"lbl": "often"}, {"lbl": True},
        {"lbl.AP1": -1e-9}, {"lbl": {"AP1": {"deep": 1e-5}}},
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_by_name(table: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=re.escape("`sources")):
        Ism.from_table({"sources": table})


# --- the tree


def test_the_tree_is_that_of_the_monitor() -> None:
    ism = of(sources=PRIOR, p_hmi=1e-8)
    groups = names_of(ism, KEYS)
    tree = tree_of(ism, groups)
    assert (events_of(ism, groups), tree.modes) == modes_of(ism, groups)
    monitored = {frozenset(b.sources) for b in tree.branches if b.monitored and len(b.sources) == 1}
    assert monitored == {frozenset(m.events) for m in tree.modes.monitored if len(m.events) == 1}
    assert tree.unmonitored == tree.modes.unmonitored


def test_the_tree_of_sources_alone_is_that_of_their_priors() -> None:
    ism = of(sources={"gnss": 1e-4, "lbl": 1e-4, "usbl": 1e-5})
    assert tree_of(ism, ("gnss", "lbl", "usbl")) == risk_tree(dict(ism.sources), ism.p_hmi)


def test_a_source_and_a_sensor_of_it_are_covered_by_the_source() -> None:
    tree = tree_of(of(sources=PRIOR), names_of(of(sources=PRIOR), KEYS))
    covered = {b.sources: b.monitored for b in tree.branches}
    assert covered["lbl", "lbl.AP1"]
    assert not covered["gnss", "lbl"]


def test_a_large_tree_lists_what_is_monitored() -> None:
    ism = of(sources={"gnss.*": 2e-4}, p_hmi=1e-5)
    keys = tuple(f"gnss:R.G{i:02d}" for i in range(40))
    tree = tree_of(ism, names_of(ism, keys))
    assert len(tree.branches) <= MOST_BRANCHES + len(tree.modes.monitored)
    listed = {frozenset(b.sources) for b in tree.branches if b.monitored}
    assert listed == {frozenset(), *(frozenset(m.events) for m in tree.modes.monitored)}
    assert tree.together == 2
    assert sum(tree.at_once) == pytest.approx(1.0, rel=1e-12)


priors = st.dictionaries(
    st.sampled_from([f"s{i}" for i in range(7)]), st.floats(1e-9, 0.3), min_size=1, max_size=6
)
budgets = st.floats(1e-9, 1e-2)


@settings(deadline=None, max_examples=150)
@given(priors, budgets)
def test_the_branches_of_any_tree_are_everything_that_can_happen(p: dict[str, float], p_hmi: float) -> None:
    ism = of(sources=p, p_hmi=p_hmi)
    tree = tree_of(ism, tuple(p))
    assert len(tree.branches) == 2 ** len(p)
    assert sum(b.probability for b in tree.branches) == pytest.approx(1.0, rel=1e-12)
    for k in range(len(p) + 1):
        exact = sum(b.probability for b in tree.branches if len(b.sources) > k)
        assert tree.beyond(k) == pytest.approx(exact, rel=1e-9, abs=1e-18)
    # what is not monitored is at most what comes off the risk, and that is within its share
    left = sum(b.probability for b in tree.branches if not b.monitored)
    assert left <= tree.unmonitored * (1.0 + 1e-12) + 1e-18
    assert tree.unmonitored <= ism.p_unmonitored


@settings(deadline=None, max_examples=100)
@given(priors, budgets, st.floats(1e-9, 0.3))
def test_a_source_that_comes_or_is_lost_changes_the_tree_as_a_tree_made_anew(
    p: dict[str, float], p_hmi: float, late: float
) -> None:
    ism = of(sources=p | {"late": late}, p_hmi=p_hmi)
    before, with_late = tree_of(ism, tuple(p)), tree_of(ism, (*p, "late"))
    assert before == tree_of(of(sources=p, p_hmi=p_hmi), tuple(p))
    assert with_late.beyond(0) == pytest.approx(1.0 - prod(1.0 - q for q in (*p.values(), late)), rel=1e-6)
    # more can fail at once then
    for k in range(len(p)):
        assert with_late.beyond(k) >= before.beyond(k) * (1.0 - 1e-9)
    # single faults of all are monitored where pairs are
    if with_late.together > 1:
        names = {b.sources for b in with_late.branches if b.monitored}
        assert {(n,) for n in (*p, "late")} <= names


@settings(deadline=None, max_examples=50)
@given(priors, budgets)
def test_of_one_size_the_most_probable_are_monitored(p: dict[str, float], p_hmi: float) -> None:
    tree = tree_of(of(sources=p, p_hmi=p_hmi), tuple(p))
    for size in range(1, len(p) + 1):
        of_size = [b for b in tree.branches if len(b.sources) == size]
        product = {b.sources: prod(p[n] for n in b.sources) for b in of_size}
        for a, b in combinations(of_size, 2):
            if a.monitored != b.monitored:
                more, less = (a, b) if a.monitored else (b, a)
                assert product[more.sources] >= product[less.sources] * (1.0 - 1e-12)


def test_the_budget_of_the_tree_is_that_of_the_message() -> None:
    ism = of(sources={"a": 1e-3, "b": 1e-3, "c": 1e-3}, p_hmi=1e-7, unmonitored_share=0.1, max_modes=4)
    tree = tree_of(ism, ("a", "b", "c"))
    assert len(tree.modes.monitored) == 4
    assert tree.modes == fault_modes(events_of(ism, ("a", "b", "c")), 1e-7, ism.p_unmonitored, 4)
    assert "no less than the integrity risk" in tree.modes.reason
