"""What every monitor must be: found by existing, run over every estimator."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import pickle
from pathlib import Path
from typing import Any

import everyone
import numpy as np
import pytest
from everyone import EXACT, build, every_monitor, every_source, option_names, outcomes, updates

from gnss_logs import fingerprint
from pntegrity import monitors
from pntegrity.evaluate.montecarlo import count_alarms, plans
from pntegrity.protocols import Monitor
from pntegrity.records import Prior, State, Update, Verdict
from pntegrity.simulate.linear import gains, spp_model


def stepped(monitor: Monitor, sequence: Any) -> list[tuple[Any, Update, Verdict, Any]]:
    """Return for each update: the memory before it, itself, the verdict, the memory after."""
    memory, out = monitor.start(), []
    for update in sequence:
        verdict, after = monitor.step(memory, update)
        out.append((memory, update, verdict, after))
        memory = after
    return out


@every_monitor
@every_source
def test_a_step_changes_nothing_and_says_the_same_twice(which, where):
    monitor = build(*which)
    for memory, update, verdict, after in stepped(monitor, updates(where))[::3]:
        before = fingerprint(memory), fingerprint(update), fingerprint(after)
        again, after_again = monitor.step(memory, update)
        assert again == verdict
        assert fingerprint(after_again) == before[2]
        assert (fingerprint(memory), fingerprint(update)) == before[:2]


@every_monitor
@every_source
def test_a_verdict_is_whole(which, where):
    monitor = build(*which)
    seen: set[str] = set()
    for _, update, verdict, _ in stepped(monitor, updates(where)):
        seen |= set(update.groups())
        assert (verdict.monitor, verdict.variant, verdict.t_ns) == (*which, update.t_ns)
        assert verdict.status in ("ok", "alert", "unavailable")
        assert np.isfinite([verdict.statistic, verdict.threshold, verdict.p_fa]).all()
        if verdict.status == "unavailable":
            assert verdict.reason
            assert (verdict.statistic, verdict.threshold, verdict.suspects) == (0.0, 0.0, ())
            continue
        assert verdict.threshold > 0.0
        assert verdict.statistic >= 0.0
        assert verdict.dof >= 1
        assert verdict.p_fa == monitor.p_fa
        assert (verdict.status == "alert") == (verdict.statistic > verdict.threshold)
        assert all(np.isfinite([s.size, s.statistic]).all() for s in verdict.suspects)
        assert all(s.onset_ns <= update.t_ns for s in verdict.suspects)
        assert all(set(s.groups) <= seen for s in verdict.suspects)  # sources may measure in turn


@every_source
def test_the_logs_are_eventful_enough(where):
    run = outcomes("rctm", "exact", where)
    assert any(o.exclusions for o in run)
    assert any(o.readmitted for o in run)
    assert any(o.status == "unavailable" for o in run)
    assert len({len(o.update.keys) for o in run}) > 3
    if where != "spp":
        assert any(o.rewound for o in outcomes("glr", "exact", where))


@every_monitor
@every_source
def test_no_order_of_rows_matters(which, where):
    rng = np.random.default_rng(3)
    mixed = [permuted(u, rng) for u in updates(where)]
    monitor = build(*which)
    for a, b in zip(stepped(monitor, updates(where)), stepped(monitor, mixed), strict=True):
        one, two = a[2], b[2]
        assert one.status == two.status
        assert two.statistic == pytest.approx(one.statistic, rel=rounding(a[1]), abs=1e-9)
        assert two.threshold == pytest.approx(one.threshold, rel=1e-9)
        if len(one.suspects) == 1 or (
            one.suspects and one.suspects[0].statistic - one.suspects[1].statistic > 1e-6
        ):
            assert sorted(two.suspect_groups) == sorted(one.suspect_groups)


def rounding(update: Update) -> float:
    """Return by how much a statistic may move when sums are taken in another order: what `S` makes of a unit
    in the last place.
    """
    return max(1e-7, 1e-15 * float(np.linalg.cond(update.S))) if update.keys else 0.0


def permuted(update: Update, rng: np.random.Generator) -> Update:
    i = rng.permutation(len(update.keys))
    keys = tuple(update.keys[k] for k in i)
    aux = {name: values[i] for name, values in update.aux.items()}
    return dataclasses.replace(
        update, keys=keys, nu=update.nu[i], H=update.H[i], R=update.R[np.ix_(i, i)], aux=aux
    )


@every_monitor
def test_without_rows_no_test_is_possible(which):
    monitor = build(*which)
    model = spp_model(5)
    first = gains(model, 3)
    prior = Prior(State(4 * 10**9, np.zeros(8), first[-1].posterior.P, model.layout), model.F, model.Q)
    empty = Update.of(prior, (), np.zeros(0), np.zeros((0, 8)), np.zeros((0, 0)), reason="tunnel")
    assert monitor.step(monitor.start(), empty)[0].status == "unavailable"
    verdict = stepped(monitor, [*first, empty])[-1][2]
    assert (verdict.status, verdict.reason) == ("unavailable", "tunnel")


@every_monitor
def test_memory_stays_bounded(which):
    monitor = build(*which)
    model = spp_model(6)
    sizes = [len(pickle.dumps(after)) for *_, after in stepped(monitor, gains(model, 200))]
    assert max(sizes[130:]) <= 1.05 * max(sizes[:130])


@every_monitor
def test_a_monitor_is_a_frozen_value(which):
    monitor = build(*which)
    assert isinstance(monitor, Monitor)
    assert pickle.loads(pickle.dumps(monitor)) == monitor == build(*which)
    assert hash(monitor) == hash(build(*which))
    for field in dataclasses.fields(monitor):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(monitor, field.name, 0)


BAD = [
    ("p_fa", 0.0), ("p_fa", 0.5), ("p_fa", -1e-3), ("p_fa", float("nan")), ("p_fa", "1e-6"), ("factor", 0.0),
    ("factor", -2.0),
    ("factor", float("inf")), ("factor", float("nan")), ("factor", None), ("variant", "exactly"),
    ("variant", ""),
    ("window", 0), ("window", -3), ("window", 2.5), ("window", "5"), ("window", True), ("longest", 7),
    ("longest", 64.0), ("block", 3),
]  # fmt: skip


@pytest.mark.parametrize(("field", "value"), BAD, ids=str)
def test_an_impossible_option_is_refused_by_its_name(field, value):
    owners = [cls for cls in monitors.discover().values() if field in option_names(cls)]
    assert owners
    for cls in owners:
        with pytest.raises(ValueError, match=f"`{field}` must be"):
            cls(**{field: value})


PARTS = (
    "Hypothes",
    "Statistic:",
    "Threshold:",
    "Memory:",
    "cannot see",
    "Parameters\n",
    "References\n",
    "Examples\n",
    ">>> ",
)


@pytest.mark.parametrize("name", sorted(monitors.discover()))
def test_the_docstring_says_what_it_must(name):
    text = inspect.getdoc(monitors.discover()[name])
    missing = [part for part in PARTS if part not in text]
    assert not missing
    for option in option_names(monitors.discover()[name]):
        assert option in text


@pytest.mark.parametrize("package", ["monitors", "estimators"])
def test_plug_ins_do_not_import_their_siblings(package):
    found = importlib.import_module(f"pntegrity.{package}")
    names = [cls.__module__ for cls in found.discover().values()]
    for name in names:
        text = Path(importlib.import_module(name).__file__).read_text()
        assert not [n for n in names if n != name and f"{n} import" in text], name


@pytest.mark.parametrize("name", EXACT)
def test_an_exact_monitor_keeps_its_false_alarm_rate(name):
    # 20 runs of 1000 epochs; the interval allows for overlapping windows
    monitor = build(name, p_fa=1e-2)
    low, high = count_alarms(
        plans(gains(spp_model(8), 150), monitor), 200, np.random.default_rng(11)
    ).interval(0.999)
    assert low <= 1e-2
    assert high >= (1e-2 / 3.0 if name in ("glr", "separation", "source_separation") else 1e-2)


@every_monitor
@every_source
def test_the_threshold_factor_multiplies(which, where):
    plain, strict = build(*which), dataclasses.replace(build(*which), factor=2.0)
    for a, b in zip(stepped(plain, updates(where)[:12]), stepped(strict, updates(where)[:12]), strict=True):
        assert b[2].threshold == pytest.approx(2.0 * a[2].threshold, rel=1e-12)
        assert b[2].statistic == a[2].statistic


def test_every_monitor_is_found_and_named_after_its_module():
    folder = Path(monitors.__file__).parent
    modules = {p.stem for p in folder.glob("[!_]*.py")}
    assert set(monitors.discover()) == modules
    assert everyone.MONITORS
