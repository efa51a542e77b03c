"""Real logs of the PPP-RTK campaigns: OPEC with products of its own, CLAS with those of a service."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from pntegrity.bounds.ism import Ism
from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators.ppp_rtk import PppRtk
from pntegrity.exclusion import Policy
from pntegrity.formats.products import ProductFiles
from pntegrity.formats.rinex_obs import read_observations
from pntegrity.logs import clas_log, precise_log, with_atmosphere
from pntegrity.monitors.separation import Separation
from pntegrity.physics.atmosphere_products import AtmosphereProducts
from pntegrity.physics.frames import enu_rotation
from pntegrity.physics.gnss_epochs import GnssEpochs
from pntegrity.pipeline import Checkpoint, Outcome, Pipeline
from pntegrity.records import Epoch, FloatArray, Update, group_of
from pntegrity.scenarios._ppp_logs import ANTEX, OPEC
from pntegrity.scenarios._real_logs import CLAS
from pntegrity.scenarios._rtk_simulated import estimator
from pntegrity.sensors.noise import PPP_RTK, NoiseModel
from pntegrity.simulate.products import disturbed
from pntegrity.stations import products_from_station

__all__ = [
    "CLAS_NOISE", "CLAS_TRUTH_M", "OPEC_NOISE", "OPEC_TRUTH_M", "SEEDS", "Track", "carried", "clas",
    "clas_missing", "opec", "pipeline", "run", "tracked", "watched",
]  # fmt: skip

OPEC_TRUTH_M = np.array(OPEC.truth_m)
CLAS_TRUTH_M = np.array(CLAS.truth_m)
#: Errors of products as the paper has them: slant on L1, zenith, m, and how long they last, s.
PRODUCT_M, PRODUCT_TAU_S = (0.2, 0.1), 1800.0
SEEDS = tuple(range(1, 11))
#: Chosen on 00:00-02:00 of OPEC, the rest is the default: the smallest horizontal error among those whose
#: errors are 0.7 to 1.3 of their sigmas in every direction.
OPEC_NOISE = replace(PPP_RTK, satellite_clock_m=3.5e-3, name="OPEC 00:00-02:00")
#: From the residuals at the known place in the first 300 s of CLAS: code 0.05 to 0.2 m at the zenith that
#: last 10 to 100 s, carrier 1.5 to 8 mm that last 5 to 15 s. The rest is the default.
CLAS_NOISE = replace(PPP_RTK, code_white_m=0.15, carrier_m=0.002, name="CLAS, first 300 s")
CORRECTIONS = ("clas_2021078M_sat.csv.gz", "clas_2021078M_trop.csv.gz")


@dataclass(frozen=True, eq=False)
class Track:
    """What became of a run: arrays over its epochs.

    Parameters
    ----------
    error_m, sigma_m, level_m : ndarray, shape (n, 3)
        East, north, up; nan where there is no position, levels nan where there is none.
    alarm : ndarray of bool, shape (n,)
        Whether a monitor gave an alert before any exclusion.
    alert : ndarray of bool, shape (n,)
        Whether one is left after exclusion, or who was left out is in doubt.
    left_out : mapping of int to tuple of str
        Groups excluded by epoch.
    readmitted : mapping of int to tuple of str
    """

    error_m: FloatArray
    sigma_m: FloatArray
    level_m: FloatArray
    alarm: npt.NDArray[np.bool_]
    alert: npt.NDArray[np.bool_]
    left_out: Mapping[int, tuple[str, ...]] = field(default_factory=lambda: MappingProxyType({}))
    readmitted: Mapping[int, tuple[str, ...]] = field(default_factory=lambda: MappingProxyType({}))

    def __len__(self) -> int:
        return len(self.error_m)

    @property
    def first(self) -> int | None:
        """The first epoch with an alarm."""
        return int(self.alarm.argmax()) if self.alarm.any() else None

    @property
    def suspects(self) -> tuple[str, ...]:
        """All groups that were excluded, in order."""
        return tuple(g for k in sorted(self.left_out) for g in self.left_out[k])

    @property
    def hpl_m(self) -> FloatArray:
        """Horizontal levels, shape (n,)."""
        return np.asarray(np.hypot(self.level_m[:, 0], self.level_m[:, 1]))

    @property
    def beyond(self) -> int:
        """Epochs whose error is beyond its level in any direction."""
        return int((np.abs(self.error_m) > self.level_m).any(axis=1).sum())


# --- the logs -----------------------------------------------------------------------------------------------


@lru_cache(maxsize=2)
def _opec(data: Path) -> tuple[GnssEpochs, AtmosphereProducts]:
    """Return OPEC, GPS and BDS, and products that its own data gave, 30 s late."""
    home = OPEC.home(data)
    table = replace(read_observations(home / OPEC.obs), antenna_delta_hen_m=np.zeros(3))
    files = ProductFiles([home / f for f in OPEC.sp3], [], antex=[data / ANTEX])
    loaded = precise_log(table, files, "GC", combined=False)
    options = GnssOptions(noise=PPP_RTK, max_gap_s=PppRtk.max_gap_s)
    return loaded, products_from_station(loaded.epochs, OPEC_TRUTH_M, options, latency_s=30.0, source="OPEC")


@lru_cache(maxsize=16)
def opec(data: Path, seed: int | None = None) -> tuple[Epoch, ...]:
    """Return OPEC with its own products; a seed adds the errors that the paper states."""
    loaded, products = _opec(data)
    if seed is not None:
        products = disturbed(products, *PRODUCT_M, PRODUCT_TAU_S, np.random.default_rng(seed))
    return tuple(with_atmosphere(loaded, products).epochs)


def clas_missing(data: Path) -> str:
    """Return which file is not there, empty where all are."""
    folder = data / CLAS.folder
    return CLAS.missing(data) or next(
        (f"{f} is not here" for f in CORRECTIONS if not (folder / f).is_file()), ""
    )


@lru_cache(maxsize=2)
def clas(data: Path) -> tuple[Epoch, ...]:
    """Return the log of CLAS, GPS, Galileo and QZSS, from the first epoch with corrections on."""
    folder = data / CLAS.folder
    found = clas_log(
        read_observations(folder / CLAS.obs), [folder / f for f in CLAS.nav],
        [folder / f for f in CORRECTIONS], None, "GEJ",
    )  # fmt: skip
    return tuple(found.epochs)


# --- runs ---------------------------------------------------------------------------------------------------


def pipeline(
    noise: NoiseModel, ism: Ism | None = None, *, pairs: bool = True, checkpoint: Checkpoint | None = None
) -> Pipeline:
    """Return the filter with solution separation, as a run of `ppp_rtk` has it."""
    ism = ism or Ism()
    monitor = Separation(p_fa=ism.p_fa, ism=ism, pairs=pairs)
    return Pipeline(estimator(noise), (monitor,), Policy(p_fa=ism.p_fa, **PppRtk.policy), checkpoint)


def run(
    epochs: Sequence[Epoch], place_m: FloatArray, noise: NoiseModel, ism: Ism | None = None, *,
    pairs: bool = False, checkpoint: Checkpoint | None = None,
) -> Track:  # fmt: skip
    """Return the track of a run from its beginning, or from a checkpoint."""
    driver = pipeline(noise, ism, pairs=pairs, checkpoint=checkpoint)
    return watched([driver.push(e) for e in epochs], place_m)


def watched(outcomes: Sequence[Outcome], place_m: FloatArray) -> Track:
    """Return the track of outcomes."""
    bare = tracked([o.update for o in outcomes], place_m)
    bounds = [o.verdicts[0].bound for o in outcomes]
    none = (np.nan, np.nan, np.nan)
    level = np.array([(b.east_m, b.north_m, b.up_m) if b is not None else none for b in bounds])
    return replace(
        bare, level_m=level,
        alarm=np.array([o.first[0].status == "alert" for o in outcomes], dtype=bool),
        alert=np.array([o.status == "alert" for o in outcomes], dtype=bool),
        left_out={k: tuple(e.group for e in o.exclusions) for k, o in enumerate(outcomes) if o.exclusions},
        readmitted={k: o.readmitted for k, o in enumerate(outcomes) if o.readmitted},
    )  # fmt: skip


def tracked(updates: Sequence[Update], place_m: FloatArray) -> Track:
    """Return the track of a filter without monitors: no levels, no alarms."""
    R, n = enu_rotation(place_m), len(updates)
    error, sigma = np.full((n, 3), np.nan), np.full((n, 3), np.nan)
    for k, u in enumerate(updates):
        if len(u.keys):
            error[k] = R @ (u.posterior.mean[:3] - place_m)
            sigma[k] = np.sqrt(np.diagonal(R @ u.posterior.P[:3, :3] @ R.T))
    none = np.zeros(n, dtype=bool)
    return Track(error, sigma, np.full((n, 3), np.nan), none, none)


def carried(epochs: Sequence[Epoch]) -> list[str]:
    """Return the satellites with a carrier at every one of some epochs."""
    seen = [{group_of(k) for o in e.observations if o.sensor == "carrier" for k in o.keys} for e in epochs]
    return sorted(set.intersection(*seen))
