"""What suits an estimator of GNSS where nothing else is asked for, and what the precise ones share."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import numpy as np

from pntegrity.estimators._precise_filter import PreciseFilter
from pntegrity.records import Epoch, Prior, State, Update
from pntegrity.sensors.noise import Fitted, NoiseModel

__all__ = ["ALWAYS_FITTED", "Precise", "Usual"]

#: Monitors of a run that names none.
MONITORS = ("rctm", "srctm", "aime", "sraime", "glr")

#: What a calibration of any precise estimator fits beside sizes of noise.
ALWAYS_FITTED = (
    Fitted("isb_m", 1e-6, 0.1),
    Fitted("satellite_clock_m", 1e-5, 0.1, rows="carrier"),
    Fitted("glonass_factor", 1.0, 6.0),
    Fitted("glonass_carrier_factor", 1.0, 6.0),
    Fitted("bds2_factor", 1.0, 6.0),
)


class Usual:
    """What suits estimators of code; see `protocols.Estimator`.

    ``bands`` says which rows of two frequencies it takes: ``"one"`` (or combined, where that is asked for),
    ``"combined"``, or ``"apart"``.
    """

    default_noise: ClassVar[NoiseModel] = NoiseModel()
    max_gap_s: ClassVar[float] = 120.0
    bands: ClassVar[Literal["one", "combined", "apart"]] = "one"
    monitors: ClassVar[tuple[str, ...]] = MONITORS
    monitoring: ClassVar[dict[str, dict[str, Any]]] = {}
    policy: ClassVar[dict[str, Any]] = {}
    surroundings: ClassVar[Literal["open", "city"]] = "open"
    settle_s: ClassVar[float] = 0.0
    clip_sigma: ClassVar[float] = np.inf
    fitted: ClassVar[tuple[Fitted, ...]] = ()


class Precise(Usual):
    """Estimators of code and carrier: the steps of their filter."""

    max_gap_s: ClassVar[float] = 3600.0
    monitoring: ClassVar[dict[str, dict[str, Any]]] = {
        "srctm": {"block": "pos+amb"}, "aime": {"window": 10}, "sraime": {"block": "pos+amb", "window": 10},
    }  # fmt: skip
    policy: ClassVar[dict[str, Any]] = {"proof_s": 10.0}
    settle_s: ClassVar[float] = 3600.0
    clip_sigma: ClassVar[float] = 4.0

    @property
    def _filter(self) -> PreciseFilter:
        raise NotImplementedError

    def predict(self, state: State, epoch: Epoch) -> Prior:
        """Return the prior at `epoch`; starts from a code fix where there is no state or the gap is too
        long.
        """
        return self._filter.predict(state, epoch)

    def relax(self, prior: Prior) -> Prior:
        """Return the prior with position, velocity and clock born anew; all else stays known."""
        return self._filter.relax(prior)

    def correct(self, prior: Prior, epoch: Epoch, exclude: frozenset[str] = frozenset()) -> Update:
        """Use the epoch's rows but for those of the groups in `exclude`, and products about them."""
        return self._filter.correct(prior, epoch, exclude)
