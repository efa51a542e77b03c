"""The bank of hypotheses against brute force: each signature taken through the filter on its own."""

from dataclasses import replace

import numpy as np
import pytest

from pntegrity.evaluate.montecarlo import count_alarms, plans
from pntegrity.kernels.bank import MaximumTest, Schedule
from pntegrity.kernels.linear import whiten
from pntegrity.kernels.signatures import Signature
from pntegrity.kernels.windows import respond
from pntegrity.monitors.glr import Glr
from pntegrity.records import Prior, Update
from pntegrity.simulate.linear import draw, gains, spp_model

EPOCHS = 60
UPDATES = gains(spp_model(5), EPOCHS)


def shape_of(signature: Signature, keys: tuple[str, ...], tau: float) -> np.ndarray:
    f = np.zeros(len(keys))
    for i, key in enumerate(keys):
        if key in signature.level:
            f[i] = tau if signature.kind == "ramp" else 1.0
        if key in signature.rate:
            f[i] = 1.0
    return f


def brute_force(
    updates: tuple[Update, ...], signature: Signature, onset: int, start_ns: int
) -> list[np.ndarray]:
    """Whitened innovation means of a unit fault since epoch `onset`."""
    e, out = np.zeros((updates[onset].F.shape[1], 1)), []
    for u in updates[onset:]:
        f = shape_of(signature, u.keys, (u.t_ns - start_ns) * 1e-9)
        g, e = respond(e, u.F, u.H, u.K, f[:, None])
        out.append(whiten(u.L, g)[:, 0])
    return out


@pytest.fixture(scope="module")
def run() -> tuple[tuple[Update, ...], MaximumTest, np.ndarray]:
    updates = draw(UPDATES, np.random.default_rng(0).standard_normal((EPOCHS, 10)))
    monitor, memory = Glr(1e-3), Glr(1e-3).start()
    for u in updates[:-1]:
        _, memory = monitor.step(memory, u)
    test, _ = monitor.plan(memory, updates[-1])
    return updates, test, test.carry(memory.num, updates[-1].white)


def test_every_hypothesis_equals_its_own_propagation(run: tuple) -> None:
    updates, test, num = run
    at = 0
    for bank in test.banks:
        for s, signature in enumerate(bank.signatures):
            means = [
                brute_force(updates, signature, int(onset), int(start))
                for onset, start in zip(bank.onset, bank.onset_ns, strict=True)
            ]
            for a, onset in enumerate(bank.onset):
                direct = sum(w @ u.white for w, u in zip(means[a], updates[onset:], strict=True))
                assert num[at + a] == pytest.approx(float(direct), rel=1e-9, abs=1e-9)
                for b, later in enumerate(bank.onset):
                    both = zip(
                        means[a][max(later - onset, 0) :], means[b][max(onset - later, 0) :], strict=True
                    )
                    assert bank.gram[s, a, b] == pytest.approx(
                        sum(x @ y for x, y in both), rel=1e-9, abs=1e-12
                    )
            np.testing.assert_array_equal(bank.den[s], np.diag(bank.gram[s]))
            at += len(bank.onset)


def test_flat_hypotheses_are_named_in_order(run: tuple) -> None:
    _, test, num = run
    named = [(s, int(t)) for b in test.banks for s in b.signatures for t in b.onset_ns]
    assert [test.hypothesis(i) for i in range(len(num))] == named
    with pytest.raises(IndexError):
        test.hypothesis(len(num))


def test_runs_side_by_side_are_the_runs_one_by_one() -> None:
    white = np.random.default_rng(1).standard_normal((30, 10, 3))
    planned = list(plans(UPDATES[:30], Glr(1e-3)))
    num = np.zeros((0, 3))
    for k, p in enumerate(planned):
        num = p.test.carry(num, white[k])
    for r in range(3):
        monitor = Glr(1e-3)
        memory = monitor.start()
        for u in draw(UPDATES[:30], white[:, :, r]):
            verdict, memory = monitor.step(memory, u)
        np.testing.assert_allclose(memory.num, num[:, r], rtol=1e-9, atol=1e-9)
        test = planned[-1].test
        assert verdict.statistic == pytest.approx(float((num[:, r] ** 2 * test.inverse).max()), rel=1e-9)


def test_a_lost_satellite_starts_anew_and_the_others_go_on() -> None:
    def without(u: Update, lost: str) -> Update:
        rows = [i for i, k in enumerate(u.keys) if not k.startswith(lost)]
        keys = tuple(u.keys[i] for i in rows)
        return Update.of(Prior(u.prior, u.F, u.Q), keys, u.nu[rows], u.H[rows], u.R[np.ix_(rows, rows)])

    monitor, memory = Glr(1e-3), Glr(1e-3).start()
    for k, u in enumerate(UPDATES[:20]):
        _, memory = monitor.step(memory, without(u, "G02") if k == 12 else u)
    bank = memory.banks[0]
    lost = [i for i, s in enumerate(bank.signatures) if s.groups == ("G02",)]
    kept = [i for i, s in enumerate(bank.signatures) if s.groups == ("G01",)]
    old = bank.onset < 12
    assert old.any()
    assert (bank.den[np.ix_(kept, np.flatnonzero(old))] > 0.0).all()
    for i in (
        lost
    ):  # its rows came back at epoch 13: an older onset has seen no more than the 13th epoch and later
        newest = brute_force(UPDATES[:20], bank.signatures[i], 13, int(UPDATES[12].t_ns))
        assert (bank.den[i, old] <= 1.01 * sum(w @ w for w in newest)).all()


@pytest.mark.parametrize("schedule", [Schedule(1, 0, 16), Schedule(4, 3, 64), Schedule(2, 0, 33)])
def test_thinning_keeps_an_onset_near_every_age(schedule: Schedule) -> None:
    onset = np.zeros(0, dtype=np.int64)
    for count in range(300):
        onset = onset[schedule.keep(onset, count)]
        if count % schedule.step == 0:
            onset = np.append(onset, count)
        ages = count - onset
        assert (ages <= schedule.oldest).all()
        assert len(onset) <= 4 + 2 * np.log2(schedule.oldest / schedule.step) + 2
        for age in range(min(count, schedule.oldest // 2)):
            nearest = np.abs(ages - age).min()
            assert nearest <= max(schedule.step, age / 2)


def test_the_youngest_wait_for_their_test() -> None:
    tested = Schedule(4, 3, 64).tested(np.array([0, 4, 8]), 9)
    np.testing.assert_array_equal(tested, [True, True, False])


def test_the_bank_keeps_its_false_alarm_rate() -> None:
    count = count_alarms(plans(gains(spp_model(), 100), Glr(1e-2)), 2000, np.random.default_rng(5))
    low, high = count.interval(0.999)
    assert low <= 1e-2
    assert high >= 1e-2 / 3.0


def test_an_epoch_without_rows_empties_the_bank() -> None:
    monitor, memory = Glr(1e-3), Glr(1e-3).start()
    for u in UPDATES[:5]:
        _, memory = monitor.step(memory, u)
    u = UPDATES[5]
    none = Update.of(Prior(u.prior, u.F, u.Q), (), np.zeros(0), np.zeros((0, 8)), np.zeros((0, 0)))
    verdict, memory = monitor.step(memory, replace(none, reason="no measurements"))
    assert verdict.status == "unavailable"
    assert memory.count == 0
    verdict, memory = monitor.step(memory, UPDATES[6])
    assert memory.count == 1
