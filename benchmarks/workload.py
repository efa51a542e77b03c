"""The logs that are measured: the real BRUX log where it is there, and the demo that ships with the
package.
"""

from __future__ import annotations

import gzip
import tempfile
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from pntegrity.config import RunConfig, make_config
from pntegrity.formats.truth import read_truth
from pntegrity.physics.frames import enu_rotation
from pntegrity.physics.gnss_epochs import GnssEpochs
from pntegrity.pipeline import Outcome
from pntegrity.records import Epoch, FloatArray
from pntegrity.run import load_epochs, pipeline_for, run
from pntegrity.scenarios.demo import demo_paths

__all__ = ["DEFAULT_DATA", "FAULTED", "FIRST", "LAST", "Workload", "brux", "demo"]

#: Where the data are looked for when no folder is given: beside the repository.
DEFAULT_DATA = Path(__file__).parents[2] / "shared" / "data"
#: Three satellites of two constellations with `FAULT_M` on their code at once, in epochs `FIRST` to `LAST` -
#: 1.
FAULTED = ("G03", "G17", "E08")
FAULT_M = 60.0
FIRST, LAST = 300, 360

_BRUX = "brux-static-2019014"
_BRUX_OBS = "BRUX00BEL_S_20190140615_15M_01S_MO.rnx.gz"
_BRUX_NAV = "BRDC00WRD_R_20190140000_01D_MN.rnx.gz"
_BRUX_TRUTH = (4027881.6280, 306998.5370, 4919498.9840)


@dataclass
class Workload:
    """A log, decompressed in a temporary folder so that every tool reads the same bytes.

    Parameters
    ----------
    name : str
    obs, nav : Path
        Plain RINEX.
    truth_ecef_m : tuple of float, optional
        Of a static receiver.
    truth : Path, optional
        Reference trajectory.
    """

    name: str
    obs: Path
    nav: Path
    truth_ecef_m: tuple[float, float, float] | None = None
    truth: Path | None = None
    _open: ExitStack = field(default_factory=ExitStack, repr=False)

    def config(self, **options: object) -> RunConfig:
        """Return the configuration of a run on this log."""
        known = {"truth_ecef_m": self.truth_ecef_m, "truth": self.truth}
        return make_config({"obs": self.obs, "nav": (self.nav,)} | known | options)

    @cached_property
    def loaded(self) -> GnssEpochs:
        """The epochs, as `run` reads them."""
        return load_epochs(self.config())

    @cached_property
    def faulted(self) -> GnssEpochs:
        """The same with three faults at once, from epoch `FIRST` to `LAST`."""
        span = f"{FIRST}:{LAST}"
        return load_epochs(self.config(faults=tuple(f"{s} bias {FAULT_M:g} m {span}" for s in FAULTED)))

    @cached_property
    def truth_m(self) -> FloatArray:
        """True position of every epoch, shape (n, 3); nan where it is not known."""
        t_ns = np.array([e.t_ns for e in self.loaded.epochs], dtype=np.int64)
        if self.truth_ecef_m is not None:
            return np.tile(np.array(self.truth_ecef_m), (len(t_ns), 1))
        if self.truth is None:
            return np.full((len(t_ns), 3), np.nan)
        position, valid = read_truth(self.truth).at(t_ns)
        return np.where(valid[:, None], position, np.nan)

    def horizontal_m(self, k: int, position_m: FloatArray) -> float:
        """Return the horizontal error of a position at epoch `k`."""
        east, north, _ = enu_rotation(self.truth_m[k]) @ (position_m - self.truth_m[k])
        return float(np.hypot(east, north))

    def outcomes(self, epochs: tuple[Epoch, ...], **options: object) -> list[Outcome]:
        """Return what the pipeline makes of epochs."""
        pipeline = pipeline_for(self.config(**options), self.loaded)
        return [pipeline.push(e) for e in epochs]

    def finished(self) -> object:
        """Return the result of the whole job, ready to be written."""
        return run(self.config())

    def close(self) -> None:
        """Remove the temporary files."""
        self._open.close()


def _unpacked(stack: ExitStack, obs: Path, nav: Path) -> tuple[Path, Path]:
    folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="pntegrity-bench-")))
    for source, name in ((obs, "obs.rnx"), (nav, "nav.rnx")):
        (folder / name).write_bytes(gzip.decompress(source.read_bytes()))
    return folder / "obs.rnx", folder / "nav.rnx"


def brux(data: Path) -> Workload:
    """Return the BRUX log: 900 epochs at 1 Hz of GPS, GLONASS, Galileo and BDS.

    Raises
    ------
    FileNotFoundError
        Naming what is not there.
    """
    obs, nav = data / _BRUX / _BRUX_OBS, data / _BRUX / _BRUX_NAV
    for path in (obs, nav):
        if not path.is_file():
            raise FileNotFoundError(f"{_BRUX}/{path.name} is not in the data folder")
    stack = ExitStack()
    return Workload("brux", *_unpacked(stack, obs, nav), truth_ecef_m=_BRUX_TRUTH, _open=stack)


def demo() -> Workload:
    """Return the embedded demo: a simulated drive with known faults."""
    stack = ExitStack()
    paths = stack.enter_context(demo_paths())
    return Workload("demo", *_unpacked(stack, paths.obs, paths.nav), truth=paths.truth, _open=stack)
