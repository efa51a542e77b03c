"""What the commands share: progress on a terminal, silence in a pipe, and the options that make a run."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from pntegrity.config import RunConfig

Command = Callable[..., Any]

INPUT = [
    click.option(
        "--obs", type=click.Path(path_type=Path), help="RINEX 2/3/4 observation file (.gz and CRINEX too)."
    ),
    click.option(
        "--nav", type=click.Path(path_type=Path), multiple=True, help="RINEX navigation file; repeatable."
    ),
    click.option(
        "--sp3", type=click.Path(path_type=Path), multiple=True, help="Precise orbits; repeatable (days)."
    ),
    click.option("--clk", type=click.Path(path_type=Path), multiple=True, help="Precise clocks; repeatable."),
    click.option(
        "--bias",
        type=click.Path(path_type=Path),
        multiple=True,
        help="Code biases: Bias-SINEX or CODE DCB; repeatable.",
    ),
    click.option("--antex", type=click.Path(path_type=Path), multiple=True, help="Antennas; repeatable."),
    click.option("--blq", type=click.Path(path_type=Path), help="Ocean loading (BLQ)."),
    click.option("--erp", type=click.Path(path_type=Path), help="Polar motion, for the pole tide."),
    click.option("--station", help="Station in the BLQ file.  [the marker]"),
    click.option(
        "--atmosphere",
        type=click.Path(path_type=Path),
        help="Atmosphere products for ppp_rtk: CSV or Parquet (`pntegrity products` makes some).",
    ),
    click.option(
        "--clas",
        type=click.Path(path_type=Path),
        multiple=True,
        help="CLAS corrections for ppp_rtk: decoded CSV files, or one raw file.l6.",
    ),
    click.option(
        "--clas-grid", type=click.Path(path_type=Path), help="Definition of the grid points, for file.l6."
    ),
    click.option(
        "--config", type=click.Path(path_type=Path), help="TOML file with any of these options; options win."
    ),
    click.option(
        "--estimator",
        help="spp (snapshot), spp_kf (Kalman filter), ppp (precise, with --sp3), ppp_rtk (with --sp3 and "
        "--atmosphere, or --clas), gnss_ins (with --imu) or multi_source (a vehicle: sources in the file of "
        "--config).  [spp_kf]",
    ),
    click.option(
        "--motion",
        type=click.Choice(["white", "walk", "velocity", "static"]),
        help="What ppp and ppp_rtk know of the motion: nothing, a random walk, constant velocity, none.  "
        "[white]",
    ),
    click.option("--mask-deg", type=float, help="Elevation mask, degrees.  [10]"),
    click.option("--systems", help="Constellations: G GPS, R GLONASS, E Galileo, C BDS, J QZSS.  [GREC]"),
    click.option(
        "--ionosphere-free/--single-frequency", default=None, help="Combine two frequencies.  [single]"
    ),
    click.option("--doppler/--no-doppler", default=None, help="Use range rates where present.  [yes]"),
    click.option(
        "--noise", type=click.Path(path_type=Path), help="Noise model written by `pntegrity calibrate`."
    ),
    click.option(
        "--start", help="First epoch: seconds from that of the log, or GPS time like 2019-01-14T06:20:00."
    ),
    click.option("--end", help="Last epoch: seconds from the first epoch, or GPS time."),
]
INERTIAL = [
    click.option(
        "--imu",
        type=click.Path(path_type=Path),
        help="Table of an IMU for gnss_ins and multi_source: CSV, units in its names.",
    ),
    click.option("--imu-spec", help="Its errors: stim300, low-cost, or a TOML file.  [stim300]"),
    click.option(
        "--imu-axes",
        help="Its axes that point forward, right, down: x,y,z or -x,y,-z; frd, flu, rfu.  [x,y,z]",
    ),
    click.option("--imu-mount-deg", help="Roll,pitch,yaw of the unit in the vehicle, degrees.  [0,0,0]"),
    click.option("--imu-lag-s", help="By how much its stamps are late, seconds, or auto.  [0]"),
    click.option("--imu-start", help="GPS time of second 0, where times are bare seconds."),
    click.option("--lever-arm", help="From the IMU to the antenna, forward,right,down, metres.  [0,0,0]"),
    click.option(
        "--coupling",
        type=click.Choice(["tight", "loose"]),
        help="Pseudoranges and range rates in the filter, or a fix of them.  [tight; loose with --fde "
        "factor-set, lsr, and with --fixes]",
    ),
    click.option(
        "--fde",
        type=click.Choice(["ours", "factor-set", "lsr", "none"]),
        help="Fault detection of gnss_ins before it uses an epoch.  [ours]",
    ),
    click.option(
        "--factors",
        type=click.Path(path_type=Path),
        help="Thresholds of --fde factor-set, written by `pntegrity train-factors`.",
    ),
    click.option(
        "--fixes",
        type=click.Path(path_type=Path),
        help="A receiver's own fixes instead of --obs and --nav: RTKLIB .pos or CSV.",
    ),
    click.option("--fix-floor-m", type=float, help="Smallest sigma that is believed of fixes, m.  [0]"),
    click.option("--fix-floor-mps", type=float, help="The same of their velocities, m/s.  [0]"),
    click.option(
        "--fix-velocity/--no-fix-velocity", default=None, help="Use the velocities of fixes.  [yes]"
    ),
    click.option(
        "--fix-velocity-lag-s", type=float, help="By how much these are late against positions, s.  [0]"
    ),
    click.option(
        "--heading-deg", type=float, help="Heading at the first epoch, from north.  [from the course]"
    ),
    click.option(
        "--zupt/--no-zupt", default=None, help="Use a standstill that the IMU shows as a measurement.  [no]"
    ),
]
MONITORING = [
    click.option(
        "--monitors",
        help="Comma-separated: rctm, srctm, aime, sraime, glr, separation (protection levels), factor_set, "
        "source_separation, sensor_window.  [the first five, also with --fixes; ppp_rtk: separation; "
        "gnss_ins: factor_set, separation; multi_source: source_separation, sensor_window, separation]",
    ),
    click.option(
        "--ism",
        type=click.Path(path_type=Path),
        help="Integrity support message (TOML): fault probabilities, risk, alert limits.",
    ),
    click.option(
        "--variant",
        type=click.Choice(["exact", "published"]),
        help="Exact covariances, or the papers'.  [exact]",
    ),
    click.option(
        "--p-fa", type=float, help="Probability of a false alarm of each monitor, an epoch.  [1e-6]"
    ),
    click.option("--exclude/--no-exclude", default=None, help="Leave suspects out, repair, re-admit.  [yes]"),
    click.option("--truth-ecef", help="True position X,Y,Z of a static receiver, metres."),
    click.option("--truth", type=click.Path(path_type=Path), help="True positions: CSV or RTKLIB .pos."),
    click.option(
        "--fault", "faults", multiple=True, help='Inject a fault, "G05 ramp 0.1 m/s 200:300"; repeatable.'
    ),
]
#: Options of three numbers: option, field, what it is.
TRIPLES = (
    ("truth_ecef", "truth_ecef_m", "X,Y,Z in metres"),
    ("lever_arm", "lever_arm_m", "FORWARD,RIGHT,DOWN in metres"),
    ("imu_mount_deg", "imu_mount_deg", "ROLL,PITCH,YAW in degrees"),
)


def options(*groups: list[Command]) -> Command:
    """Return a decorator that adds groups of options in order."""

    def decorate(command: Command) -> Command:
        for option in reversed([o for group in groups for o in group]):
            command = option(command)
        return command

    return decorate


def build_config(values: dict[str, Any]) -> RunConfig:
    """Return the checked configuration of options and of the file that they name; options win."""
    from pntegrity.config import load_toml, make_config, read_ism, read_noise
    from pntegrity.errors import InputError

    given = {k: v for k, v in values.items() if v is not None and v != ()}
    config = given.pop("config", None)
    merged: dict[str, Any] = load_toml(config) if config else {}
    sources = merged.get("source", [])
    if not isinstance(sources, list) or not all(isinstance(s, dict) for s in sources):
        raise InputError("`source` is no list of tables", path=config, hint="Write [[source]] above each")
    if "noise" in given:
        given["noise"] = read_noise(given["noise"])
    if "ism" in given:
        given["ism"] = read_ism(given["ism"])
    if "monitors" in given:
        given["monitors"] = tuple(n.strip() for n in given["monitors"].split(",") if n.strip())
    for option, field, what in TRIPLES:
        if option in given:
            given[field] = _triple(option, given.pop(option), what)
    merged |= given
    precise = any(merged.get(name) for name in ("sp3", "clk", "bias", "antex", "blq", "erp"))
    instead = merged.get("fixes") or merged.get("source") or merged.get("estimator") == "multi_source"
    for name in ("obs",) if precise else ("obs", "nav"):
        if not merged.get(name) and not instead:
            orbits = ", or precise orbits with --sp3 FILE" if name == "nav" else ""
            raise InputError(
                f"no {name} file", hint=f"Give one with --{name} FILE{orbits}, or in the file of --config"
            )
    return make_config(merged)


def _triple(option: str, text: str, what: str) -> tuple[float, ...]:
    from pntegrity.errors import InputError

    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != 3:
        raise InputError(f"--{option.replace('_', '-')} {text!r} is not three numbers {what}")
    return values


def record_in(path: Path) -> Path:
    """Return the record of updates that a path stands for: itself, or that of a folder of results."""
    return path / "updates.npz" if path.is_dir() else path


@contextmanager
def progress_bar() -> Iterator[Callable[[str, int, int], None]]:
    """Yield a reporter of (stage, done, total): a bar on a terminal, nothing in a pipe."""
    import sys

    if not sys.stderr.isatty():
        yield lambda stage, done, total: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed}/{task.total}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=None)
        yield lambda stage, done, total: bar.update(task, description=stage, completed=done, total=total)
