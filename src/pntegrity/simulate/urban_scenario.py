"""What a simulated town is like: streets, tunnels, how many reflections, which seeds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from pntegrity.records import FloatArray
from pntegrity.sensors.noise import NoiseModel

__all__ = ["CHALLENGING", "DENIED", "OPEN", "Section", "UrbanScenario", "mask_rad"]

OPEN, CHALLENGING, DENIED = "open", "challenging", "denied"


@dataclass(frozen=True)
class Section:
    """A stretch of the drive.

    Parameters
    ----------
    kind : str
        ``"open"``, ``"challenging"`` (a street between buildings) or ``"denied"`` (a tunnel: no signals).
    start_s, end_s : float
        Since the first epoch; the end belongs to the next section.
    left_deg, right_deg : float
        Elevation of the roofs, seen at right angles to the street.

    Raises
    ------
    ValueError
        Naming the field.
    """

    kind: str
    start_s: float
    end_s: float
    left_deg: float = 0.0
    right_deg: float = 0.0

    def __post_init__(self) -> None:
        if self.kind not in (OPEN, CHALLENGING, DENIED):
            raise ValueError(f"section: `kind` must be open, challenging or denied, not {self.kind!r}")
        if not self.start_s < self.end_s:
            raise ValueError(f"section: `end_s` {self.end_s} must be after `start_s` {self.start_s}")
        if not (0.0 <= self.left_deg < 90.0 and 0.0 <= self.right_deg < 90.0):
            raise ValueError("section: `left_deg` and `right_deg` must be at least 0 and below 90")


@dataclass(frozen=True)
class UrbanScenario:
    """All that is fixed of a simulation before any method sees it.

    Parameters
    ----------
    sections : tuple of Section
        One after the other, without gaps.
    loads : mapping of str to float
        Share of the satellites of a block that are free of the library's errors, by name of the load.
    reflected : float
        Probability that a satellite behind a building is received all the same, by reflection.
    block_s, stagger_s : float
        Length of blocks, and by how much their ends differ at most from satellite to satellite.
    lever_arm_m : tuple of float
        From the IMU to the antenna; forward, right, down.
    mask_deg : float
        Satellites below are not tracked.
    drift_mps : float
        Of the receiver's clock.
    clock_steps : tuple of (float, int)
        Time in s and milliseconds of the steps of the receiver's clock.
    noise : NoiseModel
        Errors under the open sky.
    rate_hz, imu_rate_hz : float
        Epochs and IMU samples a second.
    systems : str
    tuning, quoted : tuple of int
        Seeds for choosing options, and for figures that are quoted.

    Raises
    ------
    ValueError
        Naming the field.
    """

    sections: tuple[Section, ...]
    loads: Mapping[str, float]
    reflected: float = 0.6
    block_s: float = 30.0
    stagger_s: float = 7.5
    lever_arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    mask_deg: float = 15.0
    drift_mps: float = 60.0
    clock_steps: tuple[tuple[float, int], ...] = ()
    noise: NoiseModel = field(default_factory=NoiseModel)
    rate_hz: float = 1.0
    imu_rate_hz: float = 125.0
    systems: str = "GC"
    tuning: tuple[int, ...] = ()
    quoted: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        ends, starts = [s.end_s for s in self.sections[:-1]], [s.start_s for s in self.sections[1:]]
        if not self.sections or ends != starts:
            raise ValueError("`sections` must follow each other without gaps")
        if set(self.tuning) & set(self.quoted):
            raise ValueError("`tuning` and `quoted` seeds must differ")
        shares = {"reflected": self.reflected, **{f"loads.{k}": v for k, v in self.loads.items()}}
        for name, share in shares.items():
            if not 0.0 <= share <= 1.0:
                raise ValueError(f"`{name}` must be from 0 to 1, not {share}")
        if not 0.0 <= 2.0 * self.stagger_s <= self.block_s:
            raise ValueError("`stagger_s` must be from 0 to half of `block_s`")

    @staticmethod
    def of(table: Mapping[str, Any]) -> UrbanScenario:
        """Return the scenario of a TOML table."""
        fields = dict(table)
        sections = tuple(Section(**s) for s in fields.pop("sections"))
        noise, seeds = NoiseModel(**fields.pop("noise", {})), fields.pop("seeds", {})
        made: dict[str, Any] = {
            k: tuple(tuple(x) if isinstance(x, list) else x for x in v) if isinstance(v, list) else v
            for k, v in (fields | seeds).items()
        }
        return UrbanScenario(sections, noise=noise, **made)

    def section_at(self, t_s: FloatArray) -> npt.NDArray[np.intp]:
        """Return the index of the section at each time, s; the last one beyond the end."""
        starts = [s.start_s for s in self.sections]
        return np.clip(np.searchsorted(starts, t_s, "right") - 1, 0, len(starts) - 1)


def mask_rad(section: Section, relative_rad: npt.ArrayLike) -> FloatArray:
    """Return the elevation of the roofs at azimuths relative to the street, clockwise: an endless row of
    houses of one height on either side.
    """
    across = np.sin(np.asarray(relative_rad, dtype=np.float64))
    side = np.where(across > 0.0, np.deg2rad(section.right_deg), np.deg2rad(section.left_deg))
    return np.asarray(np.arctan(np.tan(side) * np.abs(across)))
