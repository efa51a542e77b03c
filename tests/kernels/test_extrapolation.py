"""Windows that are carried forward: the same as from their first update, blind to what was initialised."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest
from arcs import arcs, otherwise_initialised

from pntegrity.evaluate.intervals import binomial_interval
from pntegrity.kernels.extrapolation import initialised
from pntegrity.kernels.tails import chi2_tail
from pntegrity.monitors._carried import Lengths
from pntegrity.monitors.aime import Aime
from pntegrity.monitors.sraime import Sraime
from pntegrity.monitors.srctm import Srctm
from pntegrity.records import Update
from pntegrity.simulate.linear import draw, gains, spp_model

EPOCHS = 60


def eventful() -> list[dict[str, int]]:
    """Nine satellites; one rises, one sets, one comes back, one slips."""
    view = []
    for k in range(EPOCHS):
        seen = {f"G{i:02d}": 0 for i in range(1, 10)}
        if k >= 14:
            seen["G10"] = 0
        if k >= 22:
            del seen["G03"]
        if k >= 41:
            seen["G03"] = 1
        if k >= 30:
            seen["G05"] = 1
        view.append(seen)
    return view


UPDATES = arcs(eventful(), np.random.default_rng(0))
MONITORS: list[Any] = [
    Aime(1e-3, window=5), Aime(1e-3, window=10), Aime(1e-3, window=20), Aime(1e-3, window=[4, 12, 25]),
    Aime(1e-3, "published", window=5), Sraime(1e-3, window=5), Sraime(1e-3, window=12, block="pos+amb"),
    Sraime(1e-3, window=[4, 12], block="amb"), Sraime(1e-3, "published", window=6, block="pos+amb"),
]  # fmt: skip


def run(monitor: Any, updates: tuple[Update, ...]) -> list[tuple[Any, Any]]:
    """Return the verdict of each epoch and the memory after it."""
    memory, out = monitor.start(), []
    for u in updates:
        verdict, memory = monitor.step(memory, u)
        out.append((verdict, memory))
    return out


@pytest.mark.parametrize("monitor", MONITORS, ids=str)
def test_carried_forward_a_window_is_what_it_is_from_its_first_update(monitor: Any) -> None:
    memory, tested = monitor.start(), 0
    for k, u in enumerate(UPDATES):
        verdict, after = monitor.step(memory, u)
        found = []
        for length in set(range(1, 40)) if verdict.status != "unavailable" else ():
            window = UPDATES[max(k + 1 - length, 0) : k + 1]
            if length <= k and (form := monitor.form(window)) is not None:
                found.append((float(form.statistic([w.white for w in window])), form.dof))
        if found and k:
            near = [dof for q, dof in found if q == pytest.approx(verdict.statistic, rel=1e-7)]
            assert verdict.dof in near
            tested += 1
        memory = after
    assert tested > 40


@pytest.mark.parametrize("monitor", [m for m in MONITORS if isinstance(m.window, int)], ids=str)
def test_a_plan_is_the_test_of_the_step(monitor: Any) -> None:
    memory = monitor.start()
    for k, u in enumerate(UPDATES):
        test, planned = monitor.plan(memory, u)
        verdict, memory = monitor.step(memory, u)
        assert pickle.dumps(planned.count) == pickle.dumps(memory.count)
        assert (test.form is None) == (verdict.status == "unavailable")
        if test.form is not None:
            window = UPDATES[k + 1 - len(test.form.maps) : k + 1]
            assert (test.dof, test.threshold) == (verdict.dof, verdict.threshold)
            direct = float(test.form.statistic([w.white for w in window]))
            assert direct == pytest.approx(verdict.statistic, rel=1e-7)


def test_the_window_is_as_long_as_promised() -> None:
    for length in (1, 2, 5, 9, 10, 13, 20, 40):
        monitor, memory, used = Aime(window=length), Aime(window=length).start(), []
        for u in gains(spp_model(5), 120)[1:]:
            test, memory = monitor.plan(memory, u)
            used.append(len(test.form.maps))
        assert used[:length] == list(range(1, length + 1))
        full = used[length - 1 :]
        assert min(full) == length
        assert max(full) <= (length if length < 10 else 1.4 * length)


def test_fewer_windows_are_carried_than_the_longest_is_long() -> None:
    _, memory = run(Aime(window=40), gains(spp_model(5), 150))[-1]
    assert 1 <= len(memory.passages) <= 4
    assert Lengths((5, 10, 20, 40)).spacing(5) == 1
    assert [Lengths((m,)).spacing(m) for m in (10, 20, 40)] == [4, 8, 16]


@pytest.mark.parametrize("monitor", MONITORS, ids=str)
def test_a_pickled_memory_goes_on_bit_for_bit(monitor: Any) -> None:
    whole = run(monitor, UPDATES)
    for cut in (13, 31, 44):
        memory = pickle.loads(pickle.dumps(whole[cut][1]))
        for k in range(cut + 1, cut + 12):
            verdict, memory = monitor.step(memory, pickle.loads(pickle.dumps(UPDATES[k])))
            assert verdict == whole[k][0]


def test_what_was_initialised_is_found() -> None:
    for k, u in enumerate(UPDATES):
        names = [u.prior.layout.names[i] for i in initialised(u)]
        if k:
            born = {14: ["amb:G10:L1C:0"], 30: ["amb:G05:L1C:1"], 41: ["amb:G03:L1C:1"]}.get(k, [])
            assert names == ["clk", *born]
        else:
            assert names == list(u.prior.layout.names)


@pytest.mark.parametrize(("k", "name"), [(12, "clk"), (14, "amb:G10:L1C:0"), (30, "amb:G05:L1C:1")])
@pytest.mark.parametrize(
    "monitor", [Aime(window=8), Aime(window=20), Sraime(window=8, block="pos+amb"), Srctm()], ids=str
)
def test_no_windowed_statistic_knows_what_a_state_was_initialised_with(
    monitor: Any, k: int, name: str
) -> None:
    other = otherwise_initialised(UPDATES, k, name, 5.0)
    moved = np.abs(other[k].nu - UPDATES[k].nu).max()
    assert moved > 1.0
    for a, b in zip(run(monitor, UPDATES[: k + 8]), run(monitor, other[: k + 8]), strict=True):
        assert b[0].dof == a[0].dof
        assert b[0].statistic == pytest.approx(a[0].statistic, rel=1e-3, abs=1e-3)


def test_the_degrees_of_freedom_are_the_rows_less_what_was_initialised() -> None:
    # GIVEN nine satellites, a white clock, and from the 14th epoch a tenth
    verdicts = [v for v, _ in run(Aime(window=6), UPDATES)]
    # THEN the clock's direction is missing, and the new carrier row while its birth is in the window
    assert [verdicts[k].dof for k in (10, 13)] == [17, 17]
    assert [verdicts[k].dof for k in range(14, 20)] == [18] * 6
    assert verdicts[20].dof == 19
    assert verdicts[0].dof == 2 * 9 - 4 - 9


def test_statistics_of_windows_with_births_are_chi_square() -> None:
    # GIVEN 400 runs whose innovations hold nothing of what was initialised
    monitors = [Aime(window=6), Sraime(window=6, block="pos+amb")]
    tails: dict[Any, list[float]] = {m: [] for m in monitors}
    for seed in range(400):
        updates = arcs(eventful()[10:25], np.random.default_rng([1, seed]))
        for m in monitors:
            verdict = run(m, updates)[9][0]  # the tenth satellite came in at the fifth
            tails[m].append(float(chi2_tail(verdict.statistic, verdict.dof)))
    # THEN their tail probabilities are uniform, and those of as many rows are not
    for m in monitors:
        low, high = binomial_interval(sum(t < 0.1 for t in tails[m]), 400, 0.999)
        assert low <= 0.1 <= high
        low, high = binomial_interval(sum(t > 0.5 for t in tails[m]), 400, 0.999)
        assert low <= 0.5 <= high


def test_a_block_joins_prefixes_and_drops_an_arc_that_begins_anew() -> None:
    monitor = Sraime(window=6, block="pos+amb")
    verdicts = [v for v, _ in run(monitor, UPDATES)]
    assert verdicts[29].dof == 12  # position and nine arcs
    assert [verdicts[k].dof for k in range(30, 35)] == [11] * 5  # the slipped one is another state
    assert verdicts[36].dof == 12
    alone = run(Sraime(window=6, block="pos"), UPDATES)
    assert {v.dof for v, _ in alone[1:]} == {3}


def test_a_state_that_is_reborn_under_its_name_is_dropped() -> None:
    updates = list(gains(spp_model(6), 20))
    F = updates[12].F.copy()
    F[6] = 0.0
    updates[12] = updates[12].altered(F=F)
    found = [v for v, _ in run(Sraime(window=5, block="pos+clk"), tuple(updates))]
    assert [found[k].dof for k in (11, 12, 15)] == [4, 3, 3]
    assert found[16].dof == 4  # the window begins with it
    only = [v for v, _ in run(Sraime(window=5, block="clk"), tuple(updates))]
    assert only[11].status == "ok"
    assert (only[12].status, only[13].status) == ("unavailable", "unavailable")
    assert only[12].reason == "no state of 'clk' lives through the window"
    assert only[16].status == "ok"


def test_no_such_states_is_another_reason() -> None:
    verdict = run(Sraime(block="amb"), gains(spp_model(5), 4))[-1][0]
    assert (verdict.status, verdict.reason) == ("unavailable", "no such states: 'amb'")


@pytest.mark.parametrize("block", ["+", "pos+", "+amb", "pos++amb"])
def test_a_block_of_nothing_is_refused(block: str) -> None:
    for cls in (Sraime, Srctm):
        with pytest.raises(ValueError, match="`block` must be"):
            cls(block=block)


@pytest.mark.parametrize("window", [(), (5, 5), (5, 0), [5, "10"], (5, 2.0)])
def test_impossible_windows_are_refused(window: Any) -> None:
    for cls in (Aime, Sraime):
        with pytest.raises(ValueError, match="`window` must be"):
            cls(window=window)


def test_several_windows_are_tests_of_their_own_shares() -> None:
    together = run(Aime(1e-3, window=[8, 3]), UPDATES)
    alone = [run(Aime(5e-4, window=m), UPDATES) for m in (3, 8)]
    for (verdict, _), *single in zip(together, *alone, strict=True):
        best = max((v for v, _ in single), key=lambda v: v.statistic / v.threshold)
        assert (verdict.statistic, verdict.threshold, verdict.dof) == (
            best.statistic, best.threshold, best.dof,
        )  # fmt: skip
        assert verdict.p_fa == 1e-3
    test, _ = Aime(window=(3, 8)).plan(Aime(window=(3, 8)).start(), UPDATES[1])
    assert test.form is None
    assert "one length at a time" in test.reason


@pytest.mark.parametrize("cls", [Aime, Sraime])
def test_several_windows_together_keep_the_false_alarm_rate(cls: Any) -> None:
    p_fa, runs = 0.05, 800
    monitor, updates = cls(p_fa, window=(2, 5, 10)), gains(spp_model(5), 12)
    rng = np.random.default_rng(3)
    alarms = sum(
        run(monitor, draw(updates, rng.standard_normal((12, 10))))[-1][0].status == "alert"
        for _ in range(runs)
    )
    low, high = binomial_interval(alarms, runs, 0.999)
    assert low <= p_fa
    assert high >= p_fa / 3.0
