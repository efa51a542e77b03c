"""The vessel of the multi-level study as a log: real source types, mechanised INS, satellites in the sky."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from typing import Any

import numpy as np

from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators._ins_options import InsOptions
from pntegrity.estimators.multi_source import MultiSource
from pntegrity.physics.frames import enu_rotation
from pntegrity.physics.tables import Navigation, SignalTable
from pntegrity.records import FloatArray, Observation
from pntegrity.satellite_source import merged
from pntegrity.sensors.depth import Depth
from pntegrity.sensors.gnss import Gnss
from pntegrity.sensors.imu import ImuSpec
from pntegrity.sensors.lbl import Lbl
from pntegrity.sensors.noise import NoiseModel
from pntegrity.sensors.source import Source
from pntegrity.sensors.usbl import Usbl
from pntegrity.simulate.constellation import KLOBUCHAR, nominal_navigation
from pntegrity.simulate.motion import Motion
from pntegrity.simulate.receiver import Receiver, epochs_of, simulate
from pntegrity.simulate.vessel_log import Fault, VesselLog, cruise, vessel_log

__all__ = ["START_NS", "Ship", "estimator", "facts", "fault_of", "ship", "ship_log", "sky"]

START_NS = 1_400_000_000_000_000_000
SYSTEMS, SATELLITES, MASK_DEG = "GE", 12, 12.0
DEG, HOUR = np.pi / 180.0, 3600.0


def facts() -> dict[str, Any]:
    """Return the tables of ``multi_level.toml``."""
    text = (files("pntegrity.scenarios") / "multi_level.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


@dataclass(frozen=True, eq=False)
class Ship:
    """A motion, and the sources on board with their rows; `sky`: what the satellites say, by time."""

    motion: Motion
    sources: Mapping[Source, tuple[str, ...]]
    gnss: Gnss
    spec: ImuSpec
    rate_hz: float

    def all(self) -> tuple[Source, ...]:
        """Return all sources."""
        return (self.gnss, *self.sources)


def ship(seconds: float, rate_hz: float = 2.0, *, depth: bool = False) -> Ship:
    """Return the ship of the study with its consistent noise: satellites, four beacons, a transponder.

    Parameters
    ----------
    seconds : float
    rate_hz : float
        Epochs a second.
    depth : bool
        Whether it has a pressure sensor as a fourth source.
    """
    study = facts()
    noise, geometry, p = study["noise"]["consistent"], study["geometry"], study["ins"]
    motion = cruise(START_NS, max(seconds, 60.0), speed_mps=geometry["speed_mps"])
    place = _places(motion, np.array(geometry["start_ned_m"]))
    names = [f"AP{i + 1}" for i in range(len(geometry["beacons_ned_m"]))]
    beacons = {n: place(np.array(b)) for n, b in zip(names, geometry["beacons_ned_m"], strict=True)}
    at_50 = _ned_of(motion, START_NS + 50_000_000_000) + geometry["start_ned_m"]
    lbl = Lbl(beacons=beacons, sigma_s=noise["lbl_time_s"])
    usbl = Usbl(
        transponder=place(at_50 + geometry["transponder_from_ship_ned_m"]), sigma_s=noise["usbl_time_s"],
        sigma_angle_deg=noise["usbl_angle_deg"],
    )  # fmt: skip
    sources: dict[Source, tuple[str, ...]] = {
        lbl: tuple(f"lbl:R.{n}" for n in names), usbl: ("usbl:R.time", "usbl:A.bearing", "usbl:A.elevation"),
    }  # fmt: skip
    if depth:
        sources[Depth(sigma_m=0.3)] = ("depth:R.z",)
    gnss = Gnss(
        mask_deg=MASK_DEG, doppler=False, sigma_m=noise["pseudorange_m"], slow_sigma_m=0.0, cn0_ref_dbhz=0.0,
        klobuchar=KLOBUCHAR,
    )  # fmt: skip
    return Ship(motion, sources, gnss, _spec(p), rate_hz)


def _spec(p: Mapping[str, float]) -> ImuSpec:
    return ImuSpec(
        p["gyro_random_walk_deg_sqrt_h"] * DEG / 60.0, p["accel_random_walk_mps_sqrt_s"],
        p["gyro_bias_walk_deg_h_sqrt_h"] * DEG / HOUR / np.sqrt(2.0),
        p["accel_bias_walk_mps2_sqrt_h"] / np.sqrt(2.0), HOUR, HOUR,
        gyro_turn_on_radps=p["gyro_bias_deg_h"] * DEG / HOUR, accel_turn_on_mps2=p["accel_bias_mps2"],
        name="multi-level study",
    )  # fmt: skip


def _ned_of(motion: Motion, t_ns: int) -> FloatArray:
    """Return where the ship is, north, east, down of its start."""
    start, there = motion.at([motion.span_ns[0], t_ns])[0]
    east, north, up = enu_rotation(start) @ (there - start)
    return np.array([north, east, -up])


def _places(motion: Motion, start_ned_m: FloatArray) -> Any:
    """Return what makes the table of a beacon of its place, north, east, down of the middle."""
    origin = motion.at([motion.span_ns[0]])[0][0]
    turn = enu_rotation(origin).T

    def place(ned_m: FloatArray) -> dict[str, float]:
        north, east, down = ned_m - start_ned_m
        x = origin + turn @ np.array([east, north, -down])
        return {"x_m": float(x[0]), "y_m": float(x[1]), "z_m": float(x[2])}

    return place


def ship_log(vessel: Ship, seed: int, imu_hz: float = 100.0) -> VesselLog:
    """Return a log of the ship without faults."""
    rest = np.random.default_rng([seed, 2])
    log = vessel_log(
        vessel.motion, vessel.sources, rest, spec=vessel.spec, imu_hz=imu_hz, rate_hz=vessel.rate_hz,
        besides=_said(vessel, seed),
    )  # fmt: skip
    return replace(log, sources=vessel.all())


def sky(vessel: Ship, seed: int) -> tuple[SignalTable, Navigation]:
    """Return what the receiver tracks, white noise of its own size, and the ephemerides."""
    first, last = vessel.motion.span_ns
    t_ns = first + np.round(np.arange(0.0, (last - first) * 1e-9, 1.0 / vessel.rate_hz) * 1e9).astype(
        np.int64
    )
    nav = nominal_navigation(first, last, SYSTEMS)
    noise = NoiseModel(
        code_white_m=vessel.gnss.sigma_m, code_multipath_m=0.0, code_bias_m=0.0, cn0_ref_dbhz=0.0,
        elevation_power=0.0,
    )  # fmt: skip

    def way(t_s: float) -> tuple[FloatArray, FloatArray]:
        position, velocity, _ = vessel.motion.at([min(max(first + round(t_s * 1e9), first), last)])
        return position[0], velocity[0]

    receiver = Receiver(noise, mask_rad=np.radians(MASK_DEG + 3.0))
    return simulate(nav, way, t_ns, receiver, np.random.default_rng([seed, 1])).table, nav


def _said(vessel: Ship, seed: int) -> dict[int, Observation]:
    """Return what the satellites that are always there say, by time."""
    epochs = epochs_of(*sky(vessel, seed))
    found = {e.t_ns: merged(e, vessel.gnss.name) for e in epochs}
    always = set.intersection(*(set(o.keys) for o in found.values()))
    kept = sorted(k for k in always if ":R." in k)[:SATELLITES]
    return {t: o.select(np.array([k in kept for k in o.keys])) for t, o in found.items()}


def estimator(log: VesselLog, spec: ImuSpec) -> MultiSource:
    """Return the estimator of a log, its heading known to some degrees at the first epoch."""
    position, _, C = log.motion.at([log.epochs[0].t_ns])
    east, north, _ = enu_rotation(position[0]) @ C[0][:, 0]
    ins = InsOptions(spec=spec, heading_rad=float(np.arctan2(east, north)), scale_factors=False)
    return MultiSource(GnssOptions(ins=ins, sources=log.sources))


def fault_of(case: Mapping[str, Any], satellites: Sequence[str]) -> tuple[Fault, ...]:
    """Return a case of the study as faults of a log, at its consistent size.

    Parameters
    ----------
    case : mapping
        Of ``multi_level.toml``.
    satellites : sequence of str
        Rows that stand for the satellites of the study: its second is the second of them.
    """
    scale = DEG if case["unit"] == "deg" else 1.0
    size = case["consistent"] * scale
    jump, rate = (size, 0.0) if case["kind"] == "bias" else (0.0, size)
    return tuple((_row(r, satellites), jump, rate, *case["from_to_s"]) for r in case["rows"])


def _row(key: str, satellites: Sequence[str]) -> str:
    if key.startswith("gnss:R.G"):
        return satellites[int(key[-2:]) - 1]
    return "usbl:R.time" if key == "usbl:R.range" else key
