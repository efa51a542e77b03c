"""``pntegrity simulate-imu``: an inertial measurement unit on the track of a real log that has none."""

from __future__ import annotations

from dataclasses import replace
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from pntegrity.formats._acoustics import AcousticLog
    from pntegrity.sensors.imu import ImuSpec
    from pntegrity.simulate.log_imu import LogImu


@click.command(
    "simulate-imu",
    help="Simulate an inertial measurement unit on the track of a real log that has none. The unit is where "
    "the antenna is; its truth is the log's own track, smoothed.",
)
@click.option("--log", "folder", type=click.Path(path_type=Path), required=True, help="Folder of the log.")
@click.option(
    "--format", "layout", type=click.Choice(["gnatss", "garpos"]), required=True, help="Its layout."
)
@click.option(
    "--imu-spec", default="stim300", show_default=True,
    help="How good the unit is: stim300, low-cost, or a TOML file.",
)  # fmt: skip
@click.option(
    "--rate-hz", type=click.FloatRange(1.0, 1000.0), help="Increments a second.  [that of the specification]"
)
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True, help="Seed of its errors.")
@click.option(
    "--start",
    help="Of the run that will use it: seconds from the log's first epoch, or GPS time.  [first attitude]",
)
@click.option("--end", help="The same of the end.  [the last attitude]")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    required=True,
    help="Table to write, for --imu: .csv or .csv.gz.",
)
def command(
    folder: Path, layout: str, imu_spec: str, rate_hz: float | None, seed: int, start: str | None,
    end: str | None, out: Path,
) -> int:  # fmt: skip
    """Simulate from options."""
    from pntegrity.errors import InputError
    from pntegrity.formats.imu_write import write_imu
    from pntegrity.source_files import read_log

    if not out.name.endswith((".csv", ".csv.gz")):
        raise InputError("the table is CSV", path=out, hint="Let its name end in .csv or .csv.gz")
    spec = _spec(imu_spec, rate_hz)
    log = read_log(folder, layout)
    made = _simulated(log, spec, seed, start, end, folder)
    remark = f"simulated: {spec.name}, {spec.rate_hz:g} Hz, seed {seed}, on the track of {folder.name}"
    write_imu(out, made.increments, remark)
    _say(log, made)
    click.echo(f"imu: {out}")
    return 0


def _spec(name: str, rate_hz: float | None) -> ImuSpec:
    """Return a specification, with another rate where one is asked for."""
    from pntegrity.sensors.imu_spec import read_imu_spec

    spec = read_imu_spec(name)
    return replace(spec, rate_hz=rate_hz or spec.rate_hz)


def _simulated(
    log: AcousticLog, spec: ImuSpec, seed: int, start: str | None, end: str | None, folder: Path
) -> LogImu:
    """Return the unit on the track of a log between two times."""
    from pntegrity.errors import InputError
    from pntegrity.run import time_of
    from pntegrity.simulate.log_imu import simulated_imu

    first = _first_ns(log)
    try:
        return simulated_imu(log, spec, seed, time_of(start, first), time_of(end, first))
    except InputError:
        raise
    except ValueError as error:
        raise InputError(
            f"no unit can be simulated: {error}", path=folder,
            hint="See --start and --end: the log must have positions and attitudes there",
        ) from None  # fmt: skip


def _say(log: AcousticLog, made: LogImu) -> None:
    """Say how long a run may be, how it begins, and what the reader of the log dropped."""
    from pntegrity.physics.time import SECOND_NS, to_iso
    from pntegrity.simulate.log_imu import BEFORE_S

    begin, stop = made.span_ns
    begin += round(BEFORE_S * SECOND_NS)
    first = _first_ns(log)
    since = [(t - first) / SECOND_NS for t in (begin, stop)]
    click.echo(
        f"{len(made.increments.t_ns)} increments; a run may go from {to_iso(begin)} to {to_iso(stop)}: "
        f'start = "{since[0]:.0f}", end = "{since[1]:.0f}"'
    )
    heading = degrees(made.heading_rad(_first_ns(log, begin)))
    click.echo(f"heading at its first epoch: heading_deg = {heading:.1f}")
    for note in log.notes:
        click.echo(f"note: {note}")


def _first_ns(log: AcousticLog, from_ns: int = 0) -> int:
    """Return the first epoch of a run on a log's fixes and travel times from a time on."""
    times = (o.t_ns for o in (*log.fixes, *log.observations) if o.t_ns >= from_ns)
    return min(times, default=from_ns)
