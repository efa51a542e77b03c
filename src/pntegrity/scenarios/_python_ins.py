"""python-ins (module ``pyins``), an independent library, on the increments and fixes of our epochs."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from typing import Any

import numpy as np

from pntegrity.estimators._ins_solution import solution_of
from pntegrity.physics.frames import ecef_to_geodetic, enu_rotation, geodetic_to_ecef
from pntegrity.physics.time import SECOND_NS
from pntegrity.records import Epoch, FloatArray, State
from pntegrity.sensors.imu import ImuSpec

__all__ = ["MISSING", "Filtered", "available", "increments_of", "pva_of"]

MISSING = "python-ins is not installed"
NAMES = ("dt", "theta_x", "theta_y", "theta_z", "dv_x", "dv_y", "dv_z")


def available() -> bool:
    """Tell whether the library is installed."""
    return find_spec("pyins") is not None


def increments_of(epochs: Sequence[Epoch]) -> Any:
    """Return the increments of epochs as its table, indexed by seconds since the first epoch."""
    import pandas as pd

    units = [e.imu for e in epochs if e.imu is not None]
    t_ns = np.concatenate([u.t_ns for u in units])
    values = [np.column_stack([u.dt_s, u.angle_rad, u.velocity_mps]) for u in units]
    index = pd.Index((t_ns - epochs[0].t_ns) / SECOND_NS, name="time")
    return pd.DataFrame(np.concatenate(values), index=index, columns=list(NAMES))


def pva_of(state: State, seconds: float) -> Any:
    """Return position, velocity and attitude of one of our states as its series."""
    import pandas as pd

    solution = solution_of(state)
    assert solution is not None
    place = state.block("pos")[0]
    lat, lon, height = ecef_to_geodetic(place)
    e, n, u = enu_rotation(place) @ state.block("vel")[0]
    roll, pitch, heading = np.degrees(solution.attitude_rad)
    known = {
        "lat": np.degrees(lat), "lon": np.degrees(lon), "alt": height, "VN": n, "VE": e, "VD": -u,
        "roll": roll, "pitch": pitch, "heading": heading,
    }  # fmt: skip
    return pd.Series(known, name=seconds)


class Filtered:
    """Its feedback filter over all fixes, started where ours did; outages go on from its states.

    Parameters
    ----------
    epochs : sequence of Epoch
        With fixes of position and velocity.
    first : int
        Where it starts.
    state : State
        Ours there.
    spec : ImuSpec
    sigma_m, sigma_mps : float
        Of the fixes: it takes one number.
    arm_m : ndarray, shape (3,)
    """

    def __init__(
        self, epochs: Sequence[Epoch], first: int, state: State, spec: ImuSpec, sigma_m: float,
        sigma_mps: float, arm_m: FloatArray,
    ) -> None:  # fmt: skip
        from pyins import filters, measurements

        self.seconds = np.array([(e.t_ns - epochs[0].t_ns) / SECOND_NS for e in epochs])
        whole = increments_of(epochs)
        begin = float(self.seconds[first])
        self.increments = whole[whole.index > begin + 1e-6]
        place, speed = _tables(epochs[first + 1 :], self.seconds[first + 1 :])
        found = filters.run_feedback_filter(
            pva_of(state, begin), 0.05, 0.1, 3.0, 6.0, self.increments, *_models(spec),
            [measurements.Position(place, sigma_m, arm_m), measurements.NedVelocity(speed, sigma_mps, arm_m)],
            time_step=0.25,
        )  # fmt: skip
        self.track, self.gyro, self.accel = found.trajectory, found.gyro, found.accel
        self.arm_m = arm_m

    def bridge(self, begin_s: float, end_s: float, fix_m: FloatArray) -> FloatArray:
        """Return the difference from a fix at the end of an outage, east, north, up."""
        from pyins import strapdown, transform

        i = int(self.track.index.searchsorted(begin_s + 1e-6)) - 1
        rows = self.increments[
            (self.increments.index > begin_s + 1e-6) & (self.increments.index < end_s + 1e-6)
        ]
        rows = _corrected(
            rows, self.gyro.iloc[_at(self.gyro, begin_s)], self.accel.iloc[_at(self.accel, begin_s)]
        )
        free = strapdown.Integrator(self.track.iloc[i])
        free.integrate(rows)
        last = free.trajectory.iloc[-1]
        unit = np.array(geodetic_to_ecef(np.deg2rad(last.lat), np.deg2rad(last.lon), last.alt))
        turn = enu_rotation(unit)
        ned = transform.mat_from_rph(last[["roll", "pitch", "heading"]]) @ self.arm_m
        return np.asarray(turn @ (unit - fix_m) + np.array([ned[1], ned[0], -ned[2]]))


def _at(table: Any, seconds: float) -> int:
    return max(int(table.index.searchsorted(seconds + 1e-6)) - 1, 0)


def _models(spec: ImuSpec) -> tuple[Any, Any]:
    from pyins.inertial_sensor import EstimationModel

    walk, start = np.sqrt(spec.densities()[2:]), spec.start_sigma()
    return (
        EstimationModel(start[0], spec.gyro_noise_radps_rthz, walk[0], np.eye(3) * spec.gyro_scale),
        EstimationModel(start[3], spec.accel_noise_mps2_rthz, walk[1], np.eye(3) * spec.accel_scale),
    )


def _tables(epochs: Sequence[Epoch], seconds: FloatArray) -> tuple[Any, Any]:
    """Return fixes as its tables of geodetic positions and of velocities north, east, down."""
    import pandas as pd

    fixes = [e.observations[0].y for e in epochs]
    full = [(s, y) for s, y in zip(seconds.tolist(), fixes, strict=True) if len(y) == 6]
    index = pd.Index([s for s, _ in full], name="time")
    lla = np.array([ecef_to_geodetic(y[:3]) for _, y in full])
    place = np.column_stack([np.degrees(lla[:, :2]), lla[:, 2]])
    enu = np.array([enu_rotation(y[:3]) @ y[3:] for _, y in full])
    speed = np.column_stack([enu[:, 1], enu[:, 0], -enu[:, 2]])
    return (
        pd.DataFrame(place, index=index, columns=["lat", "lon", "alt"]),
        pd.DataFrame(speed, index=index, columns=["VN", "VE", "VD"]),
    )


def _corrected(rows: Any, gyro: Any, accel: Any) -> Any:
    """Return increments without the errors that it estimated."""
    out = rows.copy()
    for names, model in ((NAMES[1:4], gyro), (NAMES[4:], accel)):
        for name in names:
            axis = name[-1]
            out[name] = (rows[name] - model[f"bias_{axis}"] * rows["dt"]) / (1.0 + model[f"sm_{axis}{axis}"])
    return out
