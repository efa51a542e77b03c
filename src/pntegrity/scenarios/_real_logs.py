"""Real logs of the evidence campaigns: where they are, what is known of them, and the filter run over
them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators.spp_kf import SppKf
from pntegrity.evaluate.calibrate import Calibration, calibrate
from pntegrity.formats.rinex_nav import read_navigation
from pntegrity.formats.rinex_obs import read_observations
from pntegrity.monitors import discover
from pntegrity.physics.frames import enu_rotation
from pntegrity.physics.gnss_epochs import GnssEpochs, gnss_epochs
from pntegrity.protocols import Monitor
from pntegrity.records import Epoch, FloatArray
from pntegrity.sensors.noise import NoiseModel

__all__ = ["BRUX", "CLAS", "NAMES", "TST", "WALK", "Log", "Row", "Site", "monitors", "row", "skipped"]

Row = dict[str, Any]

#: Monitors in the order of the tables.
NAMES = ("rctm", "srctm", "aime", "sraime", "glr")


def row(
    campaign: str,
    quantity: str,
    must: str,
    measured: Any,
    ok: bool | None = None,
    *,
    interval: Sequence[float] | None = None,
    note: str = "",
) -> Row:
    """Return one figure: what it is, what it must be, what was measured; `ok` None where it is only
    stated.
    """
    found = None if interval is None else [float(v) for v in interval]
    names = ("campaign", "quantity", "must", "measured", "interval", "ok", "note")
    return dict(zip(names, (campaign, quantity, must, measured, found, ok, note), strict=True))


def skipped(campaign: str, reason: str) -> list[Row]:
    """Return the only row of a campaign that could not run."""
    return [row(campaign, "not run", "stated", None, note=reason)]


def monitors(
    p_fa: float, noise: NoiseModel, names: Sequence[str] = NAMES, estimator: type[Any] = SppKf
) -> tuple[Monitor, ...]:
    """Return exact monitors with the thresholds of a noise model and the options that suit an estimator."""
    usual = estimator.monitoring
    return tuple(discover()[n](p_fa=p_fa, factor=noise.factor(n), **usual.get(n, {})) for n in names)


@dataclass(frozen=True)
class Log:
    """Where a log is, and what is known of it.

    Parameters
    ----------
    folder, obs : str
        Folder under the data folder, and the observation file in it.
    nav : tuple of str
        Navigation files.
    truth_m : tuple of float, optional
        ECEF position of a static receiver.
    truth_file : str, optional
        Reference trajectory.
    systems : str
        Constellations to use.
    """

    folder: str
    obs: str
    nav: tuple[str, ...]
    truth_m: tuple[float, float, float] | None = None
    truth_file: str | None = None
    systems: str = "GREC"

    def missing(self, data: Path) -> str:
        """Return which file is not there, empty where all are."""
        files = (self.obs, *self.nav, *([self.truth_file] if self.truth_file else []))
        return next(
            (f"{self.folder}/{f} is not here" for f in files if not (data / self.folder / f).is_file()), ""
        )


BRUX = Log(
    "brux-static-2019014",
    "BRUX00BEL_S_20190140615_15M_01S_MO.rnx.gz",
    ("BRDC00WRD_R_20190140000_01D_MN.rnx.gz",),
    (4027881.6280, 306998.5370, 4919498.9840),
)
CLAS = Log(
    "clas-sept-2021078",
    "SEPT078M.21O.gz",
    ("SEPT078M.21P.gz", "30340780.21q.gz"),
    (-3962108.673, 3381309.574, 3668678.638),
    systems="GECJ",
)
TST = Log(
    "tst-urban-2019118",
    "COM3_190428_124409.obs.gz",
    ("hksc1180.19n.gz", "hksc1180.19b.gz"),
    truth_file="groundTruth_TST.csv.gz",
    systems="GC",
)
WALK = Log(
    "imu-walk-2025240", "walk.obs.gz", ("walk.nav.gz",), truth_file="gnss_1730_sf.pos.gz", systems="GEC"
)


@dataclass(frozen=True, eq=False)
class Site:
    """A log in memory.

    Parameters
    ----------
    log : Log
    data : Path
        The data folder.
    fitted : NoiseModel, optional
        A noise model fitted before; else `calibrate` fits one on the first half when it is first asked for.
    """

    log: Log
    data: Path
    fitted: NoiseModel | None = field(default=None)

    @cached_property
    def loaded(self) -> GnssEpochs:
        """Everything that was read."""
        folder = self.data / self.log.folder
        navigation = read_navigation([folder / n for n in self.log.nav])
        return gnss_epochs(read_observations(folder / self.log.obs), navigation, systems=self.log.systems)

    @property
    def epochs(self) -> tuple[Epoch, ...]:
        """The epochs in time order."""
        return self.loaded.epochs

    @property
    def half(self) -> int:
        """Index of the first epoch of the second half."""
        return len(self.epochs) // 2

    @cached_property
    def truth_m(self) -> FloatArray:
        """True positions (n, 3); nan where they are not known."""
        n = len(self.epochs)
        if self.log.truth_m is not None:
            return np.tile(np.array(self.log.truth_m), (n, 1))
        if self.log.truth_file is None:
            return np.full((n, 3), np.nan)
        from pntegrity.formats.truth import read_truth

        truth = read_truth(self.data / self.log.folder / self.log.truth_file)
        return truth.at(np.array([e.t_ns for e in self.epochs], dtype=np.int64))[0]

    def options(self, noise: NoiseModel | None = None) -> GnssOptions:
        """Return the estimator's options."""
        return GnssOptions(noise=noise or NoiseModel(), klobuchar=self.loaded.klobuchar)

    @cached_property
    def calibration(self) -> Calibration:
        """The calibration on the first half."""
        return calibrate(self.epochs, self.options(), monitors)

    @property
    def noise(self) -> NoiseModel:
        """The fitted noise model."""
        return self.fitted or self.calibration.noise

    def models(self) -> dict[str, NoiseModel]:
        """Return the models that the tables compare."""
        return {"calibrated": self.noise, "default": NoiseModel()}

    def horizontal_m(self, positions: npt.ArrayLike, first: int = 0) -> FloatArray:
        """Return horizontal errors of positions (n, 3) at the epochs from `first` on; nan where there is
        none.
        """
        found = np.asarray(positions, dtype=np.float64)
        truth = self.truth_m[first : first + len(found)]
        known = np.isfinite(truth).all(axis=1) & np.isfinite(found).all(axis=1)
        out = np.full(len(found), np.nan)
        if known.any():
            enu = (found[known] - truth[known]) @ enu_rotation(truth[known][0]).T
            out[known] = np.hypot(enu[:, 0], enu[:, 1])
        return out


def rms(errors: FloatArray) -> float:
    """Return the root mean square of the finite errors, nan where there is none."""
    known = errors[np.isfinite(errors)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else float("nan")


def without_groups(epoch: Epoch, keep: frozenset[str]) -> Epoch:
    """Return the epoch with only the rows of some groups."""
    kept = tuple(
        o.select(np.array([k.partition(":")[0] in keep for k in o.keys], dtype=bool))
        for o in epoch.observations
    )
    return replace(epoch, observations=kept)
