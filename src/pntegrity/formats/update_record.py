"""The record of a run: every update (F, Q, H, R, nu, keys), to run any monitor again without raw data.

One ``.npz`` file, uncompressed, no pickles. Matrices are stored by their non-zeros (flat index, value,
offsets), names through one string table. Covariances are not stored where the chain ``P' = F P F^T + Q`` and
the measurement update give them back bit for bit; the writer checks that, and stores them dense where it is
not so (another filter, say). On a machine with another linear algebra library they come back to rounding.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from pntegrity.errors import InputError
from pntegrity.formats.atomic import atomically
from pntegrity.kernels.linear import symmetric
from pntegrity.kernels.sparse import sandwich
from pntegrity.records import FloatArray, Layout, Prior, State, Update

__all__ = ["Entry", "UpdateRecord", "read_record", "write_record"]

Entry = tuple[Update, int]
"""An update, and how many earlier ones it and what follows replace (a repair; monitors begin anew there)."""

FORMAT, VERSION = "pntegrity-updates", 2
MATRICES = ("F", "Q", "H", "R")
NAMED = ("layout", "keys", "spare_keys", "events", "excluded")
#: The same since version 2.
NEWER = ("switched",)
MOST_STATES = 100_000
"""More than any filter has: a damaged size is found before memory is asked for."""
SAMPLE = 64
"""Every so many updates the writer makes one anew to see whether the posterior comes back."""


# --- writing ----------------------------------------------------------------------------------------------


class _Names:
    """Interned strings and tuples of strings, each with a number."""

    def __init__(self) -> None:
        self.strings: dict[str, int] = {}
        self.tuples: dict[tuple[str, ...], int] = {}

    def number(self, names: tuple[str, ...]) -> int:
        """Return the number of a tuple, entering it and its strings where they are new."""
        if names not in self.tuples:
            self.tuples[names] = len(self.tuples)
            for name in names:
                self.strings.setdefault(name, len(self.strings))
        return self.tuples[names]

    def arrays(self) -> dict[str, npt.NDArray[Any]]:
        """Return the tables as arrays."""
        items = [self.strings[s] for names in self.tuples for s in names]
        # A byte array, not <U: numpy would strip trailing NULs and pad every string to the longest.
        text = json.dumps(list(self.strings)).encode()
        return {
            "strings": np.frombuffer(text, dtype=np.uint8),
            "tuple_items": np.array(items, dtype=np.int32),
            "tuple_offset": _offsets([len(names) for names in self.tuples]),
        }


def write_record(path: Path | str, entries: Iterable[Entry], about: Mapping[str, Any] | None = None) -> None:
    """Write updates in the order in which they were committed; a reader finds the old file or the new one.

    Parameters
    ----------
    path : Path or str
        Where to, by custom ``updates.npz``.
    entries : iterable of (Update, int)
        ``Outcome.updates`` of each outcome, the first of them with ``Outcome.rewound``, the others with 0.
    about : mapping, optional
        Anything JSON can hold that a later audit should know (configuration, noise model).

    Raises
    ------
    InputError
        Where the file cannot be written.
    """
    entries = list(entries)
    updates = [u for u, _ in entries]
    names = _Names()
    arrays: dict[str, npt.NDArray[Any]] = {
        "format": np.array(FORMAT),
        "version": np.array(VERSION),
        "about": np.frombuffer(json.dumps(dict(about or {})).encode(), dtype=np.uint8),
        "t_ns": np.array([u.t_ns for u in updates], dtype=np.int64),
        "rewound": np.array([r for _, r in entries], dtype=np.int32),
        "consumed": np.array([u.consumed for u in updates], dtype=np.int32),
        "columns_F": np.array([u.F.shape[1] for u in updates], dtype=np.int32),
        "reason": np.array([names.number((u.reason,)) for u in updates], dtype=np.int32),
        "layout": np.array([names.number(u.prior.layout.names) for u in updates], dtype=np.int32),
    }
    for name in (*NAMED[1:], *NEWER):
        arrays[name] = np.array([names.number(getattr(u, name)) for u in updates], dtype=np.int32)
    for name in ("nu", "spare_nu", "spare_var"):
        arrays[name] = _joined([getattr(u, name) for u in updates])
    arrays["prior_mean"] = _joined([u.prior.mean for u in updates])
    arrays["posterior_mean"] = _joined([u.posterior.mean for u in updates])
    for name in MATRICES:
        arrays |= _sparse(name, [getattr(u, name) for u in updates])
    arrays |= _auxiliary(updates)
    arrays |= _dense("prior_P", [u.prior.P for u in updates], _unpredicted(entries))
    arrays |= _dense("posterior_P", [u.posterior.P for u in updates], _uncorrected(updates))
    arrays |= names.arrays()
    with atomically(path) as temporary, open(temporary, "wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]


def _offsets(lengths: Sequence[int]) -> npt.NDArray[np.int64]:
    return np.concatenate([[0], np.cumsum(lengths, dtype=np.int64)]).astype(np.int64)


def _joined(parts: Sequence[npt.NDArray[Any]]) -> FloatArray:
    return np.concatenate(parts) if parts else np.zeros(0)


def _sparse(name: str, matrices: Sequence[FloatArray]) -> dict[str, npt.NDArray[Any]]:
    flat = [m.ravel() for m in matrices]
    at = [(f != 0.0).nonzero()[0] for f in flat]  # six times as fast as on the numbers
    index = np.concatenate(at) if at else np.zeros(0, dtype=np.intp)
    small = np.min_scalar_type(int(index.max(initial=0)))
    return {
        f"{name}_index": index.astype(small),
        f"{name}_value": _joined([f[i] for f, i in zip(flat, at, strict=True)]),
        f"{name}_offset": _offsets([len(i) for i in at]),
    }


def _dense(name: str, matrices: Sequence[FloatArray], at: Sequence[int]) -> dict[str, npt.NDArray[Any]]:
    chosen = [np.ravel(matrices[i]) for i in at]
    return {
        f"{name}_at": np.array(at, dtype=np.int64),
        f"{name}_value": _joined(chosen),
        f"{name}_offset": _offsets([len(c) for c in chosen]),
    }


def _auxiliary(updates: Sequence[Update]) -> dict[str, npt.NDArray[Any]]:
    """Return numeric columns of `aux`, one value a row; nan where an update lacks the column."""
    names = [n for n in dict.fromkeys(n for u in updates for n in u.aux) if _is_column(updates, n)]
    out: dict[str, npt.NDArray[Any]] = {
        "aux_names": np.frombuffer(json.dumps(names).encode(), dtype=np.uint8),
        "aux_has": np.array([[n in u.aux for n in names] for u in updates], dtype=bool).reshape(
            len(updates), len(names)
        ),
    }
    for i, n in enumerate(names):
        out[f"aux_{i}"] = _joined(
            [np.asarray(u.aux.get(n, np.full(len(u.keys), np.nan)), dtype=np.float64) for u in updates]
        )
    return out


def _is_column(updates: Sequence[Update], name: str) -> bool:
    values = [np.asarray(u.aux[name]) for u in updates if name in u.aux]
    return all(v.ndim == 1 and v.dtype.kind in "fiub" for v in values)


def _predicted(F: FloatArray, P: FloatArray, Q: FloatArray) -> FloatArray:
    """Return ``F P F^T + Q`` exactly as the estimators do; `P` has no states before a start."""
    return symmetric(sandwich(F, P if F.shape[1] else np.zeros((0, 0))) + Q)


def _unpredicted(entries: Sequence[Entry]) -> list[int]:
    """Return which prior covariances do not follow from the posterior before them."""
    out: list[int] = []
    committed: list[FloatArray] = []
    for i, (u, rewound) in enumerate(entries):
        del committed[len(committed) - rewound :]
        before = committed[-1] if committed else np.zeros((0, 0))
        if u.F.shape[1] not in (0, len(before)) or not np.array_equal(
            _predicted(u.F, before, u.Q), u.prior.P
        ):
            out.append(i)
        committed.append(u.posterior.P)
    return out


def _uncorrected(updates: Sequence[Update]) -> list[int]:
    """Return which posteriors the measurement update does not give back (none where a sample comes back)."""
    some = [i for i in range(len(updates)) if i % SAMPLE < 2]
    if all(_comes_back(updates[i]) for i in some):
        return []
    return [i for i, u in enumerate(updates) if not _comes_back(u)]


def _comes_back(u: Update) -> bool:
    parts = [np.array(a, order="C") for a in (u.nu, u.H, u.R)]
    again = Update.of(Prior(u.prior, u.F, u.Q), u.keys, *parts)
    return np.array_equal(again.posterior.P, u.posterior.P)


# --- reading ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class UpdateRecord:
    """A record of a run. Iterating gives ``(Update, rewound)`` in committed order, each rebuilt in its turn.

    A monitor that is run over it starts anew wherever `rewound` is above 0. The epochs that a repair went
    over then come a second time; what was said at the time is the verdict on their first coming.

    Parameters
    ----------
    path : Path
    about : mapping
        What the writer said about the run.
    arrays : mapping of str to ndarray
        The file's content.
    """

    path: Path
    about: Mapping[str, Any]
    arrays: Mapping[str, npt.NDArray[Any]]

    @property
    def t_ns(self) -> npt.NDArray[np.int64]:
        """Time of every entry, ns of GPS time."""
        return self.arrays["t_ns"]

    def __len__(self) -> int:
        return len(self.t_ns)

    def __iter__(self) -> Iterator[Entry]:
        a = self.arrays
        reader = _Reader(a)
        committed: deque[FloatArray] = deque(maxlen=int(a["rewound"].max(initial=0)) + 2)
        for i, rewound in enumerate(a["rewound"].tolist()):
            for _ in range(min(rewound, len(committed))):
                committed.pop()
            before = committed[-1] if committed else np.zeros((0, 0))
            try:
                update = reader.update(i, before)
            except BROKEN as error:
                raise InputError(
                    f"update {i} does not make sense ({error})", path=self.path, hint=DAMAGED
                ) from error
            committed.append(update.posterior.P)
            yield update, rewound


BROKEN = (
    IndexError,
    ValueError,
    KeyError,
    TypeError,
    AttributeError,
    ArithmeticError,
    RuntimeError,
    np.linalg.LinAlgError,
)
"""What arrays that do not fit each other lead to."""
DAMAGED = "The file is damaged or was not written by pntegrity: run again to make a new one"


class _Reader:
    """Rebuilds updates from the arrays of a record."""

    def __init__(self, arrays: Mapping[str, npt.NDArray[Any]]) -> None:
        self.a = arrays
        strings = _json(arrays["strings"])
        items, at = arrays["tuple_items"].tolist(), arrays["tuple_offset"].tolist()
        self.tuples = [tuple(strings[i] for i in items[s:e]) for s, e in pairwise(at)]
        self.layouts = {int(i): Layout(self.tuples[i]) for i in np.unique(arrays["layout"])}
        self.aux_names = _json(arrays["aux_names"])
        lengths = [len(t) for t in self.tuples]
        self.at = {
            n: _offsets([lengths[i] for i in arrays[n].tolist()]).tolist()
            for n in ("keys", "layout", "spare_keys")
        }
        self.dense = {
            n: {int(i): j for j, i in enumerate(arrays[f"{n}_at"])} for n in ("prior_P", "posterior_P")
        }

    def update(self, i: int, before: FloatArray) -> Update:
        """Return entry `i`, which follows the posterior covariance `before`."""
        layout = self.layouts[int(self.a["layout"][i])]
        keys, n = self._names("keys", i), len(layout)
        t_ns = int(self.a["t_ns"][i])
        m = len(keys)
        F = self._matrix("F", i, (n, int(self.a["columns_F"][i])))
        Q = self._matrix("Q", i, (n, n))
        P, mean = self._covariance("prior_P", i, n), self._part("prior_mean", "layout", i)
        prior = Prior(
            State(t_ns, mean, _predicted(F, before, Q) if P is None else P, layout),
            F, Q, int(self.a["consumed"][i]), self._names("events", i),
        )  # fmt: skip
        u = Update.of(
            prior, keys, self._part("nu", "keys", i), self._matrix("H", i, (m, n)),
            self._matrix("R", i, (m, m)),
            excluded=self._names("excluded", i), reason=self._names("reason", i)[0], aux=self._aux(i),
            spare_keys=self._names("spare_keys", i), spare_nu=self._part("spare_nu", "spare_keys", i),
            spare_var=self._part("spare_var", "spare_keys", i), switched=self._names("switched", i),
        )  # fmt: skip
        return self._with_posterior(
            u, self._part("posterior_mean", "layout", i), self._covariance("posterior_P", i, n)
        )

    def _with_posterior(self, u: Update, mean: FloatArray, P: FloatArray | None) -> Update:
        if P is None and np.array_equal(u.posterior.mean, mean):
            return u
        out = replace(u, posterior=State(u.t_ns, mean, u.posterior.P if P is None else P, u.prior.layout))
        out.__dict__.update({n: u.__dict__[n] for n in ("S", "L", "K")})
        return out

    def _names(self, name: str, i: int) -> tuple[str, ...]:
        return self.tuples[int(self.a[name][i])] if name in self.a else ()

    def _part(self, name: str, by: str, i: int) -> FloatArray:
        start, stop = self.at[by][i], self.at[by][i + 1]
        if stop > len(self.a[name]):
            raise ValueError(f"`{name}` is too short")
        return self.a[name][start:stop]

    def _matrix(self, name: str, i: int, shape: tuple[int, int]) -> FloatArray:
        span = slice(*self.a[f"{name}_offset"][i : i + 2].tolist())
        out = np.zeros(shape)
        out.ravel()[self.a[f"{name}_index"][span]] = self.a[f"{name}_value"][span]
        out.flags.writeable = False
        return out

    def _covariance(self, name: str, i: int, n: int) -> FloatArray | None:
        j = self.dense[name].get(i)
        if j is None:
            return None
        span = slice(*self.a[f"{name}_offset"][j : j + 2].tolist())
        return self.a[f"{name}_value"][span].reshape(n, n)

    def _aux(self, i: int) -> dict[str, FloatArray]:
        has = self.a["aux_has"][i]
        return {n: self._part(f"aux_{j}", "keys", i) for j, n in enumerate(self.aux_names) if has[j]}


def _json(raw: npt.NDArray[np.uint8]) -> Any:
    return json.loads(raw.tobytes())


def read_record(path: Path | str) -> UpdateRecord:
    """Open a record.

    Raises
    ------
    InputError
        Where the file is missing, truncated, damaged, of a newer version, or not a record at all.
    """
    path = Path(path)
    try:
        with open(path, "rb") as file:
            loaded = np.load(file, allow_pickle=False)
            arrays = {name: loaded[name] for name in getattr(loaded, "files", ())}
        _check(arrays, path)
        return UpdateRecord(path, _json(arrays["about"]), arrays)
    except FileNotFoundError as error:
        raise InputError("no such file", path=path, hint="Give the updates.npz of a run") from error
    except InputError:
        raise
    except Exception as error:  # zipfile and numpy's parser raise nearly anything on damaged bytes
        raise InputError("not a whole record of updates", path=path, hint=DAMAGED) from error


def _check(arrays: Mapping[str, npt.NDArray[Any]], path: Path) -> None:
    if str(arrays.get("format", "")) != FORMAT:
        raise InputError("not a record of updates", path=path, hint="Give the updates.npz of a run")
    if int(arrays["version"]) > VERSION:
        raise InputError(
            f"version {int(arrays['version'])} of the record is newer than this pntegrity", path=path
        )
    n = len(arrays["t_ns"])
    per_update = ["rewound", "consumed", "columns_F", "reason", "aux_has", *NAMED]
    per_update += NEWER if int(arrays["version"]) > 1 else ()
    offsets = [f"{m}_offset" for m in MATRICES]
    if any(len(arrays[k]) != n for k in per_update) or any(len(arrays[k]) != n + 1 for k in offsets):
        raise InputError("the tables of the record differ in length", path=path, hint=DAMAGED)
    if n and not 0 <= arrays["columns_F"].min() <= arrays["columns_F"].max() < MOST_STATES:
        raise InputError("a transition of an impossible size", path=path, hint=DAMAGED)
    _Reader(arrays)
