"""What the quadratic monitors share: a window of updates, a form over it, the verdict and the naming of
suspects.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from pntegrity.kernels.signatures import Signature, catalogue, masks
from pntegrity.kernels.tails import chi2_threshold
from pntegrity.kernels.windows import Form, QuadraticTest, respond
from pntegrity.records import FloatArray, Layout, Suspect, Update, Verdict

Window = tuple[Update, ...]


def unavailable(monitor: str, variant: str, update: Update, reason: str) -> Verdict:
    """Return the verdict of a test that could not be made."""
    return Verdict(monitor, variant, update.t_ns, "unavailable", reason=reason)


def quadratic_test(
    form: Form | None, update: Update, *, p_fa: float, factor: float, consumed: int = 0, reason: str = ""
) -> QuadraticTest:
    """Return the test of a form; without one, or without degrees of freedom, the reason why there is none."""
    if form is None:
        return QuadraticTest(None, reason=reason or no_redundancy(update))
    dof = form.dof - consumed
    if dof <= 0:
        return QuadraticTest(None, reason=no_redundancy(update))
    return QuadraticTest(form, factor * chi2_threshold(p_fa, dof), p_fa, dof)


def judge(
    monitor: str, variant: str, test: QuadraticTest, window: Window, statistic: float, p_fa: float
) -> Verdict:
    """Return the verdict of a test on the last update of its window, with suspects where it alarms; `p_fa` is
    what the whole monitor stands for.
    """
    assert test.form is not None
    facts = (statistic, test.threshold, p_fa, test.dof)
    if statistic <= test.threshold:
        return Verdict(monitor, variant, window[-1].t_ns, "ok", *facts)
    suspects = name_suspects(window, test.form)
    return Verdict(monitor, variant, window[-1].t_ns, "alert", *facts, suspects, is_ambiguous(suspects))


def judge_alone(monitor: str, variant: str, test: QuadraticTest, update: Update) -> Verdict:
    """Return the verdict of a test of one update."""
    if test.form is None:
        return unavailable(monitor, variant, update, test.reason)
    statistic = float(test.form.statistic([update.white]))
    return judge(monitor, variant, test, (update,), statistic, test.p_fa)


def no_redundancy(update: Update) -> str:
    """Say why an epoch cannot be tested."""
    if not update.keys:
        return update.reason or "no measurements"
    return f"no redundancy: {len(update.keys)} rows, {update.consumed} states initialised from them"


def block_of(update: Update, block: str) -> npt.NDArray[np.intp]:
    """Return where the states of `block` stand: names joined by ``+``, all states for an empty one."""
    return _places(update.prior.layout, block)


@lru_cache(maxsize=1024)
def _places(layout: Layout, block: str) -> npt.NDArray[np.intp]:
    if not block:
        return np.arange(len(layout))
    found = np.concatenate([layout.block(part) for part in block.split("+")])
    return np.array(list(dict.fromkeys(found.tolist())), dtype=np.intp)


def state_test_reason(update: Update, block: str) -> str:
    """Say why a test of the state cannot be made."""
    if not update.keys:
        return no_redundancy(update)
    if update.is_start:
        return "no prior: the state was initialised from this epoch's own data"
    if not len(block_of(update, block)):
        return f"no such states: {block!r}"
    return f"no state of {block!r} lives through the window"


def is_ambiguous(suspects: tuple[Suspect, ...], margin: float = 9.0) -> bool:
    """Tell whether the second suspect explains the data nearly as well (log-likelihood ratio within `margin`
    / 2).
    """
    return len(suspects) > 1 and suspects[0].statistic - suspects[1].statistic < margin


def name_suspects(window: Window, form: Form, most: int = 4) -> tuple[Suspect, ...]:
    """Return the groups whose fault since the window's start explains the form's vector best.

    For each signature the mean response ``m`` of the form's whitened vector ``y`` is computed; ``(m.y)^2 /
    m.m`` is what it explains and ``m.y / m.m`` the size. For a window of one epoch this is Baarda's w-test.
    """
    signatures = tuple(s for kind in _kinds(window) for s in catalogue(window[-1].keys, kind))
    means = form.project(_responses(window, signatures))
    y = form.project([u.white for u in window])
    power = np.sum(means * means, axis=0)
    safe = np.where(power > 1e-12, power, np.inf)
    dot = y @ means
    return best_of_groups(signatures, dot * dot / safe, dot / safe, [window[0].t_ns] * len(signatures), most)


def best_of_groups(
    signatures: tuple[Signature, ...], explained: FloatArray, size: FloatArray, onset_ns: list[int], most: int
) -> tuple[Suspect, ...]:
    """Return the best signature of each set of groups as suspects, the most likely first."""
    best: dict[tuple[str, ...], Suspect] = {}
    for i in np.argsort(-explained, kind="stable"):
        s = signatures[i]
        if s.groups not in best:
            best[s.groups] = Suspect(s.groups, s.kind, float(size[i]), int(onset_ns[i]), float(explained[i]))
        if len(best) > most:
            break
    return tuple(best.values())[:most]


def _kinds(window: Window) -> tuple[str, ...]:
    return ("bias",) if len(window) == 1 else ("bias", "ramp")


def _responses(window: Window, signatures: tuple[Signature, ...]) -> list[FloatArray]:
    from pntegrity.kernels.linear import whiten

    E = np.zeros((window[0].F.shape[1], len(signatures)))
    out = []
    start = window[0].t_ns - _interval(window)
    for u in window:
        growing, constant = masks(signatures, u.keys)
        tau = (u.t_ns - start) * 1e-9
        g, E = respond(E, u.F, u.H, u.K, growing * tau + constant)
        out.append(whiten(u.L, g))
    return out


def _interval(window: Window) -> int:
    return window[1].t_ns - window[0].t_ns if len(window) > 1 else 0
