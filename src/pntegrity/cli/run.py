"""``pntegrity run``: the main job."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pntegrity.cli._shared import INERTIAL, INPUT, MONITORING, build_config, options, progress_bar

if TYPE_CHECKING:
    from pntegrity.config import RunConfig


@click.command("run", help="Monitor a real log: RINEX in, verdicts, exclusions and a report out.")
@options(INPUT, INERTIAL, MONITORING)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    required=True,
    help="Folder for the results; made where missing.",
)
def command(out: Path, **values: Any) -> int:
    """Run from options."""
    return execute(build_config(values), out)


def execute(config: RunConfig, out: Path) -> int:
    """Run a configuration, write its results, print the table; return the exit status (130 after an
    interrupt).
    """
    from rich.console import Console

    from pntegrity.config import to_toml
    from pntegrity.formats.atomic import write_text
    from pntegrity.report.terminal import verdict_table
    from pntegrity.report.write import results_folder, write_results
    from pntegrity.run import run

    results_folder(out)  # before the work, not after it
    with progress_bar() as progress:
        result = run(config, progress)
        paths = write_results(out, result.outcomes, result.facts)
    write_text(out / "config.toml", to_toml(config.model_dump(mode="json", exclude_none=True)))
    console = Console()
    console.print(verdict_table(result.outcomes, result.facts))
    console.print(f"report: {paths['report']}", soft_wrap=True, highlight=False)
    if result.facts.interrupted:
        click.echo(f"interrupted: the {len(result.outcomes)} epochs done so far were written", err=True)
        return 130
    return 0
