"""Single point positioning, epoch by epoch: iterated weighted least squares, nothing inherited."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from pntegrity.estimators._gnss import GnssOptions, Rows, code_rows, rate_rows, snapshot
from pntegrity.estimators.spp_kf import linear_update, no_prior, start_prior
from pntegrity.records import Epoch, Prior, State, Update


@dataclass(frozen=True)
class Spp:
    """Snapshot position, a clock a constellation, and velocity from range rates.

    Written as a filter that forgets everything: its prior is wide around the least-squares fix, so every epoch is an
    `Update` like any other. Windowed monitors then see one epoch at a time, tests of the state are unavailable.

    Parameters
    ----------
    options : GnssOptions
    """

    options: GnssOptions = field(default_factory=GnssOptions)

    def predict(self, state: State, epoch: Epoch) -> Prior:
        """Return the wide prior around this epoch's fix; the last position only says where to linearise first."""
        guess = state.mean[:3] if len(state) else np.zeros(3)
        fix = snapshot(epoch, self.options, guess)
        if fix.reason:
            return no_prior(epoch.t_ns, len(state), (fix.reason,))
        rows = code_rows(epoch, fix.position_m, self.options)
        plain = replace(self.options.noise, code_bias_m=0.0, code_multipath_m=0.0)
        return start_prior(fix, rows, epoch.t_ns, len(state), plain, ())

    def relax(self, prior: Prior) -> Prior:
        """Return the prior as it is: it says nothing already."""
        return prior

    def correct(self, prior: Prior, epoch: Epoch, exclude: frozenset[str] = frozenset()) -> Update:
        """Use the epoch's rows but for those of the groups in `exclude`."""
        if not len(prior.state):
            return Update.of(prior, (), np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0)), reason=prior.events[-1])
        code: Rows = prior.context
        rate = rate_rows(epoch, prior.state.mean[:3], prior.state.mean[3:6], self.options)
        noise = self.options.noise
        return linear_update(
            prior, code, rate, noise.snapshot_sigma_m(code.scale, code.slow), noise.doppler_mps * rate.scale, exclude
        )
