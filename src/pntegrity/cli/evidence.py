"""``pntegrity evidence``: the measured figures behind docs/results.md."""

from __future__ import annotations

from pathlib import Path

import click

NAMES = (
    "spp8", "clean", "delays", "faults", "receivers", "speed", "ppp", "ppp-clean", "ppp-drive", "ppp-van",
    "ppp-ramps", "ppp-faults", "ppp-speed", "sraime-spp", "sraime-ppp",
    "rtk-cases", "rtk-risk", "ppp-rtk",
    "rtk-speed",
    "rtk-opec", "rtk-opec-faults", "rtk-clas", "rtk-clas-ramp",
    "factor-set-rate", "city-thresholds", "city-moderate", "city-full", "city-low-cost", "city-open",
    "city-tst", "city-levels", "city-nees", "ins-real", "mechanisation", "ins-speed",
    "acoustics", "vessels", "multi-level", "vessel-cases", "vessel-pairs", "vessel-noise", "vessel-speed",
)  # fmt: skip


@click.command("evidence", help="Measure the figures of docs/results.md again.")
@click.argument("campaign", type=click.Choice([*NAMES, "all"]), default="all")
@click.option(
    "--data",
    type=click.Path(path_type=Path),
    help="Folder of the real logs; without it those campaigns are left out.",
)
@click.option(
    "--write",
    type=click.Path(path_type=Path),
    help="Markdown page in which to replace the campaigns' sections.",
)
@click.option(
    "--json",
    "as_json",
    is_flag=True,
    help='Print {"rows": [{"campaign", "quantity", "must", "measured", ...}]}.',
)
def command(campaign: str, data: Path | None, write: Path | None, as_json: bool) -> int:
    """Run campaigns; the exit status is 1 where a requirement is not met."""
    import json

    from pntegrity.formats.atomic import write_text
    from pntegrity.scenarios.results import page, run_campaign

    rows = []
    for name in NAMES if campaign == "all" else (campaign,):
        own = run_campaign(name, data)
        rows += own
        if not as_json:
            _show(name, own)
        if write is not None and own[0]["quantity"] != "not run":
            text = write.read_text(encoding="utf-8") if write.is_file() else ""
            write_text(write, page(text, {name: own}))
    if as_json:
        click.echo(json.dumps({"rows": rows}, indent=1))
    return int(any(r["ok"] is False for r in rows))


def _show(name: str, rows: list[dict[str, object]]) -> None:
    from rich.console import Console

    from pntegrity.scenarios._table import rows_table
    from pntegrity.scenarios.results import CAMPAIGNS, summary_line

    console = Console()
    console.print(rows_table([{**r, "published": r["must"]} for r in rows], CAMPAIGNS[name].title))
    console.print(summary_line(rows), highlight=False)
