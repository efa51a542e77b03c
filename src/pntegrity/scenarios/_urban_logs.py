"""Drives through towns: the real log of Tsim Sha Tsui and the simulation on the real drive in Nagoya, both
with a simulated IMU.

Positions of the reference in Tsim Sha Tsui are taken for those of the antenna, and the IMU is simulated
there; those of the reference in Nagoya for the IMU's, and the antenna is a lever arm away.
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from pntegrity.estimators._gnss import GnssOptions
from pntegrity.formats.rinex_nav import read_navigation
from pntegrity.formats.truth import Truth, read_truth
from pntegrity.physics.frames import enu_rotation
from pntegrity.physics.tables import Klobuchar, Navigation
from pntegrity.physics.time import SECOND_NS
from pntegrity.records import Epoch, FloatArray
from pntegrity.scenarios._real_logs import TST, Site
from pntegrity.sensors.imu import ImuSpec
from pntegrity.sensors.increments import with_increments
from pntegrity.sensors.noise import NoiseModel
from pntegrity.simulate.error_library import ErrorLibrary, library_of
from pntegrity.simulate.imu import increments, with_errors
from pntegrity.simulate.motion import Motion, motion_of
from pntegrity.simulate.urban import urban_epochs
from pntegrity.simulate.urban_scenario import CHALLENGING, OPEN, Section, UrbanScenario

__all__ = [
    "UrbanLog", "missing", "nagoya_log", "nagoya_truth", "open_log", "scenario", "tst_library", "tst_log",
    "tst_with_imu",
]  # fmt: skip

#: Between the first and last time of a reference and the first and last epoch, s: motion is smooth inside.
MARGIN_S = 1


@dataclass(frozen=True, eq=False)
class UrbanLog:
    """A drive with all that a fusion needs, and its truth.

    Parameters
    ----------
    epochs : tuple of Epoch
        Code, range rates and increments.
    position_m, velocity_mps, axes : ndarray, shapes (n, 3), (n, 3) and (n, 3, 3)
        Truth of the IMU at the epochs; `axes` turn body axes into ECEF.
    antenna_m : ndarray, shape (n, 3)
        True positions of the antenna.
    kind : tuple of str
        Section of each epoch.
    klobuchar : Klobuchar, optional
    spec : ImuSpec
    lever_arm_m : tuple of float
        From the IMU to the antenna; forward, right, down.
    imu_errors : ndarray, shape (n, 12)
        True gyroscope bias, accelerometer bias, gyroscope scale, accelerometer scale at the epochs.
    """

    epochs: tuple[Epoch, ...]
    position_m: FloatArray
    velocity_mps: FloatArray
    axes: FloatArray
    antenna_m: FloatArray
    kind: tuple[str, ...]
    klobuchar: Klobuchar | None
    spec: ImuSpec
    lever_arm_m: tuple[float, float, float]
    imu_errors: FloatArray

    @property
    def to_enu(self) -> FloatArray:
        """Rotation of ECEF into east, north, up at the drive's first position."""
        return enu_rotation(self.position_m[0])


