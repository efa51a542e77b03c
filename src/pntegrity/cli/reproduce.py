"""``pntegrity reproduce``: published experiments."""

from __future__ import annotations

from pathlib import Path

import click

#: Noise realisations of an experiment where nothing else is asked for.
USUAL = {"sraime-spp": 20, "sraime-ppp": 20, "ppp-rtk": 20, "factor-set": 3, "multi-level": 200}


@click.command("reproduce", help="Run a published experiment and show its figures beside the published ones.")
@click.argument("experiment", type=click.Choice(list(USUAL)))
@click.option(
    "--json", "as_json", is_flag=True, help='Print {"rows": [{"quantity", "published", "measured", "ok"}]}.'
)
@click.option(
    "--seeds",
    type=click.IntRange(1),
    show_default="20; factor-set 3, multi-level 200",
    help="Noise realisations.",
)
@click.option(
    "--data",
    type=click.Path(path_type=Path),
    help="Folder of the real logs: sraime-ppp then drives the real track under the real orbits, "
    "ppp-rtk has real orbits; factor-set needs it.",
)
def command(experiment: str, as_json: bool, seeds: int | None, data: Path | None) -> int:
    """Reproduce an experiment."""
    from importlib import import_module

    from threadpoolctl import threadpool_limits

    module = import_module(f"pntegrity.scenarios.reproduce_{experiment.replace('-', '_')}")
    more = {"data": data} if experiment in ("sraime-ppp", "ppp-rtk", "factor-set") else {}
    with threadpool_limits(1, user_api="blas"):
        result = module.reproduce(USUAL[experiment] if seeds is None else seeds, **more)
    if as_json:
        click.echo(result.to_json())
        return 0
    from rich.console import Console

    Console().print(result.table())
    return 0
