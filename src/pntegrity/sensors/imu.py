"""How large the errors of an inertial measurement unit are."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from pntegrity.records import FloatArray

__all__ = ["LOW_COST", "STIM300", "ImuSpec"]

DEG, HOUR, MILLI_G = np.pi / 180.0, 3600.0, 9.80665e-3


@dataclass(frozen=True)
class ImuSpec:
    """Errors of gyroscopes and accelerometers, the same on all axes.

    A bias is a constant of the size of `gyro_turn_on_radps` or `accel_turn_on_mps2` and a random walk that
    reaches ``sqrt(2)`` times its instability within its correlation time.

    Parameters
    ----------
    gyro_noise_radps_rthz, accel_noise_mps2_rthz : float
        White noise: angle random walk, rad/sqrt(s), and velocity random walk, m/s/sqrt(s).
    gyro_bias_radps, accel_bias_mps2 : float
        Bias instability.
    gyro_tau_s, accel_tau_s : float
        Correlation time of the instability.
    gyro_turn_on_radps, accel_turn_on_mps2 : float
        Bias at the start, standard deviation.
    gyro_scale, accel_scale : float
        Error of the scale factor, standard deviation, 1 = 100 %.
    rate_hz : float
        Samples a second.
    name : str

    Raises
    ------
    ValueError
        Naming the field that is not a number of at least 0.
    """

    gyro_noise_radps_rthz: float
    accel_noise_mps2_rthz: float
    gyro_bias_radps: float
    accel_bias_mps2: float
    gyro_tau_s: float = 1000.0
    accel_tau_s: float = 1000.0
    gyro_turn_on_radps: float = 0.0
    accel_turn_on_mps2: float = 0.0
    gyro_scale: float = 0.0
    accel_scale: float = 0.0
    rate_hz: float = 100.0
    name: str = "custom"

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if f.name != "name" and not (
                isinstance(value, int | float) and np.isfinite(value) and value >= 0.0
            ):
                raise ValueError(
                    f"IMU specification: `{f.name}` must be a number of at least 0, not {value!r}"
                )
        for name in (
            "gyro_noise_radps_rthz",
            "accel_noise_mps2_rthz",
            "gyro_tau_s",
            "accel_tau_s",
            "rate_hz",
        ):
            if getattr(self, name) <= 0.0:
                raise ValueError(f"IMU specification: `{name}` must be above 0, not {getattr(self, name)}")

    def densities(self) -> FloatArray:
        """Return the spectral densities of white noise and of the biases' walks, shape (4,): gyroscope,
        accelerometer, gyroscope bias, accelerometer bias; rad^2/s, m^2/s^3, rad^2/s^3, m^2/s^5.
        """
        return np.array([
            self.gyro_noise_radps_rthz**2, self.accel_noise_mps2_rthz**2,
            2.0 * self.gyro_bias_radps**2 / self.gyro_tau_s, 2.0 * self.accel_bias_mps2**2 / self.accel_tau_s,
        ])  # fmt: skip

    def start_sigma(self) -> FloatArray:
        """Return standard deviations at the start of gyroscope bias, accelerometer bias, gyroscope scale,
        accelerometer scale, three axes each, shape (12,).
        """
        gyro = float(np.hypot(self.gyro_turn_on_radps, self.gyro_bias_radps))
        accel = float(np.hypot(self.accel_turn_on_mps2, self.accel_bias_mps2))
        return np.repeat([gyro, accel, self.gyro_scale, self.accel_scale], 3)


#: A tactical-grade MEMS unit (STIM300 data sheet; published experiment of factor-set detection, table 1).
STIM300 = ImuSpec(
    0.15 * DEG / 60.0, 0.06 / 60.0, 0.5 * DEG / HOUR, 0.05 * MILLI_G,
    gyro_turn_on_radps=10.0 * DEG / HOUR, accel_turn_on_mps2=0.75 * MILLI_G,
    gyro_scale=5e-4, accel_scale=3e-4, rate_hz=125.0, name="STIM300",
)  # fmt: skip

#: A consumer MEMS unit, as on a phone or a hobby board.
LOW_COST = ImuSpec(
    0.6 * DEG / 60.0, 0.2 / 60.0, 20.0 * DEG / HOUR, 0.5 * MILLI_G,
    gyro_turn_on_radps=0.2 * DEG, accel_turn_on_mps2=20.0 * MILLI_G,
    gyro_scale=5e-3, accel_scale=5e-3, rate_hz=100.0, name="low-cost",
)  # fmt: skip
