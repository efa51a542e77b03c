"""All result files of a run, each whole or not there at all."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

from pntegrity.errors import InputError
from pntegrity.formats.atomic import atomically
from pntegrity.formats.update_record import Entry, write_record
from pntegrity.pipeline import Outcome
from pntegrity.report.columns import is_vehicle
from pntegrity.report.facts import RunFacts
from pntegrity.report.html import page
from pntegrity.report.screening import dropped, screening
from pntegrity.report.source_tables import proofs, sensors
from pntegrity.report.summary import summary
from pntegrity.report.tables import exclusions, solution, verdicts

__all__ = ["entries", "results_folder", "write_results"]

SCREENING, DROPPED = "screening.parquet", "screening_dropped.csv"
"""Files that only runs have whose estimator detects faults of its own."""
SENSORS, PROOFS = "sensors.parquet", "proofs.csv"
"""Files that only runs of vehicles with sources have."""
Writers = dict[str, tuple[str, Callable[[Path], object]]]
"""What a file is -> its name, and what writes it."""


def entries(outcomes: Sequence[Outcome]) -> list[Entry]:
    """Return the updates in committed order, the first of an outcome with how many earlier it replaces."""
    return [(u, 0 if i else o.rewound) for o in outcomes for i, u in enumerate(o.updates)]


def write_results(out: Path | str, outcomes: Sequence[Outcome], facts: RunFacts) -> dict[str, Path]:
    """Write the results of a run, finished or interrupted, into a folder; it is made where it is missing.

    Parameters
    ----------
    out : Path or str
        Folder.
    outcomes : sequence of Outcome
        May be empty.
    facts : RunFacts

    Returns
    -------
    dict
        Path of each file: ``solution`` and ``verdicts`` (parquet), ``exclusions`` (csv), ``updates`` (npz),
        ``summary`` (json), ``report`` (html); and ``screening`` (parquet) and ``dropped`` (csv) where the
        estimator detects faults of its own; ``sensors`` (parquet) and ``proofs`` (csv) where a vehicle has
        sources with sensors. Those of an earlier run that this one does not have are removed.

    Raises
    ------
    InputError
        Where the folder cannot be made or written. A file that was there before is then as it was.
    """
    folder = results_folder(Path(out))
    table = solution(outcomes, facts)
    numbers = summary(outcomes, facts, table)
    about = {"estimator": facts.estimator, "noise_model": facts.noise_name, "config": dict(facts.config)}
    writers: Writers = {
        "solution": ("solution.parquet", table.write_parquet),
        "verdicts": ("verdicts.parquet", verdicts(outcomes).write_parquet),
        "exclusions": ("exclusions.csv", exclusions(outcomes).write_csv),
        "updates": ("updates.npz", lambda p: write_record(p, entries(outcomes), about)),
        "summary": (
            "summary.json",
            lambda p: p.write_text(json.dumps(numbers, indent=2, allow_nan=False) + "\n", "utf-8"),
        ),
        "report": (
            "report.html",
            lambda p: p.write_text(page(outcomes, facts, numbers, table), "utf-8", "replace"),
        ),
    }
    writers |= _of_some_runs(outcomes)
    written = {file for file, _ in writers.values()}
    for file in {SCREENING, DROPPED, SENSORS, PROOFS} - written:
        _remove(folder / file)
    paths = {}
    for name, (file, write) in writers.items():
        paths[name] = folder / file
        with atomically(paths[name]) as temporary:
            write(temporary)
    return paths


def _of_some_runs(outcomes: Sequence[Outcome]) -> Writers:
    """Return what writes the files that only some runs have."""
    writers: Writers = {}
    screened = screening(outcomes)
    if len(screened):
        writers["screening"] = (SCREENING, screened.write_parquet)
        writers["dropped"] = (DROPPED, dropped(outcomes).write_csv)
    if is_vehicle(outcomes):
        writers["sensors"] = (SENSORS, sensors(outcomes).write_parquet)
        writers["proofs"] = (PROOFS, proofs(outcomes).write_csv)
    return writers


def _remove(path: Path) -> None:
    """Remove what an earlier run left and this one does not have.

    Raises
    ------
    InputError
        Where it cannot be removed.
    """
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(
            f"this file of an earlier run cannot be removed: {error.strerror}", path=path,
            hint="Remove it, or choose another folder with --out",
        ) from error  # fmt: skip


def results_folder(out: Path) -> Path:
    """Return the folder, made where it is missing.

    Raises
    ------
    InputError
        Where it cannot be made.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        why = "there is a file of that name" if out.exists() else error.strerror or str(error)
        raise InputError(
            f"the folder cannot be made: {why}", path=out, hint="Choose another with --out"
        ) from error
    return out
