"""``pntegrity calibrate``: fit the noise model to a log."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from pntegrity.cli._shared import INERTIAL, INPUT, build_config, options, progress_bar


@click.command(
    "calibrate", help="Fit the noise model to the first part of a receiver's log and judge it on the rest."
)
@options(INPUT, INERTIAL)
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Noise file to write (TOML).")
@click.option(
    "--split", type=click.FloatRange(0.1, 0.9), default=0.5, show_default=True, help="Share that is fitted."
)
def command(out: Path, split: float, **values: Any) -> int:
    """Calibrate from options."""
    from rich.console import Console

    from pntegrity.config import write_noise
    from pntegrity.errors import InputError
    from pntegrity.estimators import discover
    from pntegrity.evaluate.calibrate import calibrate
    from pntegrity.evaluate.calibration_table import calibration_facts, calibration_table
    from pntegrity.formats.atomic import write_text
    from pntegrity.run import load_epochs, options_for

    config = build_config(values)
    if not discover()[config.estimator].fitted:
        raise InputError(
            f"--estimator {config.estimator}: nothing to fit",
            hint="Its noise cannot be calibrated; give a [noise] table in the file of --config",
        )
    loaded = load_epochs(config)
    with progress_bar() as progress:
        result = calibrate(
            loaded.epochs, options_for(config, loaded), lambda p, noise: config.build_monitors(p, noise),
            estimator=discover()[config.estimator],
            split=split,
            p_fa=config.p_fa, progress=lambda what, done: progress(what, int(100 * done), 100),
        )  # fmt: skip
    write_text(out, write_noise(result.noise, calibration_facts(result)))
    Console().print(calibration_table(result))
    click.echo(f"noise model: {out}")
    return 0
