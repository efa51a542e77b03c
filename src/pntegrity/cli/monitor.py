"""``pntegrity monitor``: monitors again, on a recorded run."""

from __future__ import annotations

from pathlib import Path

import click


@click.command(
    "monitor",
    help="Run monitors again on a recorded run (updates.npz, or its folder), without the raw data.",
)
@click.argument("record", type=click.Path(path_type=Path))
@click.option(
    "--monitors",
    default="rctm,srctm,aime,sraime,glr",
    show_default=True,
    help="Comma-separated names, any of `run --monitors`.",
)
@click.option("--variant", type=click.Choice(["exact", "published"]), default="exact", show_default=True)
@click.option(
    "--p-fa", type=float, default=1e-6, show_default=True, help="Probability of a false alarm, an epoch."
)
@click.option("--noise", type=click.Path(path_type=Path), help="Noise file whose threshold factors are used.")
@click.option("--ism", type=click.Path(path_type=Path), help="Integrity support message, for separation.")
@click.option("--out", type=click.Path(path_type=Path), help="Write the verdicts to this Parquet file.")
def command(
    record: Path, monitors: str, variant: str, p_fa: float, noise: Path | None, ism: Path | None,
    out: Path | None,
) -> int:  # fmt: skip
    """Replay a record."""
    from rich.console import Console

    from pntegrity.cli._shared import progress_bar, record_in
    from pntegrity.replay import named_monitors, replay, replay_table, write_verdicts

    chosen = named_monitors(monitors, p_fa, variant, noise, ism)
    with progress_bar() as progress:
        verdicts = replay(record_in(record), chosen, progress)
    if out is not None:
        write_verdicts(out, verdicts)
    Console().print(replay_table(verdicts))
    return 0
