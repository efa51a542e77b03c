"""Kalman precise point positioning with float ambiguities."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar, Literal

from pntegrity.estimators._carrier import precise_rows
from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators._precise_filter import PreciseFilter
from pntegrity.estimators._usual import ALWAYS_FITTED, Precise
from pntegrity.sensors.noise import PPP, Fitted, NoiseModel


@dataclass(frozen=True)
class Ppp(Precise):
    """Precise point positioning: code and carrier, receiver clock, wet delay, one ambiguity an arc.

    The position is white noise, a random walk, constant velocity with white acceleration, or static
    (`GnssOptions.motion`). The clock is white: its mean is taken from the epoch's code, so is that of a
    constellation seen first and that of an ambiguity born; each counts as consumed. Further constellations
    have an inter-system bias. The wet delay and its gradients walk; ambiguities walk a little, which carries
    the slow errors of orbits, clocks and multipath; satellites have a code bias each, which those of GLONASS
    keep. An arc that ends takes its ambiguity with it.

    Rows are ionosphere-free pairs where the epochs hold them. The ambiguity of a satellite that is left out
    is made of its own carrier at the epoch of its exclusion (its name then ends with ``~``), and lives on:
    its carrier shows what came after, to centimetres, and needs no other reset.

    Parameters
    ----------
    options : GnssOptions
    """

    default_noise: ClassVar[NoiseModel] = PPP
    bands: ClassVar[Literal["one", "combined", "apart"]] = "combined"
    fitted: ClassVar[tuple[Fitted, ...]] = (
        Fitted("carrier_m", 1e-4, 0.1, 1.5e-3, "white", rows="carrier"),
        Fitted("ambiguity_m", 1e-6, 0.01, 2e-4, "slow", rows="carrier"),
        Fitted("code_white_m", 0.02, 30.0, 0.25, "white", rows="code"),
        Fitted("code_bias_m", 0.02, 20.0, 0.3, "slow", rows="code"),
        Fitted("code_bias_tau_s", 60.0, 86400.0, 600.0, size="code_bias_m"),
        Fitted("zwd_walk_m", 1e-6, 1e-3),
        *ALWAYS_FITTED,
    )
    options: GnssOptions = field(default_factory=lambda: GnssOptions(noise=PPP, max_gap_s=Ppp.max_gap_s))

    @property
    def _filter(self) -> PreciseFilter:
        return PreciseFilter(self.options, precise_rows)
