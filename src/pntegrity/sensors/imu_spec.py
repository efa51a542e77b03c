"""Specifications of inertial measurement units as TOML, in the units of data sheets <-> `ImuSpec`."""

from __future__ import annotations

import json
import tomllib
from dataclasses import fields
from pathlib import Path
from typing import Any

from pntegrity.errors import InputError
from pntegrity.formats._source import read_text
from pntegrity.sensors.imu import DEG, HOUR, LOW_COST, MILLI_G, STIM300, ImuSpec

__all__ = ["BUILT_IN", "QUANTITIES", "imu_spec_toml", "read_imu_spec"]

#: Specifications that a name stands for.
BUILT_IN = {"stim300": STIM300, "low-cost": LOW_COST}
#: Key in the file -> field of `ImuSpec` and the factor to its unit. The first key of a field is written.
QUANTITIES: dict[str, tuple[str, float]] = {
    "rate_hz": ("rate_hz", 1.0),
    "gyro_random_walk_deg_sqrt_h": ("gyro_noise_radps_rthz", DEG / 60.0),
    "gyro_noise_deg_s_sqrt_hz": ("gyro_noise_radps_rthz", DEG),
    "gyro_bias_instability_deg_h": ("gyro_bias_radps", DEG / HOUR),
    "gyro_correlation_time_s": ("gyro_tau_s", 1.0),
    "gyro_turn_on_bias_deg_h": ("gyro_turn_on_radps", DEG / HOUR),
    "gyro_turn_on_bias_deg_s": ("gyro_turn_on_radps", DEG),
    "gyro_scale_factor_ppm": ("gyro_scale", 1e-6),
    "accel_random_walk_mps_sqrt_h": ("accel_noise_mps2_rthz", 1.0 / 60.0),
    "accel_noise_ug_sqrt_hz": ("accel_noise_mps2_rthz", 1e-3 * MILLI_G),
    "accel_bias_instability_mg": ("accel_bias_mps2", MILLI_G),
    "accel_bias_instability_ug": ("accel_bias_mps2", 1e-3 * MILLI_G),
    "accel_correlation_time_s": ("accel_tau_s", 1.0),
    "accel_turn_on_bias_mg": ("accel_turn_on_mps2", MILLI_G),
    "accel_scale_factor_ppm": ("accel_scale", 1e-6),
}
NEEDED = ("gyro_noise_radps_rthz", "accel_noise_mps2_rthz", "gyro_bias_radps", "accel_bias_mps2")
HINT = "docs/formats/imu.md has an example"


def read_imu_spec(path_or_name: Path | str) -> ImuSpec:
    """Return the specification of an inertial measurement unit.

    Parameters
    ----------
    path_or_name : Path or str
        ``"stim300"``, ``"low-cost"``, or a TOML file with keys of `QUANTITIES` and a ``name``. White noise
        and bias instability of both sensors are needed; what else is not said is that of `ImuSpec`.

    Raises
    ------
    InputError
        No such file, not TOML, an unknown key, a quantity that is missing, twice there or out of range.
    """
    known = BUILT_IN.get(str(path_or_name).lower())
    if known is not None:
        return known
    path = Path(path_or_name)
    if not path.suffix and not path.exists():
        raise InputError(
            f"no specification of an IMU is called {str(path_or_name)!r}",
            hint=f"There are {', '.join(BUILT_IN)}; or give a TOML file: {HINT}",
        )
    try:
        table = tomllib.loads(read_text(path))
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"is not TOML: {error}", path=path, hint=HINT) from None
    try:
        return _spec(table, path.stem)
    except (ValueError, TypeError) as error:
        raise InputError(str(error), path=path, hint=HINT) from None


def _spec(table: dict[str, Any], name: str) -> ImuSpec:
    values: dict[str, Any] = {"name": str(table.get("name", name))}
    for key, value in table.items():
        if key == "name":
            continue
        if key not in QUANTITIES:
            raise ValueError(f"IMU specification: unknown key {key!r}; known are {', '.join(QUANTITIES)}")
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError(f"IMU specification: `{key}` must be a number, not {value!r}")
        field, factor = QUANTITIES[key]
        if field in values:
            raise ValueError(f"IMU specification: `{key}` says a second time what another key says")
        values[field] = value * factor
    missing = [f for f in NEEDED if f not in values]
    if missing:
        raise ValueError(f"IMU specification: `{_key_of(missing[0])}` is missing")
    return ImuSpec(**values)


def imu_spec_toml(spec: ImuSpec) -> str:
    """Return a specification as the text of a file that `read_imu_spec` reads."""
    lines = [f"name = {json.dumps(spec.name)}"]
    for f in fields(spec):
        if f.name != "name":
            key = _key_of(f.name)
            lines.append(f"{key} = {float(f'{getattr(spec, f.name) / QUANTITIES[key][1]:.15g}')!r}")
    return "\n".join(lines) + "\n"


def _key_of(field: str) -> str:
    return next(key for key, (name, _) in QUANTITIES.items() if name == field)
