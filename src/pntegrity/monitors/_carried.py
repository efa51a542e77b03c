"""Windows that are carried forward from update to update, and which of them are kept (AIME, SRAIME)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Protocol, overload

import numpy as np

from pntegrity.kernels.extrapolation import (
    IntArray,
    Passage,
    given,
    look_at_rows,
    look_at_states,
    maps,
    new_passage,
    places,
)
from pntegrity.kernels.weighing import Given
from pntegrity.monitors._window import Window, block_of
from pntegrity.records import FloatArray, Update

Course = tuple[Passage, list[FloatArray], list[IntArray]]
"""A window carried from its first update: what came of it, its weights, and where they stand."""


FactsOf = Callable[[Update], Given]


class Once:
    """What windows need of updates, made once for all of them."""

    def __init__(self, make: FactsOf) -> None:
        self.make, self.made = make, dict[int, Given]()

    def __call__(self, update: Update) -> Given:
        """Return what is needed of one."""
        found = self.made.get(id(update))
        if found is None:
            found = self.made[id(update)] = self.make(update)
        return found


class View(Protocol):
    """What a monitor looks at in each update of a window."""

    def given(self, update: Update) -> Given:
        """Return what all windows need of an update."""
        ...

    def advance(self, passage: Passage, earlier: Window, update: Update, facts: FactsOf) -> Passage:
        """Return a window with one more update; `earlier` are those it has."""
        ...

    def course(self, window: Window, facts: FactsOf | None = None) -> Course:
        """Return what comes of a window from its first update."""
        ...

    @property
    def states(self) -> bool:
        """Whether it looks at states."""
        ...


@dataclass(frozen=True)
class Rows:
    """AIME's view; `blind`: to what was initialised from the data (see `kernels.extrapolation`)."""

    blind: bool = True
    states = False

    def given(self, update: Update) -> Given:
        """Return what all windows need of an update."""
        return given(update, self.blind)

    def advance(self, passage: Passage, earlier: Window, update: Update, facts: FactsOf) -> Passage:
        """Return a window with one more update."""
        return look_at_rows(passage, update.keys, facts(update))[0]

    def course(self, window: Window, facts: FactsOf | None = None) -> Course:
        """Return what comes of a window from its first update."""
        passage, weights = new_passage(0), []
        for u in window:
            passage, W = look_at_rows(passage, u.keys, (facts or self.given)(u))
            weights.append(W)
        return passage, weights, [places(u.keys, passage.names) for u in window]


@dataclass(frozen=True)
class States:
    """SRAIME's view: the states of `block` that live through the window."""

    block: str
    blind: bool = True
    states = True

    def given(self, update: Update) -> Given:
        """Return what all windows need of an update."""
        return given(update, self.blind)

    def advance(self, passage: Passage, earlier: Window, update: Update, facts: FactsOf) -> Passage:
        """Return a window with one more update; where a state ended, the window is carried anew without
        it.
        """
        if not passage.length:
            passage = new_passage(passage.onset, named(update, self.block))
        elif survivors(passage.names, update) != passage.names:
            anew = self.course((*earlier, update), facts)[0]
            return replace(anew, onset=passage.onset)
        return look_at_states(passage, places(passage.names, update.prior.layout.names), facts(update))[0]

    def course(self, window: Window, facts: FactsOf | None = None) -> Course:
        """Return what comes of a window from its first update."""
        names = named(window[0], self.block)
        for u in window[1:]:
            names = survivors(names, u)
        at = [places(names, u.prior.layout.names) for u in window]
        passage, weights = new_passage(0, names), []
        for u, block in zip(window, at, strict=True):
            passage, W = look_at_states(passage, block, (facts or self.given)(u))
            weights.append(W)
        return passage, weights, list(at)


def named(update: Update, block: str) -> tuple[str, ...]:
    """Return the names of the states of `block`."""
    names = update.prior.layout.names
    return tuple(names[i] for i in block_of(update, block))


