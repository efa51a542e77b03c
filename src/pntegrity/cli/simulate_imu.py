"""``pntegrity simulate-imu``: an inertial measurement unit on the track of a real log that has none."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from pntegrity.formats._acoustics import AcousticLog


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
    from dataclasses import replace

    import numpy as np

    from pntegrity.errors import InputError
    from pntegrity.formats.imu_table import write_imu
    from pntegrity.physics.time import SECOND_NS, to_iso
    from pntegrity.run import time_of
    from pntegrity.sensors.imu_spec import read_imu_spec
    from pntegrity.simulate.log_imu import BEFORE_S, simulated_imu
    from pntegrity.source_files import read_log

    if not out.name.endswith((".csv", ".csv.gz")):
        raise InputError("the table is CSV", path=out, hint="Let its name end in .csv or .csv.gz")
    spec = read_imu_spec(imu_spec)
    spec = replace(spec, rate_hz=rate_hz or spec.rate_hz)
    log = read_log(folder, layout)
    first = _first_ns(log)
    try:
        made = simulated_imu(log, spec, seed, time_of(start, first), time_of(end, first))
    except InputError:
        raise
    except ValueError as error:
        raise InputError(
            f"no unit can be simulated: {error}", path=folder,
            hint="See --start and --end: the log must have positions and attitudes there",
        ) from None  # fmt: skip
    begin, stop = made.span_ns
    begin += round(BEFORE_S * SECOND_NS)
    remark = f"simulated: {spec.name}, {spec.rate_hz:g} Hz, seed {seed}, on the track of {folder.name}"
    write_imu(out, made.increments, remark)
    since = [(t - first) / SECOND_NS for t in (begin, stop)]
    click.echo(
        f"{len(made.increments.t_ns)} increments; a run may go from {to_iso(begin)} to {to_iso(stop)}: "
        f'start = "{since[0]:.0f}", end = "{since[1]:.0f}"'
    )
    there = _first_ns(log, begin)
    click.echo(f"heading at its first epoch: heading_deg = {np.degrees(made.heading_rad(there)):.1f}")
    for note in log.notes:
        click.echo(f"note: {note}")
    click.echo(f"imu: {out}")
    return 0


def _first_ns(log: AcousticLog, from_ns: int = 0) -> int:
    """Return the first epoch of a run on a log's fixes and travel times from a time on."""
    times = (o.t_ns for o in (*log.fixes, *log.observations) if o.t_ns >= from_ns)
    return min(times, default=from_ns)
