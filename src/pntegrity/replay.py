"""Monitors again, over a record: the same verdicts as in the run, or those of other monitors."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pntegrity.bounds.ism import Ism
from pntegrity.config import has_option, make_monitor, noise_of, read_ism, read_noise
from pntegrity.errors import InputError
from pntegrity.formats.atomic import atomically
from pntegrity.formats.update_record import read_record
from pntegrity.monitors import discover
from pntegrity.protocols import Monitor, begun_again, judged, resumes
from pntegrity.records import Update, Verdict

if TYPE_CHECKING:
    from rich.table import Table

#: Updates before which memories are kept: as many as any pipeline goes back.
REMEMBERED = 400

__all__ = ["monitored", "named_monitors", "replay", "replay_table", "write_verdicts"]


def named_monitors(
    names: str, p_fa: float, variant: str, noise: Path | None, ism: Path | None = None
) -> tuple[Monitor, ...]:
    """Return monitors from comma-separated names; those with protection levels get the integrity support
    message.

    Raises
    ------
    InputError
        Where a name or an option is not possible.
    """
    try:
        model = noise_of(read_noise(noise)) if noise else None
    except ValueError as error:
        raise error if isinstance(error, InputError) else InputError(str(error), path=noise) from None
    out = []
    for name in (n.strip() for n in names.split(",") if n.strip()):
        if name not in discover():
            raise InputError(
                f"no monitor is called {name!r}", hint=f"There are {', '.join(sorted(discover()))}"
            )
        if not 0.0 < p_fa < 0.5:
            raise InputError(f"--p-fa {p_fa} is not a probability between 0 and 0.5")
        options = {"ism": Ism.from_table(read_ism(ism))} if ism and has_option(name, "ism") else {}
        out.append(make_monitor(name, p_fa, variant, model, options))
    if not out:
        raise InputError("no monitor was named", hint=f"There are {', '.join(sorted(discover()))}")
    return tuple(out)


def monitored(
    entries: Iterable[tuple[Update, int]], monitors: Sequence[Monitor]
) -> Iterable[tuple[Update, list[Verdict]]]:
    """Yield every committed update with its verdicts; where a repair replaced the past, memories begin anew,
    or go on from there, as they did.
    """
    memories: tuple[Any, ...] = tuple(m.start() for m in monitors)
    before: deque[tuple[Any, ...]] = deque(maxlen=REMEMBERED if any(map(resumes, monitors)) else 0)
    for update, rewound in entries:
        if rewound:
            memories = _rewound(monitors, before, rewound)
        before.append(memories)
        verdicts, memories = judged(monitors, memories, update)
        yield update, list(verdicts)


def _rewound(monitors: Sequence[Monitor], before: deque[tuple[Any, ...]], rewound: int) -> tuple[Any, ...]:
    """Return the memories at the first of the updates that a repair replaced, and forget these."""
    there = before[-rewound] if rewound <= len(before) else ()
    for _ in range(min(rewound, len(before))):
        before.pop()
    return begun_again(monitors, there)


def replay(
    path: Path,
    monitors: Sequence[Monitor],
    progress: Callable[[str, int, int], None] = lambda stage, done, total: None,
) -> list[Verdict]:
    """Return the verdicts of monitors on a record."""
    record = read_record(path)
    out: list[Verdict] = []
    for i, (_, verdicts) in enumerate(monitored(record, monitors)):
        out += verdicts
        progress("monitoring", i + 1, len(record))
    return out


def write_verdicts(path: Path, verdicts: Sequence[Verdict]) -> None:
    """Write verdicts as a Parquet table."""
    from pntegrity.report.tables import verdict_frame

    with atomically(path) as temporary:
        verdict_frame(verdicts).write_parquet(temporary)


def replay_table(verdicts: Sequence[Verdict]) -> Table:
    """Return a line a monitor: how often it tested and alarmed, and its worst ratio to the threshold."""
    from rich.table import Table

    table = Table(
        "monitor", "variant", "tests", "alarms", "unavailable", "worst ratio", "at", box=None, pad_edge=False
    )
    for name in dict.fromkeys(v.monitor for v in verdicts):
        own = [v for v in verdicts if v.monitor == name]
        tests = [v for v in own if v.status != "unavailable"]
        worst = max(tests, key=lambda v: v.statistic / v.threshold, default=None)
        table.add_row(
            name, own[0].variant, str(len(tests)), str(sum(v.status == "alert" for v in tests)),
            str(len(own) - len(tests)),
            f"{worst.statistic / worst.threshold:.2f}" if worst else "-",
            _clock(worst.t_ns) if worst else "-",
        )  # fmt: skip
    return table


def _clock(t_ns: int) -> str:
    from pntegrity.physics.time import to_iso

    return to_iso(t_ns)
