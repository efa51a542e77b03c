"""``pntegrity reproduce``: published experiments."""

from __future__ import annotations

from pathlib import Path

import click


@click.command("reproduce", help="Run a published experiment and show its figures beside the published ones.")
@click.argument("experiment", type=click.Choice(["sraime-spp", "sraime-ppp", "ppp-rtk", "factor-set"]))
@click.option(
    "--json", "as_json", is_flag=True, help='Print {"rows": [{"quantity", "published", "measured", "ok"}]}.'
)
@click.option("--seeds", type=click.IntRange(1), show_default="20; factor-set 3", help="Noise realisations.")
@click.option(
    "--data",
    type=click.Path(path_type=Path),
    help="Folder of the real logs: sraime-ppp then drives the real track under the real orbits, "
    "ppp-rtk has real orbits; factor-set needs it.",
)
def command(experiment: str, as_json: bool, seeds: int | None, data: Path | None) -> int:
    """Reproduce an experiment."""
    from threadpoolctl import threadpool_limits

    from pntegrity.scenarios import (
        reproduce_factor_set,
        reproduce_ppp_rtk,
        reproduce_sraime_ppp,
        reproduce_sraime_spp,
    )

    usual = 3 if experiment == "factor-set" else 20
    seeds = usual if seeds is None else seeds
    with threadpool_limits(1, user_api="blas"):
        if experiment == "sraime-ppp":
            result = reproduce_sraime_ppp.reproduce(seeds, data=data)
        elif experiment == "ppp-rtk":
            result = reproduce_ppp_rtk.reproduce(seeds, data=data)
        elif experiment == "factor-set":
            result = reproduce_factor_set.reproduce(seeds, data=data)
        else:
            result = reproduce_sraime_spp.reproduce(seeds)
    if as_json:
        click.echo(result.to_json())
        return 0
    from rich.console import Console

    Console().print(result.table())
    return 0
