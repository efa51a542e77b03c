"""Kalman PPP-RTK: code and carrier of each band apart, and atmosphere products, with float ambiguities."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar, Literal

from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators._precise_filter import PreciseFilter
from pntegrity.estimators._uncombined import ionosphere_free, uncombined_rows
from pntegrity.estimators._usual import ALWAYS_FITTED, Precise
from pntegrity.sensors.noise import PPP_RTK, Fitted, NoiseModel


@dataclass(frozen=True)
class PppRtk(Precise):
    """PPP with products of the atmosphere, undifferenced and uncombined.

    Each satellite has a slant delay of the ionosphere on its first frequency (a random walk) and an
    ambiguity a band, beside the states of `ppp`: position, white clock, inter-system biases, wet delay. The
    sensor ``"atmosphere"`` measures the zenith delay (``"trop:ZWD"``, ``"trop:ZTD"``) and slant delays
    (``"iono:G05"``), with the standard deviations that it states. Without products this is uncombined PPP.

    Products of the ionosphere hold between satellites only, and a receiver delays its codes: each
    constellation has a white state for what its products share, which is the same as differences with their
    full covariance, whichever satellite they refer to. Errors of products last: each has a Gauss-Markov state
    of its stated standard deviation (``product_tau_s`` 0: white, as in the paper). So do errors of
    code and carrier: where a satellite goes on, their variance grows by `NoiseModel.inflation`.

    Slant delays contain the satellites' code biases where no bias products were given. A satellite that is
    left out loses its products too, and proves itself as under `ppp`; its slant delay keeps its memory.

    Parameters
    ----------
    options : GnssOptions

    References
    ----------
    .. [1] PPP-RTK integrity monitoring with multiple hypothesis solution separation, eqs (1) to (7).
    """

    default_noise: ClassVar[NoiseModel] = PPP_RTK
    monitors: ClassVar[tuple[str, ...]] = ("separation",)
    bands: ClassVar[Literal["one", "combined", "apart"]] = "apart"
    fitted: ClassVar[tuple[Fitted, ...]] = (
        Fitted("carrier_m", 1e-4, 0.1, 1.5e-3, "white", rows="carrier"),
        Fitted("ambiguity_m", 1e-6, 0.01, 1e-4, "slow", rows="carrier"),
        Fitted("code_white_m", 0.02, 30.0, 0.25, "white", rows="code"),
        Fitted("iono_walk_m", 1e-5, 0.1),
        Fitted("zwd_walk_m", 1e-6, 1e-3),
        *ALWAYS_FITTED,
    )
    options: GnssOptions = field(
        default_factory=lambda: GnssOptions(noise=PPP_RTK, max_gap_s=PppRtk.max_gap_s)
    )

    @property
    def _filter(self) -> PreciseFilter:
        return PreciseFilter(self.options, uncombined_rows, ionosphere_free)
