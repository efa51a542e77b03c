"""Rotations: small turns, rotation vectors, and the angles roll, pitch and heading of a vehicle."""

from __future__ import annotations

from math import sin, sqrt

import numpy as np
import numpy.typing as npt
from numba import njit

FloatArray = npt.NDArray[np.float64]

__all__ = ["attitude_angles", "cross", "from_angles", "rotation", "rotvec_of", "skew"]

#: Below this angle, rad, sine and cosine are replaced by their series.
SMALL = 1e-4


def skew(v: npt.ArrayLike) -> FloatArray:
    """Return the matrices (..., 3, 3) of the cross product with vectors (..., 3): ``skew(a) @ b``."""
    v = np.asarray(v, dtype=np.float64)
    if v.ndim == 1:
        return _skew_of(v)
    x, y, z = np.moveaxis(v, -1, 0)
    zero = np.zeros_like(x)
    rows = [np.stack(row, axis=-1) for row in ((zero, -z, y), (z, zero, -x), (-y, x, zero))]
    return np.stack(rows, axis=-2)


def rotation(rotvec: npt.ArrayLike) -> FloatArray:
    """Return the rotations (..., 3, 3) about vectors (..., 3) by their lengths in rad."""
    v = np.asarray(rotvec, dtype=np.float64)
    if v.ndim == 1:
        return _rotation_of(v)
    square = np.sum(v * v, axis=-1)[..., None, None]
    angle = np.sqrt(square)
    small = angle < SMALL
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 1.0 - square / 6.0, np.sin(safe) / safe)
    second = np.where(small, 0.5 - square / 24.0, 2.0 * (np.sin(0.5 * safe) / safe) ** 2)
    K = skew(v)
    return np.asarray(np.eye(3) + first * K + second * (K @ K))


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the cross product of two vectors (3,): `numpy.cross` in a twentieth of its time."""
    return _cross_of(a, b)


@njit(cache=True, nogil=True)
def _cross_of(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


@njit(cache=True, nogil=True)
def _skew_of(v: FloatArray) -> FloatArray:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


@njit(cache=True, nogil=True)
def _rotation_of(v: FloatArray) -> FloatArray:
    square = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    angle = sqrt(square)
    if angle < SMALL:
        first, second = 1.0 - square / 6.0, 0.5 - square / 24.0
    else:
        first, second = sin(angle) / angle, 2.0 * (sin(0.5 * angle) / angle) ** 2
    x, y, z = v[0], v[1], v[2]
    return np.array([
        [1.0 - second * (y * y + z * z), second * x * y - first * z, second * x * z + first * y],
        [second * x * y + first * z, 1.0 - second * (x * x + z * z), second * y * z - first * x],
        [second * x * z - first * y, second * y * z + first * x, 1.0 - second * (x * x + y * y)],
    ])  # fmt: skip


def rotvec_of(C: npt.ArrayLike) -> FloatArray:
    """Return the rotation vectors (..., 3), no longer than pi, of rotations (..., 3, 3).

    By way of the quaternion (Shepperd's choice of the largest component), so it is right near pi too.
    """
    q = _quaternion(np.asarray(C, dtype=np.float64))
    q = np.where(q[..., :1] < 0.0, -q, q)
    length = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    half = np.arctan2(length, q[..., :1])
    factor = np.where(length > 0.0, 2.0 * half / np.where(length > 0.0, length, 1.0), 2.0)
    return np.asarray(factor * q[..., 1:])


def _quaternion(C: FloatArray) -> FloatArray:
    """Return unit quaternions (..., 4), the scalar part first: the row of ``4 q q^T`` with the largest
    diagonal.
    """
    d, trace = np.diagonal(C, axis1=-2, axis2=-1), np.trace(C, axis1=-2, axis2=-1)
    outer = np.empty((*C.shape[:-2], 4, 4))
    outer[..., 0, 0] = 1.0 + trace
    for i, (j, k) in enumerate(((1, 2), (2, 0), (0, 1))):
        outer[..., i + 1, i + 1] = 1.0 + 2.0 * d[..., i] - trace
        outer[..., 0, i + 1] = outer[..., i + 1, 0] = C[..., k, j] - C[..., j, k]
        outer[..., j + 1, k + 1] = outer[..., k + 1, j + 1] = C[..., k, j] + C[..., j, k]
    best = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)[..., None, None]
    q = np.take_along_axis(outer, best, axis=-2)[..., 0, :]
    return np.asarray(q / np.linalg.norm(q, axis=-1, keepdims=True))


def from_angles(angles_rad: npt.ArrayLike) -> FloatArray:
    """Return the matrices (..., 3, 3) that turn body axes (forward, right, down) into east, north, up.

    Parameters
    ----------
    angles_rad : array_like, shape (..., 3)
        Roll (right side down is positive), pitch (nose up is positive), heading (clockwise from north). The
        vehicle is turned by heading, then pitch, then roll, each about its own axis.
    """
    (sr, sp, sh), (cr, cp, ch) = (np.moveaxis(f(np.asarray(angles_rad)), -1, 0) for f in (np.sin, np.cos))
    rows = (
        (cp * sh, sr * sp * sh + cr * ch, cr * sp * sh - sr * ch),
        (cp * ch, sr * sp * ch - cr * sh, cr * sp * ch + sr * sh),
        (sp, -sr * cp, -cr * cp),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def attitude_angles(C: npt.ArrayLike) -> FloatArray:
    """Return roll, pitch and heading (..., 3), rad, of matrices that turn body axes into east, north, up.

    The inverse of `from_angles`: roll within pi, pitch within pi/2, heading from 0 to 2 pi. Of a matrix into
    ECEF first take ``enu_rotation(position) @ C``.
    """
    M = np.asarray(C, dtype=np.float64)
    roll = np.arctan2(-M[..., 2, 1], -M[..., 2, 2])
    pitch = np.arctan2(M[..., 2, 0], np.hypot(M[..., 0, 0], M[..., 1, 0]))
    heading = np.mod(np.arctan2(M[..., 0, 0], M[..., 1, 0]), 2.0 * np.pi)
    return np.stack([roll, pitch, heading], axis=-1)
