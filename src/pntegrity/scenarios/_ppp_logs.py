"""Real logs of the precise campaigns: where they are, what is known of them, and the filter run over them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

import numpy as np

from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators.ppp import Ppp
from pntegrity.evaluate.calibrate import updates_of
from pntegrity.exclusion import Policy
from pntegrity.formats.products import ProductFiles
from pntegrity.formats.rinex_obs import read_observations
from pntegrity.formats.truth import read_truth
from pntegrity.logs import precise_log
from pntegrity.physics.frames import enu_rotation
from pntegrity.physics.gnss_epochs import GnssEpochs
from pntegrity.pipeline import Checkpoint, Pipeline
from pntegrity.protocols import Monitor
from pntegrity.records import Epoch, FloatArray, Update
from pntegrity.scenarios._real_logs import monitors
from pntegrity.sensors.noise import PPP, NoiseModel

__all__ = [
    "CARD", "ESBC", "OPEC", "P_FA", "PreciseLog", "PreciseSite", "opened", "positions_of", "precise_monitors",
    "updates_of",
]  # fmt: skip

P_FA = 1e-6
ANTEX = "antex/igs14_sats_only.atx.gz"
DRIVE = "gnss_benchmark/datasets/mosaicx5_multi_dynamic"
"""Folder of the road drive in the wheel ``gnss-benchmark==2.3.0``."""


@dataclass(frozen=True)
class PreciseLog:
    """Where a log and its products are, and what is known of it.

    Parameters
    ----------
    name, folder, obs : str
        What the tables call it; folder under the data folder (or of the wheel), observation file.
    sp3, clk : tuple of str
    truth_m : tuple of float, optional
        ECEF position of a static antenna (not of its marker).
    truth_file : str, optional
        Reference trajectory, under the data folder.
    converged_s : float
        When the filter counts as converged.
    in_wheel : bool
        Whether the folder is in the optional wheel.
    motion : str
        What the filter knows of the motion.
    """

    name: str
    folder: str
    obs: str
    sp3: tuple[str, ...]
    clk: tuple[str, ...] = ()
    truth_m: tuple[float, float, float] | None = None
    truth_file: str | None = None
    converged_s: float = 3600.0
    in_wheel: bool = False
    motion: Literal["white", "velocity"] = "white"

    def home(self, data: Path) -> Path:
        """Return the folder."""
        if not self.in_wheel:
            return data / self.folder
        spec = find_spec("gnss_benchmark")
        origin = Path(spec.origin).parents[1] if spec is not None and spec.origin else data
        return origin / self.folder

    def missing(self, data: Path) -> str:
        """Return which file is not there, empty where all are."""
        home = self.home(data)
        files = [home / f for f in (self.obs, *self.sp3, *self.clk)] + [data / ANTEX]
        files += [data / self.truth_file] if self.truth_file else []
        absent = next((f.name for f in files if not f.is_file()), "")
        hint = ": pip install gnss-benchmark==2.3.0" if absent and self.in_wheel else ""
        return f"{absent} is not here{hint}" if absent else ""


ESBC = PreciseLog(
    "ESBC", "esbc-static-2020177", "ESBC00DNK_R_20201770000_06H_30S_MO.rnx.gz",
    ("GRG0MGXFIN_20201760000_01D_15M_ORB.SP3.gz", "GRG0MGXFIN_20201770000_01D_15M_ORB.SP3.gz"),
    ("GRG0MGXFIN_20201770000_07H_30S_CLK.CLK.gz",), (3582104.9334, 532590.2079, 5232755.3231),
)  # fmt: skip
OPEC = PreciseLog(
    "OPEC", "opec-static-2022001", "OPEC00NOR_S_20220010000_03H_30S_MO.rnx.gz",
    ("COD0MGXFIN_20220010000_01D_05M_ORB.SP3.gz",), truth_m=(3149785.49, 598261.34, 5495348.98),
)  # fmt: skip
CARD = PreciseLog(
    "CARD", DRIVE, "CARD00ESP_R_20203341240_20M_01S_MO.rnx", ("COD21340.sp3",),
    truth_file="card-mare-2020334/card_ppk_rtklib_combined.pos.gz", converged_s=300.0, in_wheel=True,
    motion="velocity",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class PreciseSite:
    """A log in memory with some constellations."""

    log: PreciseLog
    systems: str
    loaded: GnssEpochs
    truth_m: FloatArray = field(repr=False)

    @property
    def epochs(self) -> tuple[Epoch, ...]:
        """The epochs in time order."""
        return self.loaded.epochs

    @property
    def label(self) -> str:
        """What the tables call it."""
        return f"{self.log.name} {'+'.join(WORDS[s] for s in self.systems)}"

    @property
    def converged(self) -> int:
        """Index of the first epoch of a converged filter."""
        t = np.array([e.t_ns for e in self.epochs])
        return int(np.searchsorted(t, t[0] + self.log.converged_s * 1e9))

    def options(self, noise: NoiseModel = PPP) -> GnssOptions:
        """Return the estimator's options."""
        return GnssOptions(noise=noise, max_gap_s=Ppp.max_gap_s, motion=self.log.motion)

    def updates(self, noise: NoiseModel = PPP) -> list[Update]:
        """Run the filter, without monitors or exclusions."""
        return updates_of(self.epochs, self.options(noise), (), Ppp)

    def pipeline(self, noise: NoiseModel, checkpoint: Checkpoint | None = None) -> Pipeline:
        """Return the filter with all monitors."""
        policy = Policy(p_fa=P_FA, **Ppp.policy)
        return Pipeline(Ppp(self.options(noise)), precise_monitors(P_FA, noise), policy, checkpoint)

    def errors_m(self, positions: FloatArray) -> FloatArray:
        """Return east, north, up errors (n, 3) of positions (n, 3); nan where there is none."""
        middle = self.truth_m[np.flatnonzero(np.isfinite(self.truth_m).all(axis=1))[0]]
        return np.asarray((positions - self.truth_m) @ enu_rotation(middle).T)


WORDS = {"G": "GPS", "R": "GLO", "E": "GAL", "C": "BDS", "J": "QZS"}


@lru_cache(maxsize=8)
def opened(log: PreciseLog, data: Path, systems: str) -> PreciseSite:
    """Return a log in memory; kept for campaigns after each other."""
    home = log.home(data)
    table = read_observations(home / log.obs)
    table = replace(
        table, antenna_delta_hen_m=np.zeros(3)
    )  # references are of the antenna, not of the marker
    files = ProductFiles([home / f for f in log.sp3], [home / f for f in log.clk], antex=[data / ANTEX])
    loaded = precise_log(table, files, systems)
    t_ns = np.array([e.t_ns for e in loaded.epochs], dtype=np.int64)
    if log.truth_m is not None:
        return PreciseSite(log, systems, loaded, np.tile(np.array(log.truth_m), (len(t_ns), 1)))
    position, known = read_truth(data / str(log.truth_file)).at(t_ns)
    return PreciseSite(log, systems, loaded, np.where(known[:, None], position, np.nan))


def positions_of(updates: Sequence[Update]) -> FloatArray:
    """Return positions (n, 3); nan where no row was used."""
    none = np.full(3, np.nan)
    return np.array([u.posterior.mean[:3] if len(u.keys) else none for u in updates])


def precise_monitors(p_fa: float, noise: NoiseModel) -> tuple[Monitor, ...]:
    """Return exact monitors with the thresholds of a noise model, as a run of `ppp` has them."""
    return monitors(p_fa, noise, estimator=Ppp)
