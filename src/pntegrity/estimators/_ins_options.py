"""What an estimator with an inertial measurement unit needs to know beside the GNSS."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from pntegrity.kernels.factor_set import FactorSet
from pntegrity.sensors.imu import STIM300, ImuSpec

__all__ = ["Coupling", "Detection", "InsOptions"]

Coupling = Literal["tight", "loose"]
Detection = Literal["ours", "factor-set", "lsr", "none"]
#: A lever arm longer than this is a mistake of units or axes, m.
LONGEST_ARM_M = 50.0


@dataclass(frozen=True)
class InsOptions:
    """Everything about the inertial side of a fusion.

    Parameters
    ----------
    spec : ImuSpec
    lever_arm_m : tuple of float
        From the IMU to the antenna; forward, right, down.
    coupling : str
        ``"tight"``: pseudoranges and Doppler are rows of the filter; ``"loose"``: a least-squares fix is.
    fde : str
        Fault detection before the update: ``"ours"``, ``"factor-set"``, ``"lsr"`` or ``"none"``.
    factors : FactorSet
    heading_rad : float, optional
        Heading at the first epoch, clockwise from north; None: from the course, once there is one.
    zero_velocity : bool
        Whether a standstill that the IMU shows is used as a measurement.
    scale_factors : bool
        Whether scale factors are states: 21 states of the INS instead of 15.
    limit_sigma : float
        The tight filter's own detection leaves out a row that is further off than so many of its standard
        deviations.
    lost_s : float
        Where most pseudoranges have been left out for so long, position and velocity are taken for lost and
        start anew.

    Raises
    ------
    ValueError
        Naming the field and what is wrong.
    """

    spec: ImuSpec = STIM300
    lever_arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    coupling: Coupling = "tight"
    fde: Detection = "ours"
    factors: FactorSet = field(default_factory=FactorSet)
    heading_rad: float | None = None
    zero_velocity: bool = False
    scale_factors: bool = True
    limit_sigma: float = 3.3
    lost_s: float = 20.0

    def __post_init__(self) -> None:
        arm = np.asarray(self.lever_arm_m, dtype=np.float64)
        if arm.shape != (3,) or not np.isfinite(arm).all():
            raise ValueError(f"lever arm {self.lever_arm_m!r} is not three numbers forward, right, down in m")
        if float(np.linalg.norm(arm)) > LONGEST_ARM_M:
            raise ValueError(
                f"a lever arm of {float(np.linalg.norm(arm)):.0f} m is implausible: give it in metres, "
                "forward, right, down"
            )
        for name in ("limit_sigma", "lost_s"):
            value = getattr(self, name)
            if not (isinstance(value, int | float) and np.isfinite(value) and value > 0.0):
                raise ValueError(f"`{name}` must be a number above 0, not {value!r}")
        if self.heading_rad is not None and not np.isfinite(self.heading_rad):
            raise ValueError(f"`heading_rad` must be an angle or None, not {self.heading_rad!r}")
        if self.coupling == "tight" and self.fde in ("factor-set", "lsr"):
            raise ValueError(f"`fde` {self.fde} works on fixes: it goes with loose coupling, not tight")
