"""``pntegrity demo``: the main job on the embedded scenario."""

from __future__ import annotations

from pathlib import Path

import click


@click.command(
    "demo", help="The main job on a small embedded scenario with known faults; works offline, in seconds."
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("demo-results"),
    show_default=True,
    help="Results folder.",
)
def command(out: Path) -> int:
    """Run the embedded scenario."""
    from pntegrity.cli.run import execute
    from pntegrity.config import make_config
    from pntegrity.scenarios.demo import demo_paths

    with demo_paths() as demo:
        return execute(make_config({"obs": demo.obs, "nav": (demo.nav,), "truth": demo.truth}), out)
