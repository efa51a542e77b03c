"""Rows of code and range rate at a position: what everything that uses satellites starts from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from pntegrity.physics.atmosphere import klobuchar_m, troposphere_m
from pntegrity.physics.frames import elevation_azimuth
from pntegrity.physics.tables import Klobuchar
from pntegrity.records import Epoch, FloatArray, Observation, group_of
from pntegrity.sensors.noise import NoiseModel
from pntegrity.sensors.ranges import geometry, range_rate

__all__ = [
    "SURFACE_M", "Rows", "SkyOptions", "code_rows", "elevations", "model_m", "rate_rows", "sensor",
    "system_of",
    "without",
]  # fmt: skip

#: Closer to the Earth's centre than this there is no local horizon and no atmosphere, m.
SURFACE_M = 6.3e6


class SkyOptions(Protocol):
    """What rows of satellites need to know beside the epoch."""

    @property
    def noise(self) -> NoiseModel:
        """How large the errors are."""
        ...

    @property
    def mask_rad(self) -> float:
        """Elevation mask."""
        ...

    @property
    def klobuchar(self) -> Klobuchar | None:
        """Broadcast ionosphere coefficients; None: no ionosphere model."""
        ...

    @property
    def doppler(self) -> bool:
        """Whether range rates are used."""
        ...


@dataclass(frozen=True, eq=False)
class Rows:
    """Code or range-rate rows at a position, all of shape (n,) or (n, 3).

    `predicted` is what the row would read with perfect clocks: geometry, satellite clock, atmosphere. `scale`
    and `slow` say how much larger than at the zenith its fast and slow errors are.
    """

    keys: tuple[str, ...]
    y: FloatArray
    predicted: FloatArray
    los: FloatArray
    scale: FloatArray
    slow: FloatArray
    el_rad: FloatArray
    az_rad: FloatArray
    cn0_dbhz: FloatArray

    def select(self, rows: npt.NDArray[np.bool_]) -> Rows:
        """Return only some rows."""
        return Rows(
            tuple(k for k, r in zip(self.keys, rows, strict=True) if r), self.y[rows], self.predicted[rows],
            self.los[rows], self.scale[rows], self.slow[rows], self.el_rad[rows], self.az_rad[rows],
            self.cn0_dbhz[rows],
        )  # fmt: skip


def code_rows(epoch: Epoch, position_m: FloatArray, options: SkyOptions) -> Rows:
    """Return the code rows above the mask; below `SURFACE_M` there is no mask and no atmosphere yet.

    Parameters
    ----------
    epoch : Epoch
        With the observation ``"code"``, m; without it there are no rows.
    position_m : ndarray, shape (3,)
        Of the antenna, ECEF.
    options : SkyOptions
    """
    o = sensor(epoch, "code")
    g = geometry(position_m, o.aux["sv_pos_m"])
    el, az, on_ground = elevations(position_m, g.los)
    predicted = g.range_m - o.aux["sv_clk_m"] + model_m(o)
    if on_ground:
        predicted = predicted + troposphere_m(position_m, el, o.t_ns)
        if options.klobuchar is not None:
            delay = klobuchar_m(options.klobuchar, position_m, el, az, o.t_ns, o.aux["freq_hz"])
            predicted = predicted + o.aux["iono_factor"] * delay
    noise = options.noise
    rows = _rows(o, predicted, g.los, el, az, noise, noise.code_factor(o.keys), noise.bias_factor(o.keys))
    return rows.select(el >= options.mask_rad) if on_ground else rows


def rate_rows(epoch: Epoch, position_m: FloatArray, velocity_mps: FloatArray, options: SkyOptions) -> Rows:
    """Return the range-rate rows above the mask.

    Parameters
    ----------
    epoch : Epoch
        With the observation ``"doppler"``, range rates in m/s; without it there are no rows.
    position_m, velocity_mps : ndarray, shape (3,)
        Of the antenna, ECEF.
    options : SkyOptions
    """
    o = sensor(epoch, "doppler")
    if not options.doppler:
        o = o.select(np.zeros(len(o.keys), dtype=bool))
    g = geometry(position_m, o.aux["sv_pos_m"])
    el, az, on_ground = elevations(position_m, g.los)
    rate = range_rate(velocity_mps, position_m, o.aux["sv_pos_m"], o.aux["sv_vel_mps"], g.los)
    factor = options.noise.rate_factor(o.keys)
    rows = _rows(o, rate - o.aux["sv_clk_rate_mps"], g.los, el, az, options.noise, factor, factor)
    return rows.select(el >= options.mask_rad) if on_ground else rows


def model_m(o: Observation) -> FloatArray:
    """Return the corrections of a prediction that were made beforehand, zeros where there are none."""
    made = o.aux.get("model_m")
    return np.zeros(len(o.keys)) if made is None else np.asarray(made)


def sensor(epoch: Epoch, name: str) -> Observation:
    """Return the observation of a sensor, an empty one where there is none."""
    found = epoch.sensor(name)
    if found is not None:
        return found
    none: dict[str, npt.NDArray[np.float64]] = {k: np.zeros(0) for k in _AUX}
    none |= {"sv_pos_m": np.zeros((0, 3)), "sv_vel_mps": np.zeros((0, 3))}
    return Observation(name, epoch.t_ns, (), np.zeros(0), aux=none)


_AUX = ("sv_clk_m", "sv_clk_rate_mps", "freq_hz", "cn0_dbhz", "iono_factor")


def elevations(position_m: FloatArray, los: FloatArray) -> tuple[FloatArray, FloatArray, bool]:
    """Return elevations, azimuths, and whether the position is one on the ground (else all are at the
    zenith).
    """
    if float(position_m @ position_m) < SURFACE_M**2:
        return np.full(len(los), np.pi / 2), np.zeros(len(los)), False
    el, az = elevation_azimuth(position_m, los)
    return el, az, True


def _rows(
    o: Observation, predicted: FloatArray, los: FloatArray, el: FloatArray, az: FloatArray, noise: NoiseModel,
    fast: FloatArray, slow: FloatArray,
) -> Rows:  # fmt: skip
    cn0 = o.aux["cn0_dbhz"]
    return Rows(
        o.keys, o.y, predicted, los, noise.scale(el, cn0) * fast, noise.obliquity(el) * slow, el, az, cn0
    )


def system_of(key: str) -> str:
    """Return the constellation letter of a row."""
    return key[0]


def without(rows: Rows, exclude: frozenset[str]) -> Rows:
    """Return the rows but for those of some groups."""
    if not exclude:
        return rows
    return rows.select(np.array([group_of(k) not in exclude for k in rows.keys], dtype=bool))
