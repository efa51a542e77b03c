"""Single point positioning, epoch by epoch: iterated weighted least squares, nothing inherited."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators._navigation import fix_prior, linear_update, not_started
from pntegrity.estimators._usual import Usual
from pntegrity.records import Epoch, FloatArray, Prior, State, Update
from pntegrity.sensors.noise import Fitted
from pntegrity.sensors.pseudoranges import Rows, rate_rows


@dataclass(frozen=True)
class Spp(Usual):
    """Snapshot position, a clock a constellation, and velocity from range rates.

    Written as a filter that forgets everything: its prior is wide around the least-squares fix, so every
    epoch is an `Update` like any other. Windowed monitors then see one epoch at a time, tests of the state
    are unavailable. Where groups are excluded, the fix is made anew without them.

    Parameters
    ----------
    options : GnssOptions
    """

    fitted: ClassVar[tuple[Fitted, ...]] = (
        Fitted("code_white_m", 0.005, 30.0, 0.3, "white"),
        Fitted("code_bias_m", 0.01, 20.0, 1.0, "slow"),
        Fitted("doppler_mps", 1e-3, 5.0, 0.03),
        Fitted("glonass_factor", 1.0, 6.0),
        Fitted("bds2_factor", 1.0, 6.0),
    )
    options: GnssOptions = field(default_factory=GnssOptions)

    def predict(self, state: State, epoch: Epoch) -> Prior:
        """Return the wide prior around this epoch's fix; the last position only says where to linearise
        first.
        """
        return self._prior(epoch, state.mean[:3] if len(state) else np.zeros(3), len(state))

    def relax(self, prior: Prior) -> Prior:
        """Return the prior as it is: it says nothing already."""
        return prior

    def correct(self, prior: Prior, epoch: Epoch, exclude: frozenset[str] = frozenset()) -> Update:
        """Use the epoch's rows but for those of the groups in `exclude`."""
        if exclude and len(prior.state):
            prior = self._prior(epoch, prior.state.mean[:3], prior.F.shape[1], exclude)
        if not len(prior.state):
            return not_started(prior)
        code: Rows = prior.context
        rate = rate_rows(epoch, prior.state.mean[:3], prior.state.mean[3:6], self.options)
        noise = self.options.noise
        return linear_update(
            prior,
            code,
            rate,
            noise.snapshot_sigma_m(code.scale, code.slow),
            noise.doppler_mps * rate.scale,
            exclude,
        )

    def _prior(
        self, epoch: Epoch, guess_m: FloatArray, n_old: int, exclude: frozenset[str] = frozenset()
    ) -> Prior:
        plain = replace(self.options.noise, code_bias_m=0.0, code_multipath_m=0.0)
        return fix_prior(epoch, self.options, guess_m, n_old, plain, (), exclude)
