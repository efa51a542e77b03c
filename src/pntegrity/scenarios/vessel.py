"""The vessel to try: the ship of the multi-level study as files, without faults."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pntegrity.physics.tables import SignalTable
from pntegrity.scenarios._vessel_logs import SYSTEMS, Ship, facts, ship, ship_log, sky
from pntegrity.simulate.constellation import navigation_text
from pntegrity.simulate.vessel_files import Sky, write_vessel
from pntegrity.simulate.vessel_log import TRACK_S, VesselLog

__all__ = ["SimulatedVessel", "simulated_vessel"]

#: Probability of a fault of the depth sensor, which the study has not.
P_DEPTH = 1e-5


@dataclass(frozen=True, eq=False)
class SimulatedVessel:
    """A ship, its log, and the signals behind what its satellites say."""

    ship: Ship
    log: VesselLog
    signals: SignalTable
    seed: int

    def write(self, folder: Path) -> Path:
        """Write its files to a folder that exists, and return the description (InputError: it cannot be)."""
        spec, rate = self.ship.spec, self.ship.rate_hz
        text = navigation_text(*self.ship.motion.span_ns, SYSTEMS)
        remark = f"simulated vessel: {len(self.log.epochs)} epochs at {rate:g} Hz, seed {self.seed}"
        return write_vessel(folder, self.log, spec, Sky(self.signals, text), _message(), remark)

    def sensors(self) -> str:
        """Return its sources, each with how many rows it has."""
        rows = {o.sensor: len(o.keys) for o in self.log.epochs[0].observations}
        return ", ".join(f"{s.name} ({rows[s.name]})" for s in self.log.sources)


def simulated_vessel(seconds: float, rate_hz: float, imu_hz: float, seed: int) -> SimulatedVessel:
    """Return a vessel whose epochs span some time; its inertial unit begins some seconds earlier.

    Parameters
    ----------
    seconds : float
    rate_hz, imu_hz : float
        Epochs and increments a second.
    seed : int
        Of all errors.
    """
    made = ship(seconds + TRACK_S, rate_hz, depth=True)
    made = replace(made, spec=replace(made.spec, rate_hz=imu_hz))
    return SimulatedVessel(made, ship_log(made, seed, imu_hz), sky(made, seed)[0], seed)


def _message() -> dict[str, Any]:
    """Return the integrity support message of the study, and of the depth sensor."""
    study = facts()["experiment"]
    return {"p_hmi": study["p_hmi"], "sources": {**study["p_prior"], "depth": P_DEPTH}}
