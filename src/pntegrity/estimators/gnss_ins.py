"""GNSS and an inertial measurement unit in one filter: position, velocity, attitude and the unit's errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal

from pntegrity.estimators import _ins_loose, _ins_tight
from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators._ins_alignment import Alignment
from pntegrity.estimators._ins_motion import advance, is_lost
from pntegrity.estimators._ins_start import align, begun
from pntegrity.estimators._navigation import not_started
from pntegrity.estimators._usual import Usual
from pntegrity.records import Epoch, Prior, State, Update
from pntegrity.sensors.noise import CITY, NoiseModel

__all__ = ["GnssIns"]

LOST = "restart: without inertial data for too long the attitude was lost"
#: Exclusion of fixes: the unit bridges some seconds well and half a minute badly.
TRUSTING = {"trust_prior": True, "proof_s": 3.0, "proof_epochs": 5, "reacquire_s": 30.0}


@dataclass(frozen=True)
class GnssIns(Usual):
    """Error-state filter in the Earth frame, closed loop, with a lever arm.

    Tight coupling: pseudoranges and range rates are rows; clock, drift, inter-system biases and an error of
    each satellite that lasts a while are states beside those of the INS. Loose coupling: a least-squares fix
    of position and velocity is what is measured, or a receiver's own fix. States of the INS: position,
    velocity, attitude, biases and scale factors of gyroscopes and accelerometers.

    Parameters
    ----------
    options : GnssOptions
        `options.ins` says all about the inertial side.

    References
    ----------
    Groves (2013), Principles of GNSS, inertial, and multisensor integrated navigation systems, ch. 14. Chen
    et al. (2023), A factor set-based GNSS fault detection and exclusion, eqs (21)-(22).
    """

    default_noise: ClassVar[NoiseModel] = CITY
    max_gap_s: ClassVar[float] = 600.0
    monitors: ClassVar[tuple[str, ...]] = ("factor_set", "separation")
    monitoring: ClassVar[dict[str, dict[str, Any]]] = {"separation": {"pairs": False, "levels": "observed"}}
    surroundings: ClassVar[Literal["open", "city"]] = "city"
    options: GnssOptions = field(default_factory=GnssOptions)

    @property
    def policy(self) -> Mapping[str, Any]:  # type: ignore[override]
        """What suits the pipeline: detection of the tight filter is its own, no restart loses the attitude,
        and a fix that contradicts the unit is at fault.
        """
        usual = {"keep_rows": 0, "most_excluded": 1.0, "restart_s": float("inf")}
        if self._is_tight:
            return usual | {"exclude": False}
        return usual | (TRUSTING if self.options.ins.fde == "ours" else {})

    def predict(self, state: State, epoch: Epoch) -> Prior:
        """Return the prior at `epoch`; an empty one as long as the attitude is not known."""
        dt = (epoch.t_ns - state.t_ns) * 1e-9
        if not len(state):
            return align(state, epoch, self.options, ())
        if dt > self.options.max_gap_s or dt <= 0.0:
            return self._anew(state, epoch, f"restart after a gap of {dt:.0f} s")
        moved = advance(state, epoch.imu, dt, self.options.ins)
        if is_lost(state, moved) and len((anew := self._anew(state, epoch, LOST)).state):
            return anew
        step = _ins_tight.predict if self._is_tight else _ins_loose.predict
        return step(state, moved, epoch, dt, self.options)

    def _anew(self, state: State, epoch: Epoch, event: str) -> Prior:
        """Return the prior of a filter that must align again; a heading given for the start is of no use."""
        empty = replace(State.empty(state.t_ns), aside=Alignment(is_late=True))
        return align(empty, epoch, self.options, (event,), len(state))

    def relax(self, prior: Prior) -> Prior:
        """Return the prior with position, velocity and clock born anew; attitude and the IMU's errors
        stay.
        """
        if not len(prior.state):
            return prior
        return begun(prior, "position and velocity started anew")

    def correct(self, prior: Prior, epoch: Epoch, exclude: frozenset[str] = frozenset()) -> Update:
        """Use the epoch's rows but for those of the groups in `exclude` and those that fail detection."""
        if not len(prior.state):
            return not_started(prior)
        step = _ins_tight.correct if self._is_tight else _ins_loose.correct
        return step(prior, epoch, self.options, exclude)

    @property
    def _is_tight(self) -> bool:
        return self.options.ins.coupling == "tight"
