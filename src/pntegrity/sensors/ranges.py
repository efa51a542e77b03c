"""Satellite ranges and range rates: predicted values and their Jacobians.

Satellite positions are Earth-fixed at emission; the frame turns while the signal travels, which the Sagnac
term takes into account. All vectors are ECEF, metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pntegrity.records import FloatArray

#: Speed of light in vacuum, m/s.
C_MPS = 299_792_458.0
#: Rotation rate of the Earth (WGS 84), rad/s.
EARTH_RATE_RADPS = 7.292_115_146_7e-5


@dataclass(frozen=True, eq=False)
class Geometry:
    """Receiver to satellites: distance with Sagnac term (n,), unit vectors towards the satellites (n, 3)."""

    range_m: FloatArray
    los: FloatArray


def geometry(position_m: FloatArray, sv_pos_m: FloatArray) -> Geometry:
    """Return ranges, the Earth's turn while the signal travels included, and lines of sight.

    Parameters
    ----------
    position_m : ndarray, shape (3,)
        Of the antenna, ECEF.
    sv_pos_m : ndarray, shape (n, 3)
        Of the satellites when they transmitted, ECEF.
    """
    d = sv_pos_m - position_m
    distance = np.sqrt(np.einsum("ij,ij->i", d, d))
    sagnac = EARTH_RATE_RADPS / C_MPS * (sv_pos_m[:, 0] * position_m[1] - sv_pos_m[:, 1] * position_m[0])
    return Geometry(distance + sagnac, d / distance[:, None])


def range_rate(
    velocity_mps: FloatArray, position_m: FloatArray, sv_pos_m: FloatArray, sv_vel_mps: FloatArray,
    los: FloatArray,
) -> FloatArray:  # fmt: skip
    """Return the geometric range rates (n,), m/s, positive when the range grows.

    Parameters
    ----------
    velocity_mps, position_m : ndarray, shape (3,)
        Of the antenna, ECEF.
    sv_pos_m, sv_vel_mps : ndarray, shape (n, 3)
        Of the satellites, ECEF, m and m/s.
    los : ndarray, shape (n, 3)
        Unit vectors to the satellites.
    """
    radial = np.einsum("ij,ij->i", sv_vel_mps - velocity_mps, los)
    sagnac = EARTH_RATE_RADPS / C_MPS * (
        sv_vel_mps[:, 0] * position_m[1] + sv_pos_m[:, 0] * velocity_mps[1]
        - sv_vel_mps[:, 1] * position_m[0] - sv_pos_m[:, 1] * velocity_mps[0]
    )  # fmt: skip
    return np.asarray(radial + sagnac)
