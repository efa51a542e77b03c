"""The one driver: an epoch in, an outcome out. Running is a loop over `Pipeline.push`.

Everything that changes sits in a `Checkpoint`, a value: keep it, pickle it, go on from it, with the same
verdicts.
"""

from __future__ import annotations

import gc
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

from pntegrity.exclusion import Decision, Exclusion, Policy, Standing, decide
from pntegrity.outcomes import Attempt, Checkpoint, Outcome, Reviewed
from pntegrity.protocols import Estimator, Monitor, Switching, begun_again, carried, judged, resumes, stepped
from pntegrity.proving import Past, Proof, is_due, prove
from pntegrity.readmission import distrusting, left_out, mostly_out, reacquired, review
from pntegrity.records import Epoch, State, Status, Update, Verdict, join_reasons
from pntegrity.states import group_of, is_left_out, names_sensor

#: A blunder larger than this moves a start so far that its linearisation blames others too, m.
FAR_M = 1000.0
#: Sources that measured so long ago still count, ns.
LATELY_NS = 60_000_000_000

__all__ = ["Checkpoint", "Outcome", "Pipeline", "uncollected"]


class Pipeline:
    """Drive an estimator and its monitors through epochs.

    Parameters
    ----------
    estimator : Estimator
    monitors : sequence of Monitor
    policy : Policy
    checkpoint : Checkpoint, optional
        Where to go on from.
    """

    def __init__(
        self,
        estimator: Estimator,
        monitors: Sequence[Monitor],
        policy: Policy | None = None,
        checkpoint: Checkpoint | None = None,
    ) -> None:
        self.estimator = estimator
        self.monitors = tuple(monitors)
        self.policy = policy or Policy()
        self.checkpoint = checkpoint or Checkpoint(memories=tuple(m.start() for m in self.monitors))

    def push(self, epoch: Epoch) -> Outcome:
        """Process one epoch and commit once, after the last exclusion.

        Raises
        ------
        ValueError
            Where the epoch is not later than the last one.
        """
        before = self.checkpoint
        if before.state.t_ns and epoch.t_ns <= before.state.t_ns:
            raise ValueError(f"epoch at {epoch.t_ns} ns is not after the last one at {before.state.t_ns} ns")
        now, made = self._second_look(before, epoch)
        first = self._attempt(now, epoch, _onsets(made), _is_reacquired(now))
        last, exclusions, reason = self._resolve(now, epoch, first, made)
        kept = {g: s for g, s in now.standing.items() if g in last.excluded}
        outcome, self.checkpoint = self._commit(
            replace(now, standing=kept), epoch, first, last, exclusions, reason
        )
        released = tuple(g for g in before.standing if g not in kept)
        return replace(outcome, readmitted=released + outcome.readmitted)

    def _resolve(
        self, now: Checkpoint, epoch: Epoch, attempt: Attempt, made: tuple[Exclusion, ...] = ()
    ) -> tuple[Attempt, tuple[Exclusion, ...], str]:
        """Exclude until no monitor alarms, nothing more can be left out, or the limit is reached."""
        reasons: list[str] = []
        usual, relaxed = distrusting(self.policy, now.reacquired_ns, epoch.t_ns), _is_reacquired(now)
        policy = replace(usual, trust_prior=False) if self._is_shaken(now) else usual
        previous_ns = now.state.t_ns if len(now.state) else epoch.t_ns
        while self.policy.exclude and _alert(attempt.verdicts) and len(made) < self.policy.most:
            decision = decide(attempt.updates[-1], attempt.verdicts, policy, previous_ns)
            if decision.relax and not relaxed:
                relaxed, policy = True, usual
                attempt = self._attempt(now, epoch, _onsets(made), relaxed, _left(made))
                continue
            new = tuple(e for e in decision.exclusions if e.group not in attempt.excluded)
            reasons.append(_ambiguity(decision) if new else decision.reason)
            if not new:
                break
            misfit = _misfit(now, attempt.updates[-1], new, self.policy)
            if misfit:
                return self._attempt(replace(now, standing={}), epoch, {}, relaxed), (), misfit
            if any(e.onset_ns < epoch.t_ns for e in new) and not _repair_is_due(now, epoch):
                break
            made += new
            attempt = self._attempt(now, epoch, _onsets(made), relaxed, _left(made))
        if _alert(attempt.verdicts) and made and all(e.monitor != "subset" for e in made):
            reasons.append(
                "leaving out " + "+".join(e.group for e in made) + " did not resolve the alert: undone"
            )
            return self._attempt(now, epoch, {}, relaxed), (), join_reasons(reasons)
        far = max((abs(e.size) for e in made), default=0.0) > FAR_M
        if far and len(made) > 1 and attempt.updates[-1].is_start:
            attempt, made = self._without_needless(now, epoch, attempt, made)
        return attempt, made, join_reasons(reasons)

    def _without_needless(
        self, now: Checkpoint, epoch: Epoch, attempt: Attempt, made: tuple[Exclusion, ...]
    ) -> tuple[Attempt, tuple[Exclusion, ...]]:
        """Take back exclusions of a start that were made beside a fix which a blunder had moved far off."""
        for e in made:
            fewer = tuple(other for other in made if other.group != e.group)
            trial = self._attempt(now, epoch, _onsets(fewer), switch=_left(fewer))
            if not _alert(trial.verdicts) and trial.verdicts[0].status == "ok":
                attempt, made = trial, fewer
        return attempt, made

    def _second_look(self, now: Checkpoint, epoch: Epoch) -> tuple[Checkpoint, tuple[Exclusion, ...]]:
        """Return what is known where somebody was left out in doubt, and who goes in their place.

        The past is run again with them, from before the onset on, and the monitors are asked anew: time has
        passed and may have told one explanation from another.
        """
        doubtful = {
            g: s for g, s in now.standing.items() if s.doubtful and not s.inherited and _is_looked_at(now, g)
        }
        if not doubtful or not self.policy.identifying:
            return now, ()
        standing = {g: s for g, s in now.standing.items() if g not in doubtful}
        past = tuple(replace(p, excluded=p.excluded - doubtful.keys()) for p in now.history)
        opened = replace(now, standing=standing, history=past, doubt_ns=None)
        onset_ns = min(s.since_ns for s in doubtful.values())
        attempt = self._attempt(opened, epoch, {}, from_ns=2 * onset_ns - epoch.t_ns)
        if not _alert(attempt.verdicts):
            return now, ()
        found = decide(attempt.updates[-1], attempt.verdicts, self.policy, now.state.t_ns).exclusions
        if not found or any(e.doubtful for e in found):
            return now, ()
        if {e.group for e in found} == set(doubtful):
            sure = {g: replace(s, doubtful=False) for g, s in doubtful.items()}
            return replace(now, standing={**now.standing, **sure}, doubt_ns=None), ()
        return opened, found

    def _attempt(
        self, now: Checkpoint, epoch: Epoch, since: Mapping[str, int], relaxed: bool = False,
        switch: frozenset[str] = frozenset(), from_ns: int | None = None,
    ) -> Attempt:  # fmt: skip
        """Run the epoch without the groups in `since`, again from before the earliest onset where that is in
        the past, or from `from_ns` on.

        The monitors begin anew at such a point: what they remembered was made with the faults in it. Those
        that resume go on from what they remembered there.
        `relaxed` lets go of what the dynamics say of the epoch itself. With `switch` the filter goes on from
        the subfilter that never knew these groups, and nothing before can be repaired any more.
        """
        margin = {g: max(epoch.t_ns - onset, 0) // 4 for g, onset in since.items()}
        begins = {g: onset - margin[g] for g, onset in since.items()}
        first_ns = min(begins.values(), default=epoch.t_ns) if from_ns is None else from_ns
        start = next((i for i, p in enumerate(now.history) if p.epoch.t_ns >= first_ns), len(now.history))
        again = now.history[start:]
        state = again[0].before if again else now.state
        memories = begun_again(self.monitors, again[0].memories) if again else now.memories
        updates, history = [], [] if switch else list(now.history[:start])
        verdicts: tuple[Verdict, ...] = ()
        past = [(p.epoch, p.excluded, p.relaxed) for p in again]
        state = self._without(now, state, switch) if not again else state
        for e, already, free in [*past, (epoch, left_out(now.standing), relaxed)]:
            out = already | {g for g, t_ns in begins.items() if e.t_ns >= t_ns}
            update = stepped(self.estimator, state, e, out, free)
            if switch and e is epoch and not again:
                update = update.altered(switched=tuple(sorted(switch)))
            kept = self._kept(memories)
            if e is epoch:
                verdicts, memories = judged(self.monitors, memories, update)
            else:
                memories = self._carried(memories, update)
            history.append(Past(state, e, out, free, kept))
            updates.append(update)
            state = update.posterior
        return Attempt(tuple(updates), len(again), verdicts, memories, tuple(history))

    def _without(self, now: Checkpoint, state: State, groups: frozenset[str]) -> State:
        """Return the last belief of the filter that never knew some groups."""
        if groups and len(state):
            for monitor, memory in zip(self.monitors, now.memories, strict=True):
                if isinstance(monitor, Switching):
                    return monitor.subfilter(memory, state, groups)
        return state

    def _kept(self, memories: Sequence[Any]) -> tuple[Any, ...]:
        """Return the memories that a repair goes on from."""
        if not self.policy.exclude or not any(map(resumes, self.monitors)):
            return ()
        pairs = zip(self.monitors, memories, strict=True)
        return tuple(memory if resumes(m) else None for m, memory in pairs)

    def _carried(self, memories: Sequence[Any], update: Update) -> tuple[Any, ...]:
        return tuple(carried(m, memory, update) for m, memory in zip(self.monitors, memories, strict=True))

    def _commit(
        self, now: Checkpoint, epoch: Epoch, first: Attempt, last: Attempt, made: tuple[Exclusion, ...],
        reason: str,
    ) -> tuple[Outcome, Checkpoint]:  # fmt: skip
        shaken = self._is_shaken(now)
        counts, standing = _with_new(now, made, epoch.t_ns, shaken)
        made = tuple(replace(e, doubtful=True) for e in made) if shaken else made
        reviewed = self._reviewed(now, epoch, last, standing)
        alert = _alert(last.verdicts) or bool(reason)
        since = (now.alert_since_ns if now.alert_since_ns is not None else epoch.t_ns) if alert else None
        patience_s = max(self.policy.restart_s, self.policy.restart_epochs * _step_s(now, epoch.t_ns))
        stuck = since is not None and (epoch.t_ns - since) * 1e-9 >= patience_s and self.policy.exclude
        doubtful = any(s.doubtful for s in standing.values())
        checkpoint = Checkpoint(
            last.updates[-1].posterior, last.memories, last.history[-self.policy.history :],
            reviewed.standing, counts, since, epoch.t_ns if reviewed.reacquired else now.reacquired_ns,
            epoch.t_ns if doubtful else now.doubt_ns,
        )  # fmt: skip
        if stuck:
            reason = join_reasons(
                [reason, f"alert unresolved for {patience_s:.0f} s: the filter starts anew"]
            )
            checkpoint = replace(
                checkpoint, state=State.empty(epoch.t_ns), history=(), standing={}, alert_since_ns=None,
                doubt_ns=None,
            )  # fmt: skip
        readmitted = tuple(g for g in standing if g not in reviewed.standing)
        status, told = _told(reviewed.standing, last, alert, reason)
        outcome = Outcome(
            epoch.t_ns, status, last.updates, last.rewound, last.verdicts, first.verdicts, made, readmitted,
            told, reviewed.proofs,
        )  # fmt: skip
        return outcome, checkpoint

    def _is_shaken(self, now: Checkpoint) -> bool:
        """Tell whether somebody was out in doubt not long ago: the state may have followed who was at fault,
        and who contradicts it now need not be.
        """
        if not self.policy.identifying or now.doubt_ns is None or not now.history:
            return False
        return now.doubt_ns >= now.history[0].epoch.t_ns

    def _reviewed(
        self, now: Checkpoint, epoch: Epoch, last: Attempt, standing: dict[str, Standing]
    ) -> Reviewed:
        """Return who stays out after the epoch, what tests of them showed, and who is re-acquired."""
        history, update = last.history[-self.policy.history :], last.updates[-1]

        def trial(name: str, s: Standing) -> Proof:
            return prove(self.estimator, history, name, s, self.policy)

        present, step_s = _present(epoch, standing), _step_s(now, epoch.t_ns)
        after, proofs = review(standing, update, present, self.policy, step_s, trial)
        back = reacquired(after, update, self.policy, history)
        return Reviewed({g: s for g, s in after.items() if g not in back}, proofs, bool(back))


def _with_new(
    now: Checkpoint, made: Sequence[Exclusion], t_ns: int, shaken: bool
) -> tuple[dict[str, int], dict[str, Standing]]:
    """Return how often groups were left out, and who is, with new exclusions; `shaken`: these are in doubt,
    whatever monitors say.
    """
    counts, standing = dict(now.counts), dict(now.standing)
    for e in made:
        counts[e.group] = counts.get(e.group, 0) + 1
        doubtful = e.doubtful or (e.switch and e.ambiguous)
        standing[e.group] = Standing(
            e.onset_ns, t_ns, times=counts[e.group], rows=e.rows, doubtful=doubtful or shaken,
            inherited=shaken and not doubtful, size=_size_of(e, t_ns),
        )  # fmt: skip
    return counts, standing


def _size_of(e: Exclusion, t_ns: int) -> float:
    """Return how large the fault of a sensor that was named is by now; 0: not known."""
    if not names_sensor(e.group):
        return 0.0
    return abs(e.size) * ((t_ns - e.onset_ns) * 1e-9 if e.kind == "ramp" else 1.0)


def _told(standing: Mapping[str, Standing], last: Attempt, alert: bool, reason: str) -> tuple[Status, str]:
    """Return the status of an epoch and why it is that."""
    update, beyond = last.updates[-1], [v.beyond for v in last.verdicts]
    doubt = [g for g, s in standing.items() if s.doubtful]
    status = _status(last.verdicts, alert or bool(doubt))
    if not doubt:
        return status, join_reasons([*beyond, reason or update.reason])
    told = reason or f"{', '.join(doubt)} left out, but others could be at fault as well"
    return status, join_reasons([*beyond, told, update.reason])


def _onsets(made: Sequence[Exclusion]) -> dict[str, int]:
    """Return since when who is left out."""
    return {e.group: e.onset_ns for e in made}


def _is_looked_at(now: Checkpoint, name: str) -> bool:
    """Tell whether somebody has been left out for so many epochs that it is time for a second look."""
    return is_due(sum(name in p.excluded for p in now.history), 1)


def _present(epoch: Epoch, names: Iterable[str]) -> frozenset[str]:
    """Return which of some groups and sensors were measured."""
    keys = [k for o in epoch.observations for k in o.keys]
    return frozenset(n for n in names if any(is_left_out(k, frozenset([n])) for k in keys))


def _left(made: Sequence[Exclusion]) -> frozenset[str]:
    """Return the groups for which the filter goes over to a subfilter."""
    return frozenset(e.group for e in made if e.switch)


def _misfit(now: Checkpoint, update: Update, new: Sequence[Exclusion], policy: Policy) -> str:
    """Say that more would be left out than can be at fault: then the model is, and nobody must suffer for
    it. Where monitors identify, sources count that measured lately; one most of whose sensors are out is out.
    """
    out, there = frozenset([*update.excluded, *(e.group for e in new)]), frozenset(update.groups())
    if policy.identifying:
        since_ns = update.t_ns - LATELY_NS
        past = (p.epoch for p in now.history if p.epoch.t_ns >= since_ns)
        keys = {k for e in past for o in e.observations for k in o.keys} | {*update.keys, *update.spare_keys}
        out, there = mostly_out(keys, out | now.standing.keys()), frozenset(map(group_of, keys))
    total = len(out | there)
    if len(out) <= policy.most_excluded * total:
        return ""
    return f"{len(out)} of {total} would be left out: the model does not fit the data, all are kept"


def _is_reacquired(now: Checkpoint) -> bool:
    """Tell whether the next epoch begins with a group that came back without having proved itself."""
    return now.reacquired_ns is not None and now.reacquired_ns == now.state.t_ns


def _repair_is_due(now: Checkpoint, epoch: Epoch) -> bool:
    """Tell whether to try a repair of the past: 0, 1, 2, 4, 8, ... s (or epochs, where these are longer)
    after the beginning of an alert.
    """
    since = now.alert_since_ns if now.alert_since_ns is not None else epoch.t_ns
    waited = int((epoch.t_ns - since) * 1e-9 / max(1.0, _step_s(now, epoch.t_ns)))
    return waited & (waited - 1) == 0


def _step_s(now: Checkpoint, t_ns: int) -> float:
    """Return the time since the epoch before."""
    return (t_ns - now.history[-1].epoch.t_ns) * 1e-9 if now.history else 0.0


def _alert(verdicts: Sequence[Verdict]) -> bool:
    return any(v.status == "alert" for v in verdicts)


def _status(verdicts: Sequence[Verdict], alert: bool) -> Status:
    if alert or any(v.beyond for v in verdicts):
        return "alert"
    return "unavailable" if all(v.status == "unavailable" for v in verdicts) else "ok"


def _ambiguity(decision: Decision) -> str:
    if not decision.alternatives:
        return ""
    chosen = "+".join(e.group for e in decision.exclusions)
    others = ", ".join("+".join(a) for a in decision.alternatives)
    return f"ambiguous: {chosen} was left out, but {others} would explain the data nearly as well"


@contextmanager
def uncollected() -> Iterator[None]:
    """Keep the cycle collector away from a growing list of results without cycles: a fifth of the time."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()
