"""``pntegrity calibrate``: fit the noise model, or the sigmas of a vehicle's sources, to a log."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pntegrity.cli._shared import INERTIAL, INPUT, build_config, options, progress_bar

if TYPE_CHECKING:
    from rich.console import Group

    from pntegrity.config import RunConfig

#: What to do about the noise of an inertial filter whose own detection drops rows as it sees fit.
INSTEAD = (
    'describe the vehicle with [[source]] tables (estimator = "multi_source", types gnss, fix, ...): their '
    "sigmas can be fitted; or give a [noise] table in the file of --config"
)


@click.command(
    "calibrate",
    help="Fit the noise model to the first part of a receiver's log and judge it on the rest; of a vehicle "
    "(--config vehicle.toml) the sigmas of its sources.",
)
@options(INPUT, INERTIAL)
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Noise file to write (TOML).")
@click.option(
    "--split", type=click.FloatRange(0.1, 0.9), default=0.5, show_default=True, help="Share that is fitted."
)
def command(out: Path, split: float, **values: Any) -> int:
    """Calibrate from options."""
    from rich.console import Console

    from pntegrity.errors import InputError
    from pntegrity.estimators import discover
    from pntegrity.formats.atomic import write_text

    config = build_config(values)
    if not config.source and not discover()[config.estimator].fitted:
        raise InputError(f"--estimator {config.estimator}: nothing to fit", hint=INSTEAD)
    text, table = (_sources if config.source else _model)(config, split)
    write_text(out, text)
    Console().print(table)
    click.echo(f"noise model: {out}")
    return 0


def _model(config: RunConfig, split: float) -> tuple[str, Group]:
    """Return the noise file of a receiver, and what is shown."""
    from pntegrity.config import write_noise
    from pntegrity.estimators import discover
    from pntegrity.evaluate.calibrate import calibrate
    from pntegrity.evaluate.calibration_table import calibration_facts, calibration_table
    from pntegrity.run import load_epochs, options_for

    loaded = load_epochs(config)
    with progress_bar() as progress:
        result = calibrate(
            loaded.epochs, options_for(config, loaded), lambda p, noise: config.build_monitors(p, noise),
            estimator=discover()[config.estimator],
            split=split,
            p_fa=config.p_fa, progress=lambda what, done: progress(what, int(100 * done), 100),
        )  # fmt: skip
    return write_noise(result.noise, calibration_facts(result)), calibration_table(result)


def _sources(config: RunConfig, split: float) -> tuple[str, Group]:
    """Return the noise file of a vehicle, and what is shown."""
    from pntegrity.config import to_toml
    from pntegrity.evaluate.calibrate_sources import calibrate_sources
    from pntegrity.evaluate.calibration_table import source_facts, source_table
    from pntegrity.run import load_epochs, options_for

    loaded = load_epochs(config)
    with progress_bar() as progress:
        result = calibrate_sources(
            loaded.epochs, options_for(config, loaded), config.build_monitors(), split=split,
            p_fa=config.p_fa, progress=lambda what, done: progress(what, int(100 * done), 100),
        )  # fmt: skip
    noise = {"sources": result.tables()}
    return to_toml({"noise": noise, "calibration": source_facts(result)}), source_table(result)
