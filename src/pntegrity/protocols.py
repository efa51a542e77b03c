"""What an estimator and a monitor must be. Any object with these methods will do; nothing is registered."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol, TypeVar, runtime_checkable

from pntegrity.records import Epoch, Prior, State, Update, Verdict

Memory = TypeVar("Memory")

__all__ = [
    "Carrying", "Estimator", "Monitor", "Switching", "begun_again", "carried", "judged", "memory_for",
    "resumes", "stepped",
]  # fmt: skip


@runtime_checkable
class Estimator(Protocol):
    """A filter or a snapshot solver. All steps are pure: same arguments, same result, nothing kept.

    An estimator that a run can choose by name also says what suits it: ``default_noise``, the noise model it
    starts from; ``max_gap_s``, after which it starts anew; ``bands``, which rows it takes; ``monitors``,
    those of a run that names none, and ``monitoring``, their options by name; ``policy``, fields of the
    exclusion policy; ``surroundings``, for the usual integrity support message; ``fitted``, ``settle_s`` and
    ``clip_sigma``, what a calibration may vary, after how long it looks, and the size beyond which
    innovations count linearly (cycle slips that nobody saw).
    """

    def predict(self, state: State, epoch: Epoch) -> Prior:
        """Return the prior at `epoch` from the last posterior (an empty state: start)."""
        ...

    def relax(self, prior: Prior) -> Prior:
        """Return the prior without what its dynamics say of the states that the epoch's rows determine
        anew.
        """
        ...

    def correct(self, prior: Prior, epoch: Epoch, exclude: frozenset[str] = frozenset()) -> Update:
        """Return the update with the rows of `epoch`, but for those of the groups in `exclude`."""
        ...


@runtime_checkable
class Monitor(Protocol):
    """A test of updates. Its memory is a value: `step` returns the next one and changes nothing."""

    @property
    def name(self) -> str:
        """Short name, as in tables and on the command line."""
        ...

    @property
    def variant(self) -> str:
        """``"exact"`` or ``"published"``."""
        ...

    def start(self) -> Any:
        """Return the memory of a monitor that has seen nothing."""
        ...

    def step(self, memory: Any, update: Update) -> tuple[Verdict, Any]:
        """Return the verdict on `update` and the memory after it."""
        ...


@runtime_checkable
class Carrying(Protocol):
    """A monitor whose verdict costs more than its memory: of a past run again only the last one counts."""

    def carry(self, memory: Any, update: Update) -> Any:
        """Return the memory after `update`, as `Monitor.step` does."""
        ...


@runtime_checkable
class Switching(Protocol):
    """A monitor that carries subfilters, to which the filter can go over when their groups are at fault."""

    def subfilter(self, memory: Any, state: State, groups: frozenset[str]) -> State:
        """Return the belief of the filter that never knew `groups`.

        Parameters
        ----------
        memory
            Of the monitor, after the epoch of `state`.
        state : State
            Posterior of the filter.
        groups : frozenset of str
        """
        ...


def resumes(monitor: Monitor) -> bool:
    """Tell whether a monitor goes on, where the past is run again, from what it remembered there: it has an
    attribute ``resumes`` that says so. Others begin anew.
    """
    return bool(getattr(monitor, "resumes", False))


def carried(monitor: Monitor, memory: Any, update: Update) -> Any:
    """Return the memory of a monitor after an update whose verdict nobody wants."""
    memory = memory_for(monitor, memory, update)
    return monitor.carry(memory, update) if isinstance(monitor, Carrying) else monitor.step(memory, update)[1]


def stepped(
    estimator: Estimator, state: State, epoch: Epoch, exclude: frozenset[str], relaxed: bool = False
) -> Update:
    """Return the update of an epoch after a posterior; `relaxed`: without what the dynamics say of it."""
    prior = estimator.predict(state, epoch)
    return estimator.correct(estimator.relax(prior) if relaxed else prior, epoch, exclude)


def judged(
    monitors: Sequence[Monitor], memories: Sequence[Any], update: Update
) -> tuple[tuple[Verdict, ...], tuple[Any, ...]]:
    """Return the verdicts of monitors on an update, and their memories after it."""
    steps = [m.step(memory_for(m, k, update), update) for m, k in zip(monitors, memories, strict=True)]
    return tuple(v for v, _ in steps), tuple(memory for _, memory in steps)


def begun_again(monitors: Sequence[Monitor], there: Sequence[Any]) -> tuple[Any, ...]:
    """Return the memories with which the past is run again: those that resume go on from what they remembered
    `there` (nothing, where that is not known), others begin anew.
    """
    kept = there or (None,) * len(monitors)
    return tuple(
        k if resumes(m) and k is not None else m.start() for m, k in zip(monitors, kept, strict=True)
    )


def memory_for(monitor: Monitor, memory: Any, update: Update) -> Any:
    """Return the memory with which a monitor takes an update: where the filter went over to a subfilter, only
    monitors that know of it go on.
    """
    return monitor.start() if update.switched and not isinstance(monitor, Switching) else memory
