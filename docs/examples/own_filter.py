"""Watch a Kalman filter that you already have, here filterpy's: two position sensors, one of which drifts."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from filterpy.kalman import KalmanFilter

from pntegrity import Aime, Glr, Update, Verdict, Watch

DT = 1.0


def constant_velocity() -> KalmanFilter:
    """Return a filter of position and velocity along a track, with two position sensors and an odometer."""
    kf = KalmanFilter(dim_x=2, dim_z=3)
    kf.F = np.array([[1.0, DT], [0.0, 1.0]])
    kf.Q = 0.01 * np.array([[DT**3 / 3, DT**2 / 2], [DT**2 / 2, DT]])
    kf.H = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    kf.R = np.diag([0.5, 1.0, 0.1]) ** 2
    kf.P = np.diag([10.0, 2.0]) ** 2
    return kf


def measurements(rng: np.random.Generator, epochs: int = 200, onset: int = 100) -> Iterator[np.ndarray]:
    """Yield what the sensors say; from `onset` on, the first one drifts by 0.1 m/s."""
    position, velocity = 0.0, 5.0
    for k in range(epochs):
        velocity += 0.1 * rng.standard_normal()
        position += velocity * DT
        truth = np.array([position, position, velocity])
        drift = np.array([0.1 * max(k - onset, 0), 0.0, 0.0])
        yield truth + drift + np.array([0.5, 1.0, 0.1]) * rng.standard_normal(3)


def watched(rng: np.random.Generator) -> Iterator[list[Verdict]]:
    """Yield the verdicts of AIME and GLR on every step of the filter."""
    kf, watch = constant_velocity(), Watch([Aime(), Glr()])
    keys = ("gnss:L", "uwb:L", "odometer:D")  # what fails together, and what it measures (D: a rate)
    for k, z in enumerate(measurements(rng)):
        kf.predict()
        P_prior = kf.P.copy()
        kf.update(z)
        yield watch.push(
            Update.from_filter(k * 10**9, F=kf.F, Q=kf.Q, H=kf.H, R=kf.R, P_prior=P_prior, nu=kf.y, keys=keys)
        )


if __name__ == "__main__":
    for k, verdicts in enumerate(watched(np.random.default_rng(1))):
        for v in verdicts:
            if v.status == "alert":
                s = v.suspects[0]
                print(
                    f"{k:3d} s  {v.monitor:5s} {v.statistic:6.1f} > {v.threshold:.1f}  {'+'.join(s.groups)} "
                    f"{s.kind} {s.size:.2f}"
                )
