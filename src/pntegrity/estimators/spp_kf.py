"""Kalman single point positioning: code and range rate, with the slow errors of each satellite in the
state.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from pntegrity.estimators._errors import error_kinds
from pntegrity.estimators._filter import clock_walk, clocks, integrated_walk, next_layout, transition
from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators._navigation import START_VARIANCE, fix_prior, linear_update, not_started
from pntegrity.estimators._usual import Usual
from pntegrity.kernels.linear import symmetric
from pntegrity.kernels.sparse import sandwich
from pntegrity.records import Epoch, FloatArray, Prior, State, Update
from pntegrity.sensors.noise import Fitted, NoiseModel
from pntegrity.sensors.pseudoranges import Rows, code_rows, rate_rows


@dataclass(frozen=True)
class SppKf(Usual):
    """Extended Kalman filter of position, velocity, clock, drift, inter-system biases and satellite errors.

    Motion is white acceleration. The clock of the constellation seen first carries phase and drift; every
    further constellation has an inter-system bias to it (one clock a constellation). A satellite in view has
    a bias and a multipath state where the noise model has them; they are born when it rises and die when it
    sets.

    Parameters
    ----------
    options : GnssOptions
    """

    settle_s: ClassVar[float] = 30.0
    fitted: ClassVar[tuple[Fitted, ...]] = (  # starts: a geodetic receiver
        Fitted("doppler_mps", 1e-3, 5.0, 0.01),
        Fitted("code_multipath_m", 0.01, 30.0, 0.08, "slow"),
        Fitted("code_white_m", 0.005, 30.0, 0.02, "white"),
        Fitted("code_multipath_tau_s", 1.5, 300.0, 4.0, size="code_multipath_m"),
        Fitted("code_smoothing_tau_s", 0.1, 1.0, 0.4),
        Fitted("accel_mps2", 1e-3, 10.0),
        Fitted("clock_drift_mps", 1e-4, 10.0),
        Fitted("clock_m", 1e-4, 10.0),
        Fitted("code_bias_m", 0.3, 20.0, 1.0, "slow"),
        Fitted("glonass_factor", 1.0, 6.0),
        Fitted("bds2_factor", 1.0, 6.0),
    )
    options: GnssOptions = field(default_factory=GnssOptions)

    def predict(self, state: State, epoch: Epoch) -> Prior:
        """Return the prior at `epoch`; starts from a snapshot where there is no state or the gap is too
        long.
        """
        dt = (epoch.t_ns - state.t_ns) * 1e-9
        if not len(state):
            return self._start(state, epoch, ())
        if dt > self.options.max_gap_s or dt <= 0.0:
            return self._start(state, epoch, (f"restart after a gap of {dt:.0f} s",))
        moved = state.mean[:3] + dt * state.mean[3:6]
        rows = code_rows(epoch, moved, self.options)
        layout = next_layout(state.layout, rows.keys, error_kinds(self.options.noise))
        F, Q = transition(state.layout, layout, dt, self.options.noise, rows)
        _kinematics(F, Q, dt, self.options.noise)
        mean = F @ state.mean
        mean, F, Q, consumed, events = clocks(mean, F, Q, layout, state.layout, rows)
        P = symmetric(sandwich(F, state.P) + Q)
        return Prior(State(epoch.t_ns, mean, P, layout), F, Q, consumed, events, rows)

    def relax(self, prior: Prior) -> Prior:
        """Return the prior with position, velocity, clock and drift born anew; the satellites' errors stay
        known.
        """
        if not len(prior.state):
            return prior
        F, Q, P = prior.F.copy(), prior.Q.copy(), prior.state.P.copy()
        for matrix in (Q, P):
            matrix[:8], matrix[:, :8] = 0.0, 0.0
            matrix[range(8), range(8)] = START_VARIANCE
        F[:8] = 0.0
        event = "motion or clock beyond the model: position, velocity and clock started anew"
        state = State(prior.state.t_ns, prior.state.mean, P, prior.state.layout)
        return Prior(state, F, Q, prior.consumed + 8, (*prior.events, event), prior.context)

    def correct(self, prior: Prior, epoch: Epoch, exclude: frozenset[str] = frozenset()) -> Update:
        """Use the epoch's rows but for those of the groups in `exclude`."""
        if (
            exclude and len(prior.state) and not prior.F.any()
        ):  # a start stands around a fix of rows that must not be in it
            before = prior.F.shape[1]
            prior = fix_prior(
                epoch, self.options, prior.state.mean[:3], before, self.options.noise, prior.events, exclude
            )
        if not len(prior.state):
            return not_started(prior)
        code: Rows = prior.context
        rate = rate_rows(epoch, prior.state.mean[:3], prior.state.mean[3:6], self.options)
        noise = self.options.noise
        return linear_update(
            prior, code, rate, noise.code_white_m * code.scale, noise.doppler_mps * rate.scale, exclude
        )

    def _start(self, old: State, epoch: Epoch, events: tuple[str, ...]) -> Prior:
        guess = old.mean[:3] if len(old) else np.zeros(3)
        return fix_prior(epoch, self.options, guess, len(old), self.options.noise, (*events, "start"))


def _kinematics(F: FloatArray, Q: FloatArray, dt: float, noise: NoiseModel) -> None:
    for i in range(3):
        integrated_walk(F, Q, i, i + 3, noise.accel_mps2**2, dt)
    clock_walk(F, Q, dt, noise)
