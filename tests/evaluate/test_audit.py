"""The audit as a whole."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pntegrity.evaluate.audit import audit
from pntegrity.evaluate.audit_table import audit_json, audit_table
from pntegrity.monitors.aime import Aime
from pntegrity.monitors.glr import Glr
from pntegrity.monitors.rctm import Rctm
from pntegrity.monitors.sraime import Sraime
from pntegrity.records import Layout, Prior, State, Update
from pntegrity.scenarios.evidence_spp8 import evidence


def run(updates: tuple[Update, ...], monitor: Any, **options: Any) -> Any:
    return audit(updates, monitor, rng=np.random.default_rng(0), **{"tests": 60_000, "onsets": 2, **options})


def test_an_exact_monitor_has_its_rate_exactly(steady: tuple[Update, ...]) -> None:
    result = run(steady, Aime(1e-3))
    assert not result.exact.bounds
    assert result.exact.lowest == pytest.approx(1e-3, rel=1e-9)
    assert result.exact.highest == pytest.approx(1e-3, rel=1e-9)
    assert result.monte_carlo.low <= 1e-3 <= result.monte_carlo.high
    assert result.monte_carlo.tests >= 60_000
    assert result.tested == len(steady)


@pytest.mark.parametrize(
    "monitor", [Aime(1e-3, "published"), Sraime(1e-3, "published")], ids=lambda m: m.name
)
def test_a_published_monitor_is_shown_for_what_it_is(steady: tuple[Update, ...], monitor: Any) -> None:
    result = run(steady[40:], monitor, onsets=0)
    assert result.exact.median > 0.05
    assert result.monte_carlo.low > 0.03
    whole = audit(
        steady[40:], monitor, rng=np.random.default_rng(1), tests=100_000, onsets=0, confidence=0.9999
    )
    assert whole.monte_carlo.low <= result.exact.median * 1.02
    assert whole.monte_carlo.high >= result.exact.median * 0.95


def test_a_bank_has_bounds(steady: tuple[Update, ...]) -> None:
    result = run(steady, Glr(1e-3))
    assert result.exact.bounds
    assert result.exact.highest == pytest.approx(1e-3, rel=1e-3)
    assert result.exact.lowest < result.monte_carlo.high


def test_the_same_generator_the_same_audit(steady: tuple[Update, ...]) -> None:
    assert run(steady, Rctm(1e-2), threads=1).monte_carlo == run(steady, Rctm(1e-2), threads=2).monte_carlo


def test_longer_delays_see_smaller_ramps(steady: tuple[Update, ...]) -> None:
    for monitor in (Rctm(1e-6), Glr(1e-6)):
        result = run(steady, monitor, tests=0, delays_s=(5.0, 10.0, 30.0))
        for key in steady[0].keys:
            sizes = [v.median for v in result.visibility if v.key == key and v.kind == "ramp"]
            assert sizes == sorted(sizes, reverse=True)
            assert all(v.worst >= v.median for v in result.visibility)


def test_satellites_that_come_and_go_restarts_and_repairs(eventful: tuple[Update, ...]) -> None:
    for monitor in (Rctm(1e-3), Aime(1e-3), Sraime(1e-3), Glr(1e-3)):
        result = run(eventful, monitor, delays_s=(10.0,))
        assert result.epochs == len(eventful)
        assert result.tested + sum(result.skipped.values()) == len(eventful)
        assert any("initialised from this epoch" in reason for reason in result.skipped)
        assert result.exact.highest == pytest.approx(1e-3, rel=1e-3)
        assert any(v.median is not None for v in result.visibility)


def test_what_the_states_absorb_is_never_seen_and_it_is_said_why() -> None:
    # GIVEN a filter with a wandering bias state for its second row, which nothing else observes
    layout, F = Layout(("pos:x", "bias:G02")), np.eye(2)
    H, R, Q = np.array([[1.0, 0.0], [1.0, 1.0], [1.0, 0.0]]), np.eye(3), np.diag([0.01, 1e12])
    keys, out = ("G01:C1C", "G02:C1C", "G03:C1C"), []
    for k in range(60):
        P = np.diag([100.0, 1e12]) if k == 0 else out[-1].posterior.P + Q
        prior = Prior(State((k + 1) * 10**9, np.zeros(2), P, layout), F if k else np.zeros((2, 0)), Q)
        out.append(Update.of(prior, keys, np.zeros(3), H, R))
    # WHEN it is audited
    result = run(tuple(out), Rctm(1e-6), tests=0, delays_s=(10.0,))
    # THEN a fault on that row is never seen, the others are
    for v in result.visibility:
        assert (v.median is None) == (v.key == "G02:C1C")
        assert ("absorb" in v.note) == (v.key == "G02:C1C")


def test_a_record_too_short_for_the_delay_says_so(steady: tuple[Update, ...]) -> None:
    result = run(steady[:20], Rctm(1e-3), tests=0, delays_s=(5.0, 60.0))
    late = [v for v in result.visibility if v.delay_s == 60.0]
    assert late
    assert all(v.onsets == 0 and v.median is None and "ends" in v.note for v in late)


def test_a_record_without_tests(steady: tuple[Update, ...]) -> None:
    blind = tuple(replace(u, consumed=20) for u in steady[:10])
    result = run(blind, Rctm(1e-3))
    assert result.exact is None
    assert result.monte_carlo is None
    assert sum(result.skipped.values()) == 10


def test_an_empty_record_is_refused() -> None:
    with pytest.raises(ValueError, match="record_updates"):
        run((), Rctm(1e-3))


def test_table_and_json(eventful: tuple[Update, ...]) -> None:
    from rich.console import Console

    result = run(eventful, Glr(1e-3), delays_s=(10.0,))
    text = json.loads(json.dumps(audit_json(result)))
    assert text["monitor"] == "glr"
    assert {"quantity", "value", "low", "high", "note"} == set(text["rows"][0])
    console = Console(width=160, record=True, file=None, quiet=False, force_terminal=False)
    with console.capture() as captured:
        console.print(audit_table(result))
    assert "G03:C1C" in captured.get()
    assert "P_FA, Monte Carlo" in captured.get()


def test_the_campaign_holds() -> None:
    rows = evidence(60_000, np.random.default_rng(2))
    assert not [row["quantity"] for row in rows if row["ok"] is False and "bank" not in row["quantity"]]
    assert {"quantity", "must", "measured", "interval", "ok"} == set(rows[0])
    json.dumps(rows)
