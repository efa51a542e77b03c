"""``pntegrity reproduce``: published experiments."""

from __future__ import annotations

import click


@click.command("reproduce", help="Run a published experiment and show its figures beside the published ones.")
@click.argument("experiment", type=click.Choice(["sraime-spp"]))
@click.option(
    "--json", "as_json", is_flag=True, help='Print {"rows": [{"quantity", "published", "measured", "ok"}]}.'
)
@click.option("--seeds", type=click.IntRange(1), default=20, show_default=True, help="Noise realisations.")
def command(experiment: str, as_json: bool, seeds: int) -> int:
    """Reproduce an experiment."""
    from pntegrity.scenarios.reproduce_sraime_spp import reproduce

    result = reproduce(seeds=seeds)
    if as_json:
        click.echo(result.to_json())
        return 0
    from rich.console import Console

    Console().print(result.table())
    return 0
