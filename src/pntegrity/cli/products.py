"""``pntegrity products``: the atmosphere over a station whose place is known."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pntegrity.cli._shared import INPUT, Command, build_config, options, progress_bar

if TYPE_CHECKING:
    from rich.table import Table

    from pntegrity.config import RunConfig
    from pntegrity.physics.atmosphere_products import AtmosphereProducts

ESTIMATOR = "ppp_rtk"
NOT_HERE = ("estimator", "motion", "ionosphere_free", "doppler")


def _name(option: Command) -> str:
    """Return the name of an option."""

    def bare() -> None: ...

    option(bare)
    return str(bare.__click_params__[0].name)  # type: ignore[attr-defined]


@click.command(
    "products",
    help="Make products of the atmosphere (wet delay, slant delays) from a station whose place is known.",
)
@options([option for option in INPUT if _name(option) not in NOT_HERE])
@click.option("--position", required=True, help="ECEF X,Y,Z of the station's marker, metres.")
@click.option(
    "--latency-s", type=click.FloatRange(0.0, 86400.0), default=30.0, show_default=True,
    help="A sample holds the estimate of so long before.",
)  # fmt: skip
@click.option(
    "--interval-s", type=click.FloatRange(0.0, 86400.0, min_open=True), help="Step.  [that of the log]"
)
@click.option(
    "--add-noise", help="Errors to add, SLANT,ZENITH in metres (slant on 1575.42 MHz): 0.2,0.1.  [none]"
)
@click.option(
    "--tau-s", type=click.FloatRange(0.0), default=1800.0, show_default=True,
    help="Correlation time of the errors to add; 0: white.",
)  # fmt: skip
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True, help="Seed of these errors.")
@click.option(
    "--out", type=click.Path(path_type=Path), required=True, help="File to write: .csv, .csv.gz or .parquet."
)
def command(
    position: str, latency_s: float, interval_s: float | None, add_noise: str | None, tau_s: float, seed: int,
    out: Path, **values: Any,
) -> int:  # fmt: skip
    """Make products from options."""
    import numpy as np
    from rich.console import Console

    from pntegrity.errors import InputError
    from pntegrity.formats.atmosphere import write_atmosphere
    from pntegrity.simulate.products import disturbed

    place = _numbers("--position", position, ("X", "Y", "Z"))
    sizes = _numbers("--add-noise", add_noise, ("SLANT", "ZENITH")) if add_noise is not None else None
    if sizes and min(sizes) < 0.0:
        raise InputError(f"--add-noise {add_noise!r}: sizes of errors are at least 0")
    _check_place_for(out)
    config = build_config(values | {"estimator": ESTIMATOR})
    made, notes = _made(config, place, latency_s, interval_s)
    if sizes:
        made = disturbed(made, sizes[0], sizes[1], tau_s, np.random.default_rng(seed))
    write_atmosphere(out, made)
    Console().print(_table(made))
    for note in notes:
        click.echo(f"note: {note}")
    click.echo(f"products: {out}")
    return 0


def _made(
    config: RunConfig, place: tuple[float, ...], latency_s: float, interval_s: float | None
) -> tuple[AtmosphereProducts, tuple[str, ...]]:
    """Return the products of the log that a configuration names, and notes on it."""
    from threadpoolctl import threadpool_limits

    from pntegrity.errors import InputError
    from pntegrity.pipeline import uncollected
    from pntegrity.run import load_epochs, options_for
    from pntegrity.stations import products_from_station

    if not config.sp3:
        raise InputError("products take precise orbits", hint="Give SP3 files with --sp3, clocks with --clk")
    with progress_bar() as progress:
        progress("reading", 0, 1)
        loaded = load_epochs(config)
        with threadpool_limits(1, user_api="blas"), uncollected():
            made = products_from_station(
                loaded.epochs, place, options_for(config, loaded), latency_s=latency_s, interval_s=interval_s,
                source=f"{Path(config.obs or '').name} ({config.systems})", progress=progress,
            )  # fmt: skip
    return made, (*loaded.notes, *made.notes)


def _numbers(option: str, text: str, names: tuple[str, ...]) -> tuple[float, ...]:
    import math

    from pntegrity.errors import InputError

    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != len(names) or not all(map(math.isfinite, values)):
        raise InputError(f"{option} {text!r} is not {len(names)} numbers {','.join(names)} in metres")
    return values


def _check_place_for(out: Path) -> None:
    """Refuse before the work what could not be written after it."""
    from pntegrity.errors import InputError

    if out.is_dir():
        raise InputError("this is a directory", path=out, hint="Name a file with --out")
    if not out.absolute().parent.is_dir():
        raise InputError("its folder is not there", path=out, hint="Make it, or choose another with --out")


def _table(made: AtmosphereProducts) -> Table:
    """Return what was made."""
    import numpy as np
    from rich.table import Table

    from pntegrity.physics.atmosphere_products import metres_per_tecu
    from pntegrity.physics.time import to_iso
    from pntegrity.simulate.products import REFERENCE_HZ

    t_ns, zenith, zenith_sigma = made.troposphere
    slant_sigma = np.concatenate([s[2] for s in made.ionosphere.values()]) * metres_per_tecu(REFERENCE_HZ)
    systems = ", ".join(
        f"{letter} {sum(s[0] == letter for s in made.ionosphere)}"
        for letter in sorted({sat[0] for sat in made.ionosphere})
    )
    table = Table(title="products of the atmosphere, self-derived", show_header=False)
    for what, value in (
        ("source", made.source),
        ("satellites", f"{len(made.ionosphere)} ({systems})"),
        ("times", f"{len(t_ns)}, {to_iso(int(t_ns[0]))} to {to_iso(int(t_ns[-1]))}, GPS time"),
        ("latency, interval", f"{made.latency_s:g} s, {made.interval_s:g} s"),
        ("zenith wet delay", f"{zenith.min():.3f} to {zenith.max():.3f} m"),
        ("median sigma, slant", f"{np.median(slant_sigma):.3f} m on L1"),
        ("median sigma, zenith", f"{np.median(zenith_sigma):.3f} m"),
        ("mind", "made of a receiver's own data: they share its noise and multipath, and prove nothing about "
         "products of a network"),
    ):  # fmt: skip
        table.add_row(what, value)
    return table
