"""What lies between a satellite's centre of mass and a marker beside geometry, clocks and troposphere.

All of it depends so little on where the receiver is that a position good to a kilometre gives it to 0.1 mm:
antenna offsets and variations of both ends, tides, wind-up, the relativistic path delay. It is computed once
for all rows, before any filter runs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from pntegrity.physics._rows import rows_by_kind
from pntegrity.physics.attitude import body_axes, sun_directions, wind_up_cycles
from pntegrity.physics.frames import enu_rotations
from pntegrity.physics.products import OceanLoading, PolarMotion, ReceiverAntenna, SatelliteAntenna
from pntegrity.physics.signals import SPEED_OF_LIGHT_MPS
from pntegrity.physics.tides import displacements_m
from pntegrity.records import FloatArray

__all__ = ["Antennas", "Corrections", "Site", "Sky", "corrections_m", "sky_of"]

Antennas = Callable[[str, int], SatelliteAntenna | None]

GM_M3PS2 = 3.986004418e14
"""Gravitational constant of the Earth."""


@dataclass(frozen=True, eq=False)
class Site:
    """What is known of the antenna and its marker.

    Parameters
    ----------
    track_m : ndarray, shape (n_epochs, 3)
        Where the receiver is at each epoch, good to a kilometre.
    antenna_delta_hen_m : ndarray, shape (3,)
        Antenna reference point above the marker: up, east, north.
    antenna : ReceiverAntenna or None
    ocean : OceanLoading or None
    pole : PolarMotion or None
        Without it no pole tide.
    tides : bool
        Whether the marker moves with the solid Earth.
    """

    track_m: FloatArray
    antenna_delta_hen_m: FloatArray = field(default_factory=lambda: np.zeros(3))
    antenna: ReceiverAntenna | None = None
    ocean: OceanLoading | None = None
    pole: PolarMotion | None = None
    tides: bool = True


@dataclass(frozen=True, eq=False)
class Sky:
    """Rows as seen from the receiver, sorted by satellite and time; shapes (n,) or (n, 3).

    `offset_m` is where the antenna reference point is beside the marker (tides, antenna height), Earth-fixed.
    """

    epoch: npt.NDArray[np.int64]
    satellite: npt.NDArray[np.int64]
    names: tuple[str, ...]
    t_ns: npt.NDArray[np.int64]
    los: FloatArray
    axes: tuple[FloatArray, FloatArray, FloatArray]
    rotation: FloatArray
    el_rad: FloatArray
    az_rad: FloatArray
    offset_m: FloatArray
    shapiro_m: FloatArray
    wind_up_cycles: FloatArray


@dataclass(frozen=True, eq=False)
class Corrections:
    """To be added to predicted code and carrier of one band, m, shapes (n,)."""

    code_m: FloatArray
    carrier_m: FloatArray
    notes: tuple[str, ...] = ()


def sky_of(
    t_ns: npt.NDArray[np.int64], epoch: npt.NDArray[np.int64], sats: npt.NDArray[np.str_],
    position_m: FloatArray, site: Site,
) -> Sky:  # fmt: skip
    """Return what all bands share of rows sorted by satellite and time.

    Parameters
    ----------
    t_ns : ndarray of int64, shape (n_epochs,)
    epoch : ndarray, shape (n,)
        Index into `t_ns`.
    sats : ndarray of str, shape (n,)
    position_m : ndarray, shape (n, 3)
        Centres of mass of the satellites.
    site : Site
    """
    names, satellite = np.unique(sats, return_inverse=True)
    receiver = site.track_m[epoch]
    d = position_m - receiver
    distance = np.linalg.norm(d, axis=1)
    los = d / distance[:, None]
    turn = enu_rotations(site.track_m)
    rotation = turn[epoch]
    east, north, up = np.einsum("nij,nj->in", rotation, los)
    axes = body_axes(position_m, sun_directions(t_ns)[epoch])
    mount = np.einsum("nji,j->ni", turn, site.antenna_delta_hen_m[[1, 2, 0]])
    moved = displacements_m(t_ns, site.track_m, ocean=site.ocean, pole=site.pole, solid=site.tides)
    return Sky(
        epoch, satellite, tuple(names.tolist()), t_ns[epoch], los, axes, rotation,
        np.arcsin(np.clip(up, -1.0, 1.0)), np.mod(np.arctan2(east, north), 2.0 * np.pi),
        (moved + mount)[epoch], _shapiro_m(position_m, receiver, distance),
        wind_up_cycles(satellite, axes, los, rotation[:, 1], -rotation[:, 0]),
    )  # fmt: skip


def _shapiro_m(position_m: FloatArray, receiver_m: FloatArray, distance_m: FloatArray) -> FloatArray:
    """Return the relativistic path delay, m (IERS Conventions 2010, 11.17, the Earth's part)."""
    radii = np.linalg.norm(position_m, axis=1) + np.linalg.norm(receiver_m, axis=1)
    bend = np.log((radii + distance_m) / (radii - distance_m))
    return np.asarray(2.0 * GM_M3PS2 / SPEED_OF_LIGHT_MPS**2 * bend)


def corrections_m(
    sky: Sky,
    band: npt.NDArray[np.str_],
    wavelength_m: FloatArray,
    site: Site,
    antennas: Antennas | None = None,
) -> Corrections:
    """Return the corrections of one band (or of rows that each have their own).

    Parameters
    ----------
    sky : Sky
    band : ndarray of str, shape (n,)
        RINEX band of each row, ``"1"``.
    wavelength_m : ndarray, shape (n,)
    site : Site
    antennas : callable, optional
        Gives the antenna of a satellite at a time, None where there is none. Without it positions are taken
        for those of the phase centres.
    """
    code = sky.shapiro_m - _along(sky.offset_m, sky.los)
    notes: list[str] = []
    if antennas is not None:
        code = code + _satellite_antennas_m(sky, band, antennas, notes)
    if site.antenna is not None:
        code = code + _receiver_antenna_m(sky, band, site.antenna, notes)
    return Corrections(code, code + wavelength_m * sky.wind_up_cycles, tuple(dict.fromkeys(notes)))


def _along(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("ij,ij->i", a, b))


def _satellite_antennas_m(
    sky: Sky, band: npt.NDArray[np.str_], antennas: Antennas, notes: list[str]
) -> FloatArray:
    """Return what the satellites' phase centres add to a range: offset along the line of sight, variation."""
    out = np.zeros(len(sky.t_ns))
    body = np.stack([_along(axis, sky.los) for axis in sky.axes], axis=1)
    nadir = np.arccos(np.clip(-body[:, 2], -1.0, 1.0))
    for rows, sat, name in _each(sky, band):
        antenna = antennas(sat, int(sky.t_ns[rows[0]])) if name else None
        if antenna is None:
            notes += [f"{sat}: no satellite antenna, its phase centre may be 1 to 3 m off"] if name else []
            continue
        taken, note = antenna.calibrated_band(name)
        notes += [note] if note else []
        out[rows] = body[rows] @ antenna.pco_m[taken] + antenna.pcv_m(name, nadir[rows])
    return out


def _receiver_antenna_m(
    sky: Sky, band: npt.NDArray[np.str_], antenna: ReceiverAntenna, notes: list[str]
) -> FloatArray:
    out = np.zeros(len(sky.t_ns))
    local = np.stack([_along(sky.rotation[:, i], sky.los) for i in (1, 0, 2)], axis=1)  # north, east, up
    for rows, sat, name in _each(sky, band):
        zenith, azimuth = 0.5 * np.pi - sky.el_rad[rows], sky.az_rad[rows]
        taken, note = antenna.calibrated_band(sat[0], name)
        notes += [note] if note else []
        out[rows] = antenna.pcv_m(sat[0], name, zenith, azimuth) - local[rows] @ antenna.pco_neu_m[taken]
    return out


def _each(sky: Sky, band: npt.NDArray[np.str_]) -> list[tuple[npt.NDArray[np.intp], str, str]]:
    """Return the rows of each satellite and band."""
    kinds = np.char.add(np.array(sky.names)[sky.satellite], band)
    return [(rows, kind[:3], kind[3:]) for kind, rows in rows_by_kind(kinds)]
