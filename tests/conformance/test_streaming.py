"""Batch, live, and resumed from a pickled checkpoint: the same, bit for bit, for every monitor and
estimator.
"""

from __future__ import annotations

import pickle

import pytest
from everyone import POLICY, build, every_monitor, every_source, outcomes, source

from gnss_logs import fingerprint
from pntegrity.pipeline import Pipeline
from pntegrity.replay import monitored
from pntegrity.report.write import entries


@every_monitor
@every_source
def test_resumed_from_a_pickled_checkpoint_it_is_the_same_run(which, where):
    # GIVEN a run in one go
    batch, s = outcomes(*which, where), source(where)
    cuts = {k for k, o in enumerate(batch) if o.exclusions or o.rewound or o.readmitted}
    cuts = set(sorted(cuts)[:4]) | {1, 40, len(batch) - 6}
    pipeline = Pipeline(s.estimator, [build(*which)], POLICY)
    for k, epoch in enumerate(s.epochs):
        # WHEN the process dies and another one goes on from what it had written, before and after every event
        if k in cuts or k - 1 in cuts:
            kept = pickle.loads(pickle.dumps((s.estimator, build(*which), pipeline.checkpoint)))
            pipeline = Pipeline(kept[0], [kept[1]], POLICY, kept[2])
        outcome = pipeline.push(pickle.loads(pickle.dumps(epoch)))
        # THEN nothing differs: verdicts, exclusions, updates, whatever an outcome says
        assert outcome.verdicts == batch[k].verdicts
        assert outcome.first == batch[k].first
        assert fingerprint(outcome) == fingerprint(batch[k])


@every_source
def test_all_monitors_together_say_what_each_says_alone_where_nothing_is_excluded(where):
    from everyone import MONITORS

    from pntegrity.exclusion import Policy

    s, every = source(where), [build(*which) for which in MONITORS]
    off = Policy(exclude=False)
    together = Pipeline(s.estimator, every, off)
    alone = [Pipeline(s.estimator, [m], off) for m in every]
    for epoch in s.epochs[:40]:
        verdicts = together.push(epoch).verdicts
        assert verdicts == tuple(p.push(epoch).verdicts[0] for p in alone)


@every_monitor
@every_source
def test_the_log_of_updates_gives_the_final_verdicts_again(which, where):
    batch = outcomes(*which, where)
    last = {u.t_ns: verdicts for u, verdicts in monitored(entries(batch), [build(*which)])}
    assert [tuple(last[o.t_ns]) for o in batch[-1:]] == [batch[-1].verdicts]
    by_time = dict.fromkeys(o.t_ns for o in batch)
    assert list(dict.fromkeys(sorted(last))) == list(by_time)
    replayed = list(monitored(entries(batch), [build(*which)]))
    at = -1
    for outcome in batch:  # each outcome's verdicts are those on the last of its updates
        at += len(outcome.updates)
        update, verdicts = replayed[at]
        assert update.t_ns == outcome.t_ns
        assert tuple(verdicts) == outcome.verdicts


@every_source
def test_epochs_go_forward_only_and_nothing_is_lost_by_one_that_does_not(where):
    s = source(where)
    one, two = (Pipeline(s.estimator, [build("rctm"), build("aime")], POLICY) for _ in range(2))
    for k, epoch in enumerate(s.epochs[:20]):
        if k in (5, 13):
            before = fingerprint(one.checkpoint)
            for old in (s.epochs[k - 1], s.epochs[0]):
                with pytest.raises(ValueError, match="not after the last one"):
                    one.push(old)
            assert fingerprint(one.checkpoint) == before
        assert one.push(epoch).verdicts == two.push(epoch).verdicts
