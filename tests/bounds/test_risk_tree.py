"""The risk tree: what must be monitored follows from the priors and the budget."""

from __future__ import annotations

from itertools import product

import pytest

from pntegrity.bounds.risk_tree import risk_tree

PRIOR = {"gnss": 1e-4, "lbl": 1e-4, "usbl": 1e-5}


def test_the_branches_are_all_that_can_happen():
    tree = risk_tree(PRIOR, 1e-7)
    assert len(tree.branches) == 8
    assert sum(b.probability for b in tree.branches) == pytest.approx(1.0, rel=1e-15)


def test_single_faults_are_enough_for_the_papers_priors():
    tree = risk_tree(PRIOR, 1e-7)
    assert {b.sources for b in tree.branches if b.monitored} == {(), ("gnss",), ("lbl",), ("usbl",)}
    assert tree.together == 1
    assert tree.unmonitored == pytest.approx(1.2e-8, rel=1e-3)
    assert tree.beyond(1) == pytest.approx(tree.unmonitored)


def test_only_the_pairs_that_the_budget_demands_are_monitored():
    tree = risk_tree(PRIOR, 5e-9)
    pairs = [b for b in tree.branches if len(b.sources) == 2]
    assert [(b.sources, b.monitored) for b in pairs] == [
        (("gnss", "lbl"), True), (("gnss", "usbl"), False), (("lbl", "usbl"), False)
    ]  # fmt: skip
    assert tree.unmonitored <= 0.8 * 5e-9


@pytest.mark.parametrize(("p", "budget"), list(product([1e-2, 1e-3, 1e-4], [1e-5, 1e-7])))
def test_what_is_left_is_within_its_share(p, budget):
    tree = risk_tree(dict.fromkeys("abcd", p), budget)
    assert tree.unmonitored <= 0.8 * budget


def test_a_prior_must_be_a_probability():
    with pytest.raises(ValueError, match=r"`prior.lbl` must be a probability"):
        risk_tree({"lbl": 0.0}, 1e-7)
