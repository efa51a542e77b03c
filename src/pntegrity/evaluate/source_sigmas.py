"""The sigmas of a vehicle's sources as named numbers, and what each has in the covariance of its rows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from math import nan, sqrt
from typing import Any

import numpy as np
import numpy.typing as npt

from pntegrity.evaluate.likelihood import Part, Values
from pntegrity.evaluate.overbound import lasting
from pntegrity.evaluate.whiteness import judged
from pntegrity.kernels.linear import inverse_lower
from pntegrity.records import FloatArray, State, Update
from pntegrity.sensors.noise import Fitted
from pntegrity.sensors.source import Source

__all__ = [
    "gives_position",
    "parameters_of",
    "raised",
    "ratios",
    "shares",
    "source_and_field",
    "value_of",
    "with_values",
]

#: How many times larger or smaller than it was given a sigma may become.
WIDEST = 100.0
#: Factor at which the covariance of rows is asked what of it a sigma is.
NEARBY = 1.25


def parameters_of(sources: Sequence[Source]) -> list[Fitted]:
    """Return what is to be fitted, ``"<source>.<field>"``; what is zero stays so."""
    found = []
    for s in sources:
        for field in getattr(s, "fitted", ()):
            value = float(getattr(s, field))
            if value > 0.0:
                found.append(Fitted(f"{s.name}.{field}", value / WIDEST, value * WIDEST, None, "white"))
    return found


def source_and_field(name: str) -> tuple[str, str]:
    """Return the source and the field of a sigma's name."""
    source, _, field = name.partition(".")
    return source, field


def value_of(sources: Sequence[Source], name: str) -> float:
    """Return the sigma of a name."""
    source, field = source_and_field(name)
    return float(next(getattr(s, field) for s in sources if s.name == source))


def gives_position(sources: Sequence[Source], name: str) -> bool:
    """Tell whether the source of a sigma gives a whole position by itself."""
    return any(_is_of(s, name) and hasattr(s, "position") for s in sources)


def with_values(sources: Sequence[Source], values: Values) -> tuple[Source, ...]:
    """Return sources with other sigmas."""
    return tuple(
        _changed(s, {source_and_field(n)[1]: v for n, v in values.items() if _is_of(s, n)}) for s in sources
    )


def _is_of(source: Source, name: str) -> bool:
    return source_and_field(name)[0] == source.name


def _changed(source: Any, fields: dict[str, float]) -> Any:
    return replace(source, **fields)


@dataclass(frozen=True, eq=False)
class Share:
    """Which rows of an update may depend on a sigma, and what a larger one adds to their covariance."""

    rows: npt.NDArray[np.intp]
    change: FloatArray


def shares(
    part: Part[Values], values: Values, parameters: Sequence[Fitted]
) -> Iterator[tuple[Update, dict[str, Share]]]:
    """Yield each update, and what each sigma has in the covariance of its rows."""
    model, state = part.made(values), State.empty()
    others = {
        p.name: _alone(part.made({**values, p.name: NEARBY * values[p.name]}), p.name) for p in parameters
    }
    for i, epoch in enumerate(part.epochs):
        out = part.left_out[i] if part.left_out else frozenset()
        prior = model.predict(state, epoch)
        update = model.correct(prior, epoch, out)
        state = update.posterior
        yield update, {n: _share(update, other.correct(prior, epoch, out)) for n, other in others.items()}


def _alone(model: Any, name: str) -> Any:
    """Return a filter with the source of a sigma alone."""
    own = tuple(s for s in model.options.sources if _is_of(s, name))
    return replace(model, options=replace(model.options, sources=own))


def _share(update: Update, larger: Update) -> Share:
    rows = np.array([update.keys.index(k) for k in larger.keys], dtype=np.intp)
    return Share(rows, larger.R - update.R[np.ix_(rows, rows)])


def raised(part: Part[Values], values: Values, parameters: Sequence[Fitted]) -> dict[str, float]:
    """Return by how much each sigma must grow since the errors of its rows last."""
    series: dict[str, dict[str, list[float]]] = {p.name: {} for p in parameters}
    for update, of in islice(shares(part, values, parameters), part.settle, None):
        unit = judged(update)
        for name, share in of.items():
            for i in share.rows[np.diagonal(share.change) > 0.0]:
                series[name].setdefault(update.keys[i], []).append(float(unit[i]))
    return {n: lasting([np.array(x) for x in rows.values()]) for n, rows in series.items()}


def ratios(
    part: Part[Values], values: Values, parameters: Sequence[Fitted], cut: int = 0
) -> dict[str, float]:
    """Return how large errors are in units of each sigma, after some epochs; nan where no row has it.

    With ``D`` what of the covariance a sigma is, the likelihood is stationary where ``sum nu^T S^-1 D S^-1
    nu`` is ``sum tr(S^-1 D)``; the root of their ratio is returned.
    """
    sums: dict[str, FloatArray] = {}
    for i, (update, of) in enumerate(shares(part, values, parameters)):
        sums = {n: sums.get(n, np.zeros(2)) for n in of}
        if i >= cut and len(update.keys) and not update.is_start:
            root = inverse_lower(update.L)
            inverse, weighed = root.T @ root, root.T @ update.white
            for n, s in of.items():
                nu, own = weighed[s.rows], inverse[np.ix_(s.rows, s.rows)]
                sums[n] = sums[n] + [nu @ s.change @ nu, np.sum(own * s.change)]
    return {n: sqrt(a / b) if b > 0.0 else nan for n, (a, b) in sums.items()}
