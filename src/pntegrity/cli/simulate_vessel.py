"""``pntegrity simulate-vessel``: several sources beside an inertial unit, to try without data."""

from __future__ import annotations

from pathlib import Path

import click

#: The fault that is proposed begins after this part of the time.
WHEN = 0.4


@click.command(
    "simulate-vessel",
    help="Simulate a vessel: an inertial unit, satellites, four acoustic beacons (lbl), a transponder (usbl) "
    "and a depth sensor, without faults, as files that `pntegrity run --config OUT/vehicle.toml` takes.",
)
@click.option(
    "--out", type=click.Path(path_type=Path), required=True, help="Folder for the files; made where missing."
)
@click.option(
    "--seconds", type=click.FloatRange(60.0, 3600.0), default=300.0, show_default=True, help="How long."
)
@click.option(
    "--rate-hz", type=click.FloatRange(0.2, 10.0), default=1.0, show_default=True, help="Epochs a second."
)
@click.option(
    "--imu-hz", type=click.FloatRange(20.0, 400.0), default=100.0, show_default=True,
    help="Increments of the inertial unit a second.",
)  # fmt: skip
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True, help="Seed of all errors.")
def command(out: Path, seconds: float, rate_hz: float, imu_hz: float, seed: int) -> int:
    """Simulate from options."""
    from shlex import quote

    from pntegrity.report.write import results_folder
    from pntegrity.scenarios.vessel import simulated_vessel
    from pntegrity.simulate.vessel_files import DESCRIPTION

    _check(out, rate_hz, DESCRIPTION)
    folder = results_folder(out)  # before the work, not after it
    made = simulated_vessel(seconds, rate_hz, imu_hz, seed)
    path, begin = made.write(folder), round(WHEN * seconds)
    click.echo(
        f"{len(made.log.epochs)} epochs, {len(made.log.inertial.t_ns)} increments of the inertial unit"
    )
    click.echo(f"sources, with their rows: {made.sensors()}")
    click.echo(f"vehicle: {path}")
    fault = f"lbl.AP1 ramp 0.8 ms/s {begin}:{begin + 20}"
    click.echo(f'next:    pntegrity run --config {quote(str(path))} --fault "{fault}" --out results')
    return 0


def _check(out: Path, rate_hz: float, description: str) -> None:
    """Refuse times that RINEX cannot hold, and a folder that belongs to something else."""
    from pntegrity.errors import InputError

    if (1e7 / rate_hz) % 1.0:
        raise InputError(
            f"--rate-hz {rate_hz:g}: RINEX has times to 100 ns, which {1.0 / rate_hz:g} s is no multiple of",
            hint="Take a rate such as 1, 2, 4, 5 or 10",
        )
    if out.is_dir() and any(out.iterdir()) and not (out / description).exists():
        raise InputError(
            f"the folder holds files, and no {description} among them", path=out,
            hint="Choose another with --out",
        )  # fmt: skip
