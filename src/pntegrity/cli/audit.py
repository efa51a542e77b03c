"""``pntegrity audit``: what a monitor keeps and sees on the geometry of a record."""

from __future__ import annotations

from pathlib import Path

import click


@click.command(
    "audit",
    help="Audit a monitor on the geometry of a recorded run (updates.npz, or its folder): P_FA, and what it "
    "would see.",
)
@click.argument("record", type=click.Path(path_type=Path))
@click.option("--monitor", "name", required=True, help="Name of any monitor, as for `run --monitors`.")
@click.option("--variant", type=click.Choice(["exact", "published"]), default="exact", show_default=True)
@click.option(
    "--p-fa", type=float, default=1e-3, show_default=True, help="Probability of a false alarm, an epoch."
)
@click.option(
    "--tests",
    type=click.IntRange(0),
    default=1_000_000,
    show_default=True,
    help="Monte Carlo epoch-tests; 0: none.",
)
@click.option(
    "--power",
    type=click.FloatRange(0.5, 0.999999),
    default=0.999,
    show_default=True,
    help="Probability of being seen.",
)
@click.option(
    "--delay",
    "delays",
    type=click.FloatRange(0.0, min_open=True),
    multiple=True,
    help="Delay of ramps, s; repeatable.  [10 30 60]",
)
@click.option(
    "--onsets",
    type=click.IntRange(0),
    default=5,
    show_default=True,
    help="Onsets spread over the record; 0: none.",
)
@click.option("--ism", type=click.Path(path_type=Path), help="Integrity support message, for separation.")
@click.option("--seed", type=int, default=1, show_default=True, help="Seed of the Monte Carlo.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def command(
    record: Path, name: str, variant: str, p_fa: float, tests: int, power: float, delays: tuple[float, ...],
    onsets: int, ism: Path | None,
    seed: int, as_json: bool,
) -> int:  # fmt: skip
    """Audit a monitor."""
    import json

    import numpy as np

    from pntegrity.cli._shared import record_in
    from pntegrity.errors import InputError
    from pntegrity.evaluate.audit import audit
    from pntegrity.evaluate.audit_table import audit_json, audit_table
    from pntegrity.evaluate.montecarlo import Planner
    from pntegrity.formats.update_record import read_record
    from pntegrity.replay import named_monitors

    (monitor,) = named_monitors(name, p_fa, variant, None, ism) if "," not in name else (None,)
    if monitor is None:
        raise InputError(f"--monitor takes one name, not {name!r}")
    if not isinstance(monitor, Planner):
        raise InputError(f"{name} cannot be audited: it does not plan its tests without data")
    updates = [update for update, _ in read_record(record_in(record))]
    if not updates:
        raise InputError("the record holds no epoch", path=record)
    rng = np.random.default_rng(seed)
    result = audit(
        updates,
        monitor,
        rng=rng,
        tests=tests,
        power=power,
        delays_s=delays or (10.0, 30.0, 60.0),
        onsets=onsets,
    )
    if as_json:
        click.echo(json.dumps(audit_json(result), indent=1))
        return 0
    from rich.console import Console

    Console().print(audit_table(result))
    return 0