def survivors(names: tuple[str, ...], update: Update) -> tuple[str, ...]:
    """Return which of the states live on into an update: a fresh one of the same name does not count."""
    present, at = _present(names, update.prior.layout.names)
    alive = np.any(update.F[at], axis=1)
    return present if alive.all() else tuple(present[i] for i in np.flatnonzero(alive))


@lru_cache(maxsize=1024)
def _present(names: tuple[str, ...], among: tuple[str, ...]) -> tuple[tuple[str, ...], IntArray]:
    there = set(among)
    present = names if there.issuperset(names) else tuple(n for n in names if n in there)
    return present, places(present, among)


class LazyMaps(Sequence[FloatArray]):
    """The maps of a window, made when they are first asked for: a test without an alarm needs none."""

    def __init__(self, view: View, window: Window) -> None:
        self.view, self.window = view, window

    @cached_property
    def made(self) -> tuple[FloatArray, ...]:
        """The maps."""
        passage, weights, at = self.view.course(self.window)
        return maps(self.window, weights, at, len(passage.names), self.view.states)

    def __len__(self) -> int:
        return len(self.window)

    @overload
    def __getitem__(self, i: int) -> FloatArray: ...

    @overload
    def __getitem__(self, i: slice) -> Sequence[FloatArray]: ...

    def __getitem__(self, i: int | slice) -> FloatArray | Sequence[FloatArray]:
        return self.made[i]

    def __iter__(self) -> Iterator[FloatArray]:
        return iter(self.made)


@dataclass(frozen=True)
class Lengths:
    """Window lengths, and which windows are carried for them.

    A window cannot be shortened at its old end, so that one has to be carried for every update in it. To
    carry fewer, from a length of 10 on one begins only at every `spacing`-th update, and a length ``m``
    stands for the youngest of at least ``m`` updates; these are fewer than ``1.4 m``. Shorter lengths, and
    all where `thin` is false, are exact.
    """

    lengths: tuple[int, ...]
    thin: bool = True

    def spacing(self, length: int) -> int:
        """Return at every how many updates a window of that length begins."""
        return 1 << int(0.4 * length).bit_length() - 1 if self.thin and length >= 10 else 1

    def begins(self, count: int) -> bool:
        """Tell whether a window begins at this update."""
        return not self.thin or any(count % self.spacing(m) == 0 for m in self.lengths)

    def keeps(self, passage: Passage) -> bool:
        """Tell whether a window will be tested at a later update."""
        return any(
            passage.onset % self.spacing(m) == 0 and passage.length + 1 < m + self.spacing(m)
            for m in self.lengths
        )

    def window(self, passages: tuple[Passage, ...], length: int) -> Passage:
        """Return the window that stands for a length; until there is one: the longest there is, or, where
        `thin` is false, that of this update alone.
        """
        fit = [p for p in passages if p.onset % self.spacing(length) == 0]
        return next((p for p in reversed(fit) if p.length >= length), fit[0 if self.thin else -1])


@dataclass(frozen=True, eq=False)
class Trail:
    """Memory of a windowed monitor: a counter, the updates of the longest window, and all windows, oldest
    first.
    """

    count: int = 0
    window: Window = ()
    passages: tuple[Passage, ...] = ()


def carry(trail: Trail, update: Update, view: View, lengths: Lengths) -> tuple[Trail, Trail]:
    """Return all windows that end with `update`, and what of them is kept.

    An epoch without rows ends them all. A start stands alone: its innovations come from a state that was
    initialised from the same data, so no later window contains them.
    """
    if not update.keys:
        return Trail(), Trail()
    if update.is_start:
        trail = Trail()
    facts = Once(view.given)
    began = [new_passage(trail.count)] if lengths.begins(trail.count) else []
    reach = len(trail.window)
    passages = tuple(
        view.advance(p, trail.window[reach - p.length :], update, facts) for p in (*trail.passages, *began)
    )
    now = Trail(trail.count + 1, (*trail.window, update), passages)
    if update.is_start:
        return now, Trail()
    kept = tuple(p for p in passages if lengths.keeps(p))
    longest = kept[0].length if kept else 0
    return now, Trail(now.count, now.window[len(now.window) - longest :], kept)
