"""The mean of the specific force over windows of time, in axes that gyroscopes keep from turning."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pntegrity.kernels.rotations import rotation

__all__ = ["mean_force"]

FloatArray = npt.NDArray[np.float64]

#: Length of a window, s, and the most windows that are looked at, evenly chosen.
WINDOW_S, MOST_WINDOWS = 10.0, 360


def mean_force(
    dt_s: FloatArray, angle_rad: FloatArray, velocity_mps: FloatArray, factor: float = 1.0
) -> FloatArray:
    """Return the norm of each window's mean specific force, m/s^2, shape (w,).

    It is gravity and the change of the velocity over the length of the window, whatever a vehicle does
    between: a free swing, a curve and a wave have about 9.8 m/s^2, also where the force never leaves an axis
    of the body. Where angles are wrong it is less, since parts of it point against each other.

    Parameters
    ----------
    dt_s : ndarray, shape (n,)
        Durations of the increments of the unit.
    angle_rad, velocity_mps : ndarray, shape (n, 3)
        Increments.
    factor : float
        To the angles; 0 leaves the force in the axes of the body.
    """
    n = max(1, round(WINDOW_S / float(np.median(dt_s)))) if len(dt_s) else 1
    w = len(dt_s) // n
    chosen = np.unique(np.linspace(0, max(w - 1, 0), min(w, MOST_WINDOWS)).astype(np.int64))

    def cut(x: FloatArray) -> FloatArray:
        return x[: w * n].reshape(w, n, *x.shape[1:])[chosen]

    angle, speed = factor * cut(angle_rad), cut(velocity_mps)
    C = np.broadcast_to(np.eye(3), (len(chosen), 3, 3))
    total = np.zeros((len(chosen), 3))
    for j in range(n if len(chosen) else 0):
        total += np.einsum("wij,wj->wi", C, speed[:, j])
        C = C @ rotation(angle[:, j])
    return np.asarray(np.linalg.norm(total, axis=1) / cut(dt_s).sum(axis=1))