@cache
def _facts() -> dict[str, Any]:
    """Return what ``factor_set.toml`` holds."""
    text = files("pntegrity.scenarios").joinpath("factor_set.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


@cache
def scenario() -> UrbanScenario:
    """Return the simulation that the comparison of methods runs on."""
    return UrbanScenario.of(_facts()["scenario"])


def missing(data: Path) -> str:
    """Return which file of the two drives is not there, empty where all are."""
    lost = next((f"{f} is not here" for f in _facts()["files"].values() if not (data / f).is_file()), "")
    return lost or TST.missing(data)


@cache
def tst_log(data: Path) -> tuple[tuple[Epoch, ...], Truth, Klobuchar | None, Motion]:
    """Return the epochs of Tsim Sha Tsui that have a truth, that truth, the ionosphere and the motion."""
    site = Site(TST, data)
    truth = read_truth(data / TST.folder / str(TST.truth_file))
    known = np.flatnonzero(np.isfinite(site.truth_m).all(axis=1))
    epochs = tuple(site.epochs[i] for i in known.tolist())
    return epochs, truth, site.loaded.klobuchar, motion_of(truth)


@cache
def tst_library(data: Path) -> ErrorLibrary:
    """Return the errors that the receiver in Tsim Sha Tsui had."""
    epochs, _, klobuchar, motion = tst_log(data)
    position, velocity, _ = motion.at(_times(epochs))
    return library_of(epochs, position, velocity, GnssOptions(klobuchar=klobuchar))


@cache
def nagoya_truth(data: Path) -> Truth:
    """Return the reference trajectory of Nagoya, with attitude."""
    return read_truth(data / _facts()["files"]["truth"])


@cache
def _nagoya(data: Path) -> tuple[Motion, Navigation]:
    return motion_of(nagoya_truth(data)), read_navigation([data / _facts()["files"]["nav"]])


def nagoya_log(data: Path, load: str, seed: int, spec: ImuSpec, section: str | None = None) -> UrbanLog:
    """Return the simulated drive through Nagoya.

    Parameters
    ----------
    data : Path
        The data folder.
    load : str
        ``"full"`` or ``"moderate"``.
    seed : int
        The same seed gives the same log. GNSS and IMU have streams of their own: errors of the IMU are those
        of the seed at any load.
    spec : ImuSpec
        How good the IMU is; it runs at the scenario's rate.
    section : str, optional
        ``"open"``: the whole drive is under the open sky.

    Raises
    ------
    ValueError
        Another `section`, or an unknown load.
    """
    town, truth = scenario(), nagoya_truth(data)
    if section not in (None, OPEN):
        raise ValueError(f"`section` must be None or {OPEN!r}, not {section!r}")
    if section == OPEN:
        town = replace(town, sections=(Section(OPEN, town.sections[0].start_s, town.sections[-1].end_s),))
    return _simulated(data, town, load, seed, spec, _grid(truth, town.rate_hz))


def open_log(
    data: Path, noise: NoiseModel, seed: int, spec: ImuSpec, start_s: float, end_s: float
) -> UrbanLog:
    """Return a part of the drive through Nagoya under an open sky, GNSS errors drawn from a noise model.

    Parameters
    ----------
    data : Path
    noise : NoiseModel
    seed : int
    spec : ImuSpec
    start_s, end_s : float
        Since the first epoch of the drive.
    """
    town = replace(scenario(), noise=noise, sections=(Section(OPEN, 0.0, end_s - start_s),))
    t_ns = _grid(nagoya_truth(data), town.rate_hz)
    since = (t_ns - t_ns[0]) * 1e-9
    return _simulated(data, town, "full", seed, spec, t_ns[(since >= start_s) & (since < end_s)])


def _simulated(
    data: Path, town: UrbanScenario, load: str, seed: int, spec: ImuSpec, t_ns: npt.NDArray[np.int64]
) -> UrbanLog:
    truth, (motion, nav) = nagoya_truth(data), _nagoya(data)
    gnss, inertial = _generators(seed)
    made = urban_epochs(town, load, motion, t_ns, nav, tst_library(data), gnss)
    imu = _Imu(motion, truth, replace(spec, rate_hz=town.imu_rate_hz), inertial)
    return UrbanLog(
        imu.fused(made.epochs), made.position_m, made.velocity_mps, made.axes, made.antenna_m, made.kind,
        nav.klobuchar.get("G"), imu.spec, town.lever_arm_m, imu.errors_at(t_ns),
    )  # fmt: skip


def tst_with_imu(data: Path, seed: int, spec: ImuSpec) -> UrbanLog:
    """Return the real GNSS of Tsim Sha Tsui with an IMU simulated on its truth, at the antenna.

    Its sections are all ``"challenging"``.
    """
    epochs, truth, klobuchar, motion = tst_log(data)
    t_ns = _times(epochs)
    position, velocity, axes = motion.at(t_ns)
    imu = _Imu(motion, truth, replace(spec, rate_hz=scenario().imu_rate_hz), _generators(seed)[1])
    return UrbanLog(
        imu.fused(epochs), position, velocity, axes, position, (CHALLENGING,) * len(epochs), klobuchar,
        imu.spec, (0.0, 0.0, 0.0), imu.errors_at(t_ns),
    )  # fmt: skip


def _generators(seed: int) -> list[np.random.Generator]:
    """Return generators of GNSS and IMU."""
    return np.random.default_rng(seed).spawn(2)


def _times(epochs: Sequence[Epoch]) -> npt.NDArray[np.int64]:
    return np.array([e.t_ns for e in epochs], dtype=np.int64)


def _grid(truth: Truth, rate_hz: float) -> npt.NDArray[np.int64]:
    """Return the epochs of a simulation on a reference."""
    step, margin = round(SECOND_NS / rate_hz), MARGIN_S * SECOND_NS
    return np.arange(truth.t_ns[0] + margin, truth.t_ns[-1] - margin + 1, step, dtype=np.int64)


class _Imu:
    """An IMU that is as good as its specification, over the whole of a reference."""

    def __init__(self, motion: Motion, truth: Truth, spec: ImuSpec, rng: np.random.Generator) -> None:
        felt = increments(motion, int(truth.t_ns[0]), int(truth.t_ns[-1]), spec.rate_hz)
        self.spec = spec
        self.whole, self.errors = with_errors(felt, spec, rng)

    def fused(self, epochs: tuple[Epoch, ...]) -> tuple[Epoch, ...]:
        """Return the epochs with increments."""
        return with_increments(epochs, self.whole)

    def errors_at(self, t_ns: npt.NDArray[np.int64]) -> FloatArray:
        """Return biases and scale factors at times, shape (n, 12)."""
        at = np.searchsorted(self.whole.t_ns, t_ns).clip(0, len(self.errors) - 1)
        return np.asarray(self.errors[at])
