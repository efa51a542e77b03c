"""``pntegrity train-factors``: thresholds of factor-set detection from logs without faults."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from pntegrity.config import RunConfig
    from pntegrity.kernels.factor_set import FactorSet
    from pntegrity.verdicts import Screening


@click.command(
    "train-factors",
    help="Set the thresholds of factor-set detection from logs without faults. Each LOG is a file of `run`'s "
    "options (--config), such as the config.toml in a run's results.",
)
@click.argument("logs", metavar="LOG...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path), required=True, help="File to write (TOML).")
@click.option(
    "--alpha",
    type=click.FloatRange(0.0, 20.0),
    default=3.0,
    show_default=True,
    help="Standard deviations above the mean: missed-detection threshold.",
)
@click.option(
    "--gamma",
    type=click.FloatRange(0.0, 20.0),
    default=3.0,
    show_default=True,
    help="The same of the false-alarm threshold.",
)
@click.option(
    "--variant", type=click.Choice(["exact", "published"]), help="Which detection is trained.  [exact]"
)
def command(logs: tuple[Path, ...], out: Path, alpha: float, gamma: float, variant: str | None) -> int:
    """Train from files of options."""
    from pntegrity.config import to_toml
    from pntegrity.evaluate.train_factors import train_factors, training_tables
    from pntegrity.formats.atomic import write_text

    screenings, factors = _screened([training_config(path, variant) for path in logs])
    training = train_factors(screenings, factors, alpha=alpha, gamma=gamma)
    write_text(out, to_toml(training_tables(training, [str(path) for path in logs])))
    click.echo(
        f"{training.accepted} of {training.epochs} epochs consistent; thresholds: missed detection "
        f"{training.factors.missed_limit_m:.1f} m, false alarm {training.factors.false_alarm_limit_m:.1f} m"
    )
    click.echo(f"thresholds: {out}")
    return 0


def training_config(path: Path, variant: str | None) -> RunConfig:
    """Return the configuration of one log, as it is trained on.

    Raises
    ------
    InputError
        A file that is no configuration, or one that injects faults.
    """
    from pntegrity.config import load_toml, make_config
    from pntegrity.errors import InputError

    values = load_toml(path, hint="A LOG is a file of options, such as the config.toml in a run's results")
    if values.get("faults"):
        raise InputError("injects faults: thresholds are trained without any", path=path)
    usual: dict[str, Any] = {
        "estimator": "gnss_ins", "coupling": "loose", "fde": "factor-set", "monitors": ("factor_set",),
        "exclude": False,
    }  # fmt: skip
    return make_config(values | usual | ({"variant": variant} if variant else {}))


def _screened(configs: list[RunConfig]) -> tuple[list[Screening], FactorSet]:
    """Return the screenings of all logs, and the options of the detection.

    Raises
    ------
    InputError
        Logs whose options of the detection are not the same.
    """
    from pntegrity.errors import InputError

    runs = [_run(config) for config in configs]
    factors = runs[0][1]
    if any(other != factors for _, other in runs):
        raise InputError("the logs differ in `variant` or `factors`", hint="Train logs of a kind together")
    return [s for found, _ in runs for s in found], factors


def _run(config: RunConfig) -> tuple[list[Screening], FactorSet]:
    """Return the screenings of one log's epochs, no check in force, and the options of the detection."""
    from dataclasses import replace

    from threadpoolctl import threadpool_limits

    from pntegrity.estimators import discover
    from pntegrity.evaluate.train_factors import without_limits
    from pntegrity.exclusion import Policy
    from pntegrity.pipeline import Pipeline
    from pntegrity.run import load_epochs, options_for

    loaded = load_epochs(config)
    options = options_for(config, loaded)
    factors = options.ins.factors
    estimator = discover()[config.estimator](
        replace(options, ins=replace(options.ins, factors=without_limits(factors)))
    )
    pipeline = Pipeline(estimator, config.build_monitors(), Policy(exclude=False, p_fa=config.p_fa))
    with threadpool_limits(1, user_api="blas"):
        found = [pipeline.push(epoch).update.screening for epoch in loaded.epochs]
    return [s for s in found if s is not None], factors
