"""Rows of code and range rate at a position: what every GNSS estimator starts from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from pntegrity.estimators._ins_options import InsOptions
from pntegrity.physics.atmosphere import klobuchar_m, troposphere_m
from pntegrity.physics.frames import elevation_azimuth
from pntegrity.physics.tables import Klobuchar
from pntegrity.records import Epoch, FloatArray, Observation
from pntegrity.sensors.gnss import geometry, range_rate
from pntegrity.sensors.noise import NoiseModel
from pntegrity.sensors.source import Source

#: Closer to the Earth's centre than this there is no local horizon and no atmosphere, m.
SURFACE_M = 6.3e6


@dataclass(frozen=True)
class GnssOptions:
    """What the GNSS estimators need to know.

    Parameters
    ----------
    noise : NoiseModel
    mask_rad : float
        Elevation mask.
    klobuchar : Klobuchar, optional
        Broadcast ionosphere coefficients, as `formats` gives them; None: no ionosphere model.
    doppler : bool
        Whether range rates are used.
    max_gap_s : float
        After a longer gap the filter starts anew.
    motion : str
        What a precise filter knows of the receiver's motion: ``"white"`` (nothing), ``"walk"``,
        ``"velocity"`` or ``"static"``.
    ins : InsOptions
        The inertial side, where there is one.
    sources : tuple of Source
        What ``multi_source`` has beside the IMU.
    """

    noise: NoiseModel = field(default_factory=NoiseModel)
    mask_rad: float = float(np.deg2rad(10.0))
    klobuchar: Klobuchar | None = None
    doppler: bool = True
    max_gap_s: float = 120.0
    motion: Literal["white", "walk", "velocity", "static"] = "white"
    ins: InsOptions = field(default_factory=InsOptions)
    sources: tuple[Source, ...] = ()


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


def code_rows(epoch: Epoch, position_m: FloatArray, options: GnssOptions) -> Rows:
    """Return the code rows above the mask; below `SURFACE_M` there is no mask and no atmosphere yet."""
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


def rate_rows(epoch: Epoch, position_m: FloatArray, velocity_mps: FloatArray, options: GnssOptions) -> Rows:
    """Return the range-rate rows above the mask."""
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


def track(epochs: Sequence[Epoch], options: GnssOptions) -> FloatArray:
    """Return least-squares positions of code, shape (n, 3), nan where there is none."""
    out, guess = np.full((len(epochs), 3), np.nan), np.zeros(3)
    for i, epoch in enumerate(epochs):
        fix = snapshot(epoch, options, guess)
        if not fix.reason:
            out[i] = guess = fix.position_m
    return out


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


@dataclass(frozen=True, eq=False)
class Fix:
    """A snapshot solution: position, a clock a constellation (m), and where there are range rates velocity
    with its covariance and clock drift.
    """

    position_m: FloatArray
    clocks_m: dict[str, float]
    velocity_mps: FloatArray | None
    drift_mps: float
    reason: str = ""
    velocity_cov: FloatArray | None = None


def snapshot(
    epoch: Epoch, options: GnssOptions, guess_m: FloatArray, exclude: frozenset[str] = frozenset()
) -> Fix:
    """Return the iterated weighted least-squares fix of one epoch; `reason` says why there is none.

    Parameters
    ----------
    epoch : Epoch
    options : GnssOptions
    guess_m : ndarray, shape (3,)
        Where to linearise first; the Earth's centre will do.
    exclude : frozenset of str
        Groups to leave out.
    """
    x = np.array(guess_m, dtype=np.float64)
    clocks: dict[str, float] = {}
    for _ in range(12):
        rows = without(code_rows(epoch, x, options), exclude)
        systems = tuple(sorted({system_of(k) for k in rows.keys}))
        if len(rows.keys) < 3 + len(systems):
            return _no_fix(
                x,
                f"a fix needs {3 + max(len(systems), 1)} satellites of this mix, there are {len(rows.keys)}",
            )
        step, clocks = _position_step(rows, systems, options)
        if not np.all(np.isfinite(step)):
            return _no_fix(x, "the geometry does not determine a position")
        x = x + step
        if float(step @ step) < 1e-4 and float(x @ x) > SURFACE_M**2:
            return _with_velocity(epoch, options, Fix(x, clocks, None, 0.0), exclude)
    return _no_fix(x, "the least-squares fix did not converge")


def _no_fix(x: FloatArray, reason: str) -> Fix:
    return Fix(x, {}, None, 0.0, reason)


def without(rows: Rows, exclude: frozenset[str]) -> Rows:
    """Return the rows but for those of some groups."""
    if not exclude:
        return rows
    return rows.select(np.array([k.partition(":")[0] not in exclude for k in rows.keys], dtype=bool))


def _position_step(
    rows: Rows, systems: tuple[str, ...], options: GnssOptions
) -> tuple[FloatArray, dict[str, float]]:
    clock = np.array([[system_of(k) == s for s in systems] for k in rows.keys], dtype=np.float64)
    weight = 1.0 / options.noise.snapshot_sigma_m(rows.scale, rows.slow)
    A = np.hstack([-rows.los, clock])
    solution, _, rank, _ = np.linalg.lstsq(
        A * weight[:, None], (rows.y - rows.predicted) * weight, rcond=None
    )
    if rank < A.shape[1]:
        return np.full(3, np.nan), {}
    return np.asarray(solution[:3], dtype=np.float64), dict(zip(systems, solution[3:].tolist(), strict=True))


def _with_velocity(epoch: Epoch, options: GnssOptions, fix: Fix, exclude: frozenset[str]) -> Fix:
    rows = without(rate_rows(epoch, fix.position_m, np.zeros(3), options), exclude)
    found = velocity_of(rows, options.noise.doppler_mps)
    if found is None:
        return fix
    velocity, drift, cov = found
    return replace(fix, velocity_mps=velocity, drift_mps=drift, velocity_cov=cov)


def velocity_of(rows: Rows, sigma_mps: float) -> tuple[FloatArray, float, FloatArray] | None:
    """Return least-squares velocity and clock drift of range rates predicted for a receiver at rest, and the
    velocity's covariance; None where they do not determine them.

    Parameters
    ----------
    rows : Rows
    sigma_mps : float
        Of a row at the zenith.
    """
    if len(rows.keys) < 4:
        return None
    weight = 1.0 / rows.scale
    A = np.hstack([-rows.los, np.ones((len(rows.keys), 1))]) * weight[:, None]
    solution, _, rank, _ = np.linalg.lstsq(A, (rows.y - rows.predicted) * weight, rcond=None)
    if rank < 4:
        return None
    cov = np.asarray(np.linalg.inv(A.T @ A)[:3, :3] * sigma_mps**2, dtype=np.float64)
    return np.asarray(solution[:3], dtype=np.float64), float(solution[3]), cov
