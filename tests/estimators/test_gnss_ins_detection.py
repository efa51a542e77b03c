"""The inertial filter: clocks, detection of faults, and that its steps are pure."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest
from ins_logs import drive, filter_of, off_m, updates

from gnss_logs import fingerprint, only, shifted, shuffled, without
from pntegrity.estimators._ins_options import InsOptions
from pntegrity.exclusion import Policy
from pntegrity.monitors.separation import Separation
from pntegrity.pipeline import Pipeline
from pntegrity.records import Epoch, Observation
from pntegrity.sensors.ranges import C_MPS

# --- clocks
# ----------------------------------------------------------------------------------------


def test_milliseconds_of_the_clock_are_taken_out():
    log = drive(60)
    shift = 2.0 * C_MPS * 1e-3
    epochs = [*log.epochs[:40], *(shifted(e, shift) for e in log.epochs[40:])]
    found, plain = updates(filter_of(log), epochs), updates(filter_of(log), log.epochs)
    assert found[40].events == ("receiver clock jump of 2 ms removed",)
    np.testing.assert_allclose(found[-1].posterior.mean[:3], plain[-1].posterior.mean[:3], atol=1e-3)
    assert found[-1].posterior.mean[6] - plain[-1].posterior.mean[6] == pytest.approx(shift, abs=1e-2)


@pytest.mark.parametrize("seed", [3, 4])
def test_late_signals_at_the_start_do_not_capture_the_clock(seed):
    # GIVEN a start at which four of seventeen codes are 20 to 90 m late, for 20 s
    log, rng = drive(30), np.random.default_rng(seed)
    epochs = started_late(log, 4, rng)
    # WHEN the filter tests them or not
    tested, plain = (off_m(log, updates(filter_of(log, fde=f), epochs)) for f in ("ours", "none"))
    # THEN they take the one that does not along, and not the other
    assert np.median(plain[5:20]) > 10.0
    assert tested.max() < 3.0


def test_a_start_at_a_wrong_place_is_found_out():
    # GIVEN a start that six late codes did capture
    log = drive(40)
    epochs = started_late(log, 6, np.random.default_rng(3))
    found = updates(filter_of(log), epochs)
    assert off_m(log, found)[:20].min() > 20.0
    # WHEN they are right again, and the filter has refused most for long enough
    assert "re-acquisition: most pseudoranges were refused for 20 s" in found[20].events
    # THEN nothing of what it learnt at the wrong place holds it there
    assert off_m(log, found)[20:].max() < 3.0
    assert len(found[21].keys) >= 30


def started_late(log, count: int, rng: np.random.Generator) -> list[Epoch]:
    names = [k[:3] for k in log.epochs[0].sensor("code").keys]
    late = {n: float(rng.uniform(20.0, 90.0)) for n in rng.choice(names, count, replace=False)}
    return [late_codes(e, late) if k < 20 else e for k, e in enumerate(log.epochs)]


def late_codes(epoch: Epoch, metres: dict[str, float]) -> Epoch:
    def moved(o: Observation) -> Observation:
        return replace(o, y=o.y + np.array([metres.get(k[:3], 0.0) for k in o.keys]))

    return replace(
        epoch, observations=tuple(moved(o) if o.sensor == "code" else o for o in epoch.observations)
    )


# --- detection
# ----------------------------------------------------------------------------------------


def test_codes_and_range_rates_are_left_out_alike_one_a_pass():
    log = drive(60)
    epoch = late_codes(log.epochs[45], {"G07": 40.0, "E19": 25.0})
    doppler = epoch.sensor("doppler")
    key = next(k for k in doppler.keys if k.startswith("G10"))
    bad = replace(doppler, y=doppler.y + np.array([3.0 if k == key else 0.0 for k in doppler.keys]))
    epoch = replace(epoch, observations=tuple(bad if o is doppler else o for o in epoch.observations))
    estimator = filter_of(log)
    found = updates(estimator, [*log.epochs[:45], epoch])
    screening = found[-1].screening
    assert {k for k, _ in screening.dropped} == {"G07:C1C", "E19:C1C", key}
    assert [i for _, i in screening.dropped] == [1, 2, 3]
    assert screening.last <= screening.last_limit < screening.first
    assert screening.satellites[0] - screening.satellites[1] == 2
    assert screening.pdop[1] > screening.pdop[0] > 0.5
    assert not {k for k, _ in screening.dropped} & set(found[-1].keys)


def test_satellites_return_when_they_are_right_again():
    log = drive(60)
    epochs = [late_codes(e, {"G07": 40.0}) if 30 <= k < 45 else e for k, e in enumerate(log.epochs)]
    found = updates(filter_of(log), epochs)
    assert all("G07:C1C" not in u.keys for u in found[30:45])
    assert all("G07:C1C" in u.keys for u in found[46:])


def test_an_excluded_group_is_spare_and_not_tested():
    log = drive(50)
    estimator = filter_of(log)
    state = updates(estimator, log.epochs[:45])[-1].posterior
    epoch = late_codes(log.epochs[45], {"G07": 40.0})
    update = estimator.correct(estimator.predict(state, epoch), epoch, frozenset({"G07"}))
    assert update.excluded == ("G07",)
    assert set(update.spare_keys) == {"G07:C1C", "G07:D1C"}
    assert not update.screening.dropped
    assert abs(update.spare_nu[0]) == pytest.approx(40.0, abs=3.0)


@pytest.mark.parametrize("name", ["limit_sigma", "lost_s"])
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_options_of_detection_that_make_no_sense_are_refused(name, value):
    with pytest.raises(ValueError, match=name):
        InsOptions(**{name: value})


def test_a_wider_limit_leaves_out_less():
    log = drive(50)
    epochs = [*log.epochs[:45], late_codes(log.epochs[45], {"G07": 15.0, "E19": 6.0})]
    dropped = [len(updates(filter_of(log, limit_sigma=s), epochs)[-1].screening.dropped) for s in (3.3, 1e3)]
    assert dropped[0] > dropped[1] == 0


# --- steps are pure
# ----------------------------------------------------------------------------------------


def troubled() -> tuple[list[Epoch], object]:
    log, rng = drive(60), np.random.default_rng(5)
    names = [k[:3] for k in log.epochs[0].sensor("code").keys]
    epochs = []
    for k, e in enumerate(log.epochs):
        e = late_codes(e, {n: float(rng.exponential(15.0)) for n in rng.choice(names, 5, replace=False)})
        e = without(e, ["G07"]) if 20 < k < 25 else e
        epochs.append(only(e, []) if 34 <= k < 38 else e)
    return epochs, log


def test_the_order_of_rows_does_not_matter():
    epochs, log = troubled()
    rng = np.random.default_rng(6)
    a, b = (updates(filter_of(log), e) for e in (epochs, [shuffled(e, rng) for e in epochs]))
    for u, v in zip(a, b, strict=True):
        assert set(u.keys) == set(v.keys)
        if len(u.posterior):
            names = list(u.posterior.layout.names)
            at = [v.posterior.layout.index[n] for n in names]
            sigma = np.sqrt(np.diagonal(u.posterior.P))
            np.testing.assert_allclose((u.posterior.mean - v.posterior.mean[at]) / sigma, 0.0, atol=1e-5)


@pytest.mark.parametrize("fde", ["ours", "factor-set"])
def test_resumed_from_a_checkpoint_it_is_the_same_run(fde):
    epochs, log = troubled()
    estimator = filter_of(log, coupling="tight" if fde == "ours" else "loose", fde=fde)
    policy = Policy(**estimator.policy)
    whole = Pipeline(estimator, (Separation(),), policy)
    outcomes = [whole.push(e) for e in epochs]
    first = Pipeline(estimator, (Separation(),), policy)
    for e in epochs[:30]:
        first.push(e)
    kept = pickle.loads(pickle.dumps((estimator, first.checkpoint)))
    resumed = Pipeline(kept[0], (Separation(),), policy, checkpoint=kept[1])
    for e, outcome in zip(epochs[30:], outcomes[30:], strict=True):
        again = resumed.push(pickle.loads(pickle.dumps(e)))
        assert fingerprint(again.update) == fingerprint(outcome.update)
        assert fingerprint(again.verdicts) == fingerprint(outcome.verdicts)


def test_a_step_changes_nothing_that_it_is_given():
    epochs, log = troubled()
    estimator = filter_of(log)
    state = updates(estimator, epochs[:40])[-1].posterior
    before = fingerprint(state), fingerprint(epochs[40])
    one, two = (estimator.correct(estimator.predict(state, epochs[40]), epochs[40]) for _ in range(2))
    assert (fingerprint(state), fingerprint(epochs[40])) == before
    assert fingerprint(one) == fingerprint(two)
