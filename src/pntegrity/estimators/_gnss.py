"""What the GNSS estimators need to know."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from pntegrity.estimators._ins_options import InsOptions
from pntegrity.physics.tables import Klobuchar
from pntegrity.sensors.noise import NoiseModel
from pntegrity.sensors.source import Source

__all__ = ["GnssOptions"]


@dataclass(frozen=True)
class GnssOptions:
    """What the GNSS estimators need to know.

    Parameters
    ----------
    noise : NoiseModel
    mask_rad : float
        Elevation mask.
    klobuchar : Klobuchar, optional
        Broadcast ionosphere coefficients, as `formats` gives them; None: no ionosphere model.
    doppler : bool
        Whether range rates are used.
    max_gap_s : float
        After a longer gap the filter starts anew.
    motion : str
        What a precise filter knows of the receiver's motion: ``"white"`` (nothing), ``"walk"``,
        ``"velocity"`` or ``"static"``.
    ins : InsOptions
        The inertial side, where there is one.
    sources : tuple of Source
        What ``multi_source`` has beside the IMU.
    """

    noise: NoiseModel = field(default_factory=NoiseModel)
    mask_rad: float = float(np.deg2rad(10.0))
    klobuchar: Klobuchar | None = None
    doppler: bool = True
    max_gap_s: float = 120.0
    motion: Literal["white", "walk", "velocity", "static"] = "white"
    ins: InsOptions = field(default_factory=InsOptions)
    sources: tuple[Source, ...] = ()
