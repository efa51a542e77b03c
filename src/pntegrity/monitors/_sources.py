"""Sources and their redundant sensors as monitors see them: by the names of the rows, and by nothing else.

A row ``"<source>:<kind>.<sensor>"`` belongs to a sensor of a source; one without a dot to a source that is
one sensor.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import groupby

import numpy as np
import numpy.typing as npt

from pntegrity.kernels.bank import LEAST
from pntegrity.kernels.signatures import Signature, catalogue, is_rate, masks
from pntegrity.kernels.source_test import Courses, WithoutSource, courses, responses
from pntegrity.records import FloatArray, Update
from pntegrity.states import group_of, sensor_of, source_of

__all__ = ["Evidence", "IntArray", "looks", "sensors_in", "sensors_of", "sources_in"]

IntArray = npt.NDArray[np.intp]
#: A source with at least so many level sensors, or axes, may shift as a whole: three determine a position.
SHIFTABLE = 3
#: A window is cut to so many rows, of which the last so many are looked at without some of them: what that
#: takes grows with their cube.
MOST_ROWS, RECENT_ROWS = 1200, 400
#: Ages of onsets that are looked at in a window, epochs.
AGES = (*range(16), *range(16, 40, 2), *range(40, 65, 4))
SHIFT = "shift"
#: Directions between the axes: no direction is farther than 28 degrees from one of these or an axis.
DIAGONALS = (
    (0, 1, 1), (0, 1, -1), (1, 0, 1), (1, 0, -1), (1, 1, 0), (1, -1, 0),
    (1, 1, 1), (1, 1, -1), (1, -1, 1), (-1, 1, 1),
)  # fmt: skip
#: Epochs of a window in which a fault can be said to have begun before it.
OLD_ENOUGH = 8


@lru_cache(maxsize=256)
def sensors_of(keys: tuple[str, ...]) -> Mapping[str, tuple[str, ...]]:
    """Return the sensors of each source, both sorted."""
    found: dict[str, set[str]] = {}
    for key in keys:
        found.setdefault(group_of(key), set()).add(sensor_of(key))
    return {source: tuple(sorted(found[source])) for source in sorted(found)}


@lru_cache(maxsize=4096)
def sources_in(signature: Signature) -> tuple[str, ...]:
    """Return the sources of a signature of `looks`."""
    return tuple(dict.fromkeys(source_of(g) for g in signature.groups))


@lru_cache(maxsize=4096)
def sensors_in(signature: Signature) -> tuple[str, ...]:
    """Return the sensors of a signature of `looks`, none for a source as a whole."""
    return tuple(name for g in signature.groups for name in [g.partition(".")[2]] if name)


@lru_cache(maxsize=512)  # a window's updates are asked for again at each alarm
def looks(update: Update, kind: str) -> tuple[tuple[Signature, ...], tuple[FloatArray, FloatArray]]:
    """Return the faults that are looked for in an update, and the rows (m, s) that grow and that jump.

    Those of `signatures.catalogue` on every sensor, and on all sensors whose names begin with the same
    letters; and a source with some sensors as if the position were elsewhere: a shift along each axis, and
    where it has no sensors, a position itself, between the axes as well.
    """
    signatures, touched, shifts = _faults(update.keys, update.prior.layout.names, kind)
    growing, constant = touched
    if not len(shifts):
        return signatures, touched
    growing, constant = growing.copy(), constant.copy()
    states = update.prior.layout.names
    position, velocity = _block(states, "pos:"), _block(states, "vel:")
    for column, rows, rates, way in shifts:
        target = growing if kind == "ramp" else constant
        target[rows, column] = update.H[np.ix_(rows, position)] @ way
        if kind == "ramp" and len(velocity):
            constant[rates, column] = update.H[np.ix_(rates, velocity)] @ way
    return signatures, (growing, constant)


#: Column, rows of levels and of rates, and the direction of the shift.
Shift = tuple[int, IntArray, IntArray, FloatArray]


@lru_cache(maxsize=256)
def _block(states: tuple[str, ...], kind: str) -> IntArray:
    return np.array([i for i, name in enumerate(states) if name.startswith(kind)], dtype=np.intp)


@lru_cache(maxsize=256)
def _faults(
    keys: tuple[str, ...], states: tuple[str, ...], kind: str
) -> tuple[tuple[Signature, ...], tuple[FloatArray, FloatArray], tuple[Shift, ...]]:
    named = tuple(_by_sensor(key) for key in keys)
    single = catalogue(named, kind)
    whole: list[Signature] = []
    shifts: list[Shift] = []
    position = _block(states, "pos:")
    for source in sensors_of(keys):
        own = [i for i, key in enumerate(keys) if group_of(key) == source]
        rows = np.array([i for i in own if not is_rate(keys[i])], dtype=np.intp)
        rates = np.array([i for i in own if is_rate(keys[i])], dtype=np.intp)
        if len({sensor_of(keys[i]) or keys[i] for i in rows}) < SHIFTABLE:
            continue
        names = [f"{SHIFT}:{states[i]}" for i in position]
        ways = dict(zip(names, np.eye(len(position)), strict=True))
        if len(position) == 3 and not any(sensor_of(keys[i]) for i in rows):
            ways |= {f"towards:{way}": np.array(way) / np.linalg.norm(way) for way in DIAGONALS}
        for name, way in ways.items():
            shifts.append((len(single) + len(whole), rows, rates, way))
            whole.append(Signature((source,), kind, (name,)))
    signatures = single + tuple(whole)
    return signatures, masks(signatures, named), tuple(shifts)


def _by_sensor(key: str) -> str:
    """Return a key whose group is the sensor: ``"lbl:R.AP1"`` -> ``"lbl.AP1:R"``."""
    source, _, rest = key.partition(":")
    kind, dot, sensor = rest.partition(".")
    return f"{source}.{sensor}:{kind}" if dot else key


@dataclass(frozen=True, eq=False)
class Evidence:
    """What a window of updates can show of faults in it, without its data.

    Parameters
    ----------
    window : tuple of Update
        The oldest first; faults begin within it.
    whole : Evidence, optional
        Of a longer window that ends with this one.
    """

    window: tuple[Update, ...]
    whole: Evidence | None = None

    @staticmethod
    def of(window: Sequence[Update], rows: int = MOST_ROWS) -> Evidence:
        """Return the evidence of the last updates, as many as have so many rows."""
        total = np.cumsum([len(u.keys) for u in window[::-1]])
        kept = max(int((total <= rows).sum()), 1)
        return Evidence(tuple(window[-kept:]))

    @cached_property
    def recent(self) -> Evidence:
        """The last part of the window, which is looked at without some of its rows."""
        last = Evidence.of(self.window, RECENT_ROWS)
        return self if len(last.window) == len(self.window) else replace(last, whole=self)

    @property
    def white(self) -> FloatArray:
        """The window's whitened innovations, shape (D,)."""
        return np.concatenate([u.white for u in self.window])

    @cached_property
    def keys(self) -> tuple[str, ...]:
        """Names of the window's rows, D of them."""
        return tuple(key for u in self.window for key in u.keys)

    @cached_property
    def responses(self) -> tuple[FloatArray, FloatArray]:
        """See `source_test.responses`."""
        return responses([(u.F, u.H, u.L, u.K) for u in self.window])

    @property
    def A(self) -> FloatArray:
        """What a fault of each row does to the window."""
        return self.responses[0]

    @cached_property
    def before(self) -> FloatArray:
        """What an error before the window does to it, directions that it shows; shape (D, n)."""
        return _unit(self.responses[1])

    @cached_property
    def faults(self) -> tuple[tuple[tuple[str, Signature], ...], Courses]:
        """All faults that may begin in the window: kinds and signatures, by source, and their courses."""
        if self.whole is not None:
            return self._part_of(self.whole)
        last = len(self.window) - 1
        t_s = np.array([(u.t_ns - self.window[0].t_ns) * 1e-9 for u in self.window])
        step_s = float(np.median(np.diff(t_s))) if last else 1.0
        onsets = sorted({last - age for age in AGES if age <= last})
        named: list[tuple[str, Signature]] = []
        parts: list[Courses] = []
        for kind in ("bias", "ramp"):
            signatures, touched = self._touched(kind)
            old = onsets if kind == "bias" else [k for k in onsets if last - k >= 2] or onsets[:1]
            part = courses(self.A, touched, t_s, step_s, old)
            parts.append(Courses(part.means, part.signature + len(named), part.onset))
            named += [(kind, s) for s in signatures]
        means = np.concatenate([p.means.T for p in parts]).T
        signature, onset = (
            np.concatenate([getattr(p, name) for p in parts]) for name in ("signature", "onset")
        )
        return tuple(named), Courses(means, signature, onset)

    def _part_of(self, whole: Evidence) -> tuple[tuple[tuple[str, Signature], ...], Courses]:
        """Return those of the faults of a longer window that begin in this one."""
        named, faults = whole.faults
        first = len(whole.window) - len(self.window)
        own = faults.onset >= first
        part = faults.those(own, len(whole.keys) - len(self.keys))
        return named, replace(part, onset=part.onset - first)

    @cached_property
    def columns(self) -> dict[tuple[str, ...], list[slice]]:
        """Where the faults of which sources are."""
        named, faults = self.faults
        each = [sources_in(named[s][1]) for s in faults.signature.tolist()]
        out: dict[tuple[str, ...], list[slice]] = {}
        first = 0
        for sources, run in groupby(each):
            last = first + sum(1 for _ in run)
            out.setdefault(sources, []).append(slice(first, last))
            first = last
        return out

    @cached_property
    def scale(self) -> FloatArray:
        """One over the length of each fault's mean; 0 where nothing is seen of it."""
        square = self.faults[1].squares
        return np.asarray(np.where(square > LEAST, 1.0 / np.sqrt(np.maximum(square, LEAST)), 0.0))

    @cached_property
    def shifts(self) -> dict[str, IntArray]:
        """The faults of each source that are shifts along the axes, shape (kinds and onsets, axes)."""
        named, faults = self.faults
        found: dict[str, dict[str, list[IntArray]]] = {}
        for i, (kind, s) in enumerate(named):
            if s.level and s.level[0].startswith(SHIFT):
                onsets = np.flatnonzero(faults.signature == i)
                found.setdefault(sources_in(s)[0], {}).setdefault(kind, []).append(onsets)
        return {
            name: np.concatenate([np.stack(axes, axis=1) for axes in kinds.values()])
            for name, kinds in found.items()
        }

    def _touched(self, kind: str) -> tuple[tuple[Signature, ...], list[tuple[FloatArray, FloatArray]]]:
        """Return the signatures of all epochs, and for each epoch the rows (m, s) that they touch."""
        each = [looks(u, kind) for u in self.window]
        signatures = tuple(sorted(dict.fromkeys(s for own, _ in each for s in own), key=sources_in))
        at = {s: i for i, s in enumerate(signatures)}
        out = []
        for own, (growing, constant) in each:
            columns = [at[s] for s in own]
            wide = np.zeros((2, len(growing), len(signatures)))
            wide[0][:, columns], wide[1][:, columns] = growing, constant
            out.append((wide[0], wide[1]))
        return signatures, out

    def without_sources(self, names: Iterable[str]) -> WithoutSource:
        """Return what the window says without the rows of some sources.

        Where they are several, what the state before the window was is not believed either: what sources
        agree on may have drifted for long, and the state with it.
        """
        out = frozenset(names)
        named, faults = self.faults
        rows = np.array([i for i, key in enumerate(self.keys) if group_of(key) in out], dtype=np.intp)
        others = np.array([not out.issuperset(sources_in(s)) for _, s in named])[faults.signature]
        columns = [self.A[:, rows], self.before] if len(out) > 1 else [self.A[:, rows]]
        return WithoutSource(faults.those(others), np.concatenate(columns, axis=1))

    def without_sensors(self, source: str, names: Iterable[str]) -> WithoutSource:
        """Return what the window says of the other sensors of a source without some of them."""
        out = frozenset(names)
        named, faults = self.faults
        rows = [i for i, key in enumerate(self.keys) if group_of(key) == source and sensor_of(key) in out]
        others = np.array([self._is_other(s, source, out) for _, s in named])[faults.signature]
        return WithoutSource(faults.those(others), self.A[:, np.array(rows, dtype=np.intp)])

    @staticmethod
    def _is_other(signature: Signature, source: str, out: frozenset[str]) -> bool:
        """Tell whether a signature is of one sensor of a source, and not of those left out."""
        sensors = sensors_in(signature)
        return sources_in(signature) == (source,) and len(sensors) == 1 and sensors[0] not in out

    def ranked(self, explained: FloatArray) -> list[str]:
        """Return the sources, the one first whose own fault explains most."""
        best: dict[str, float] = {}
        for sources, columns in self.columns.items():
            e = max(float(explained[c].max()) for c in columns)
            best |= {source: max(best.get(source, 0.0), e) for source in sources}
        return sorted(best, key=lambda g: (-best[g], g))

    def is_old(self, fault: int) -> bool:
        """Tell whether a fault begins at the oldest onset that is looked at."""
        faults = self.faults[1]
        if fault < 0 or len(self.window) < OLD_ENOUGH:
            return False
        alike = faults.onset[faults.signature == faults.signature[fault]]
        return int(faults.onset[fault]) <= int(alike.min())

    def best(self, explained: FloatArray, sources: Iterable[str]) -> int:
        """Return which fault of some sources explains most, -1 where they have none."""
        out = frozenset(sources)
        named, faults = self.faults
        own = np.array([out.issuperset(sources_in(s)) for _, s in named])[faults.signature]
        return int(np.argmax(np.where(own, explained, -1.0))) if own.any() else -1


def _unit(means: FloatArray) -> FloatArray:
    """Return columns of length 1; 0 where there is nothing."""
    size = np.linalg.norm(means, axis=0)
    return np.asarray(np.divide(means, size, out=np.zeros_like(means), where=size**2 > LEAST))
