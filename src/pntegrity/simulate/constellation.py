"""Nominal constellations as broadcast ephemerides: written as RINEX, read back, used like any file's.

Walker patterns of the systems' design with Kepler orbits (GLONASS: the state vector of one at each reference
time), small clock errors and group delays. They look like the real sky, but are nobody's real satellites.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pntegrity.formats.rinex_nav import read_navigation
from pntegrity.physics.tables import Klobuchar, Navigation
from pntegrity.physics.time import BDT_OFFSET_NS, BDT_WEEK, SECOND_NS, leap_seconds, to_iso, to_week_tow
from pntegrity.records import FloatArray

__all__ = ["KLOBUCHAR", "NOMINAL", "Walker", "navigation_text", "nominal_navigation"]

MU = {"G": 3.986005e14, "E": 3.986004418e14, "C": 3.986004418e14, "R": 3.9860044e14}
EARTH_RATE = 7.2921151467e-5
#: Drift of the nodes, rad/s: what J2 makes of these orbits, within a tenth.
NODE_RATE = -8.0e-9
#: Where longitudes and phases are counted from, ns: 2020-01-01 GPS time.
REFERENCE_NS = 1_261_872_000 * SECOND_NS

#: Coefficients of a quiet day.
KLOBUCHAR = Klobuchar((1.1176e-8, 7.4506e-9, -5.9605e-8, -5.9605e-8), (9.0112e4, 0.0, -1.9661e5, -6.5536e4))


@dataclass(frozen=True)
class Walker:
    """A pattern of satellites: `count` in `planes` planes, spread evenly over the nodes and within a plane.

    Parameters
    ----------
    count, planes, phasing : int
        Of the Walker delta pattern; where `planes` does not divide `count`, some planes hold one more.
    semi_major_m : float
    inclination_rad : float
    first : int
        Number of the first satellite.
    interval_s : int
        Time between ephemerides.
    eccentricity : float
    """

    count: int
    planes: int
    phasing: int
    semi_major_m: float
    inclination_rad: float
    first: int = 1
    interval_s: int = 3600
    eccentricity: float = 0.004


NOMINAL: Mapping[str, Walker] = {
    "G": Walker(27, 6, 2, 26_559_800.0, np.deg2rad(55.0), interval_s=7200),
    "E": Walker(24, 3, 1, 29_600_318.0, np.deg2rad(56.0), eccentricity=0.0002),
    "C": Walker(24, 3, 1, 27_906_100.0, np.deg2rad(55.0), first=19, eccentricity=0.0005),
    "R": Walker(24, 3, 1, 25_508_000.0, np.deg2rad(64.8), interval_s=1800, eccentricity=0.001),
}


def nominal_navigation(start_ns: int, end_ns: int, systems: str = "GE") -> Navigation:
    """Return the ephemerides of nominal constellations over an interval, as read from a RINEX file of them.

    Parameters
    ----------
    start_ns, end_ns : int
        GPS time.
    systems : str
        Letters of G, E, C (medium orbits) and R.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "nominal.rnx"
        path.write_text(navigation_text(start_ns, end_ns, systems), encoding="ascii")
        return read_navigation(path)


def navigation_text(start_ns: int, end_ns: int, systems: str = "GE") -> str:
    """Return the RINEX 3.04 navigation file of nominal constellations over an interval."""
    if not systems or any(s not in NOMINAL for s in systems):
        raise ValueError(f"`systems` must be letters of {''.join(NOMINAL)}, not {systems!r}")
    if end_ns < start_ns:
        raise ValueError("`end_ns` must not be before `start_ns`")
    lines = [_label(f"{3.04:9.2f}{'':11}{'N: GNSS NAV DATA':<20}{'M: MIXED':<20}", "RINEX VERSION / TYPE")]
    lines.append(_label(f"{'pntegrity simulator':<40}", "PGM / RUN BY / DATE"))
    for name, values in (("GPSA", KLOBUCHAR.alpha), ("GPSB", KLOBUCHAR.beta)):
        lines.append(_label(f"{name} " + "".join(f"{v:12.4E}" for v in values), "IONOSPHERIC CORR"))
    lines.append(_label(f"{_leap_s(start_ns):6d}", "LEAP SECONDS"))
    lines.append(_label("", "END OF HEADER"))
    for system in systems:
        write = _state_vector if system == "R" else _kepler
        for toe_ns in _reference_times(start_ns, end_ns, NOMINAL[system].interval_s):
            for i in range(NOMINAL[system].count):
                lines += write(system, i, toe_ns)
    return "\n".join(lines) + "\n"


def _label(text: str, label: str) -> str:
    return f"{text:<60}{label}"


def _leap_s(t_ns: int) -> int:
    year, month, day = (int(p) for p in to_iso(t_ns)[:10].split("-"))
    return leap_seconds(year, month, day)


def _reference_times(start_ns: int, end_ns: int, interval_s: int) -> Iterator[int]:
    step = interval_s * SECOND_NS
    for k in range(start_ns // step, -(-end_ns // step) + 1):
        yield k * step


def _orbit(system: str, i: int, toe_ns: int) -> tuple[float, float, float, float]:
    """Return node (inertial), argument of perigee, mean anomaly and mean motion of satellite `i`."""
    w = NOMINAL[system]
    plane, slot = i % w.planes, i // w.planes
    in_plane = -(-(w.count - plane) // w.planes)
    since = (toe_ns - REFERENCE_NS) / SECOND_NS
    motion = float(np.sqrt(MU[system] / w.semi_major_m**3))
    node = 2.0 * np.pi * plane / w.planes + 0.3 * "GECR".index(system) + NODE_RATE * since
    perigee = 0.5 + 0.7 * plane
    phase = 2.0 * np.pi * (slot / in_plane + w.phasing * plane / w.count) - perigee
    return node, perigee, float(np.mod(phase + motion * since, 2.0 * np.pi)), motion


def _sidereal(toe_ns: int) -> float:
    """Return the Earth's turn since the reference time, rad."""
    return EARTH_RATE * (toe_ns - REFERENCE_NS) / SECOND_NS


def _clock(number: int) -> tuple[float, float, float]:
    """Return clock offset (s), its rate and a group delay (s): some values of the usual size."""
    offset = ((number * 37) % 101 - 50) * 4e-6
    return offset, ((number * 17) % 23 - 11) * 1e-12, ((number * 7) % 13 - 6) * 1e-9


def _kepler(system: str, i: int, toe_ns: int) -> list[str]:
    w = NOMINAL[system]
    node, perigee, mean_anomaly, _ = _orbit(system, i, toe_ns)
    offset, rate, delay = _clock(w.first + i)
    offset += rate * (toe_ns - REFERENCE_NS) / SECOND_NS % 1e-4
    zone_ns = BDT_OFFSET_NS if system == "C" else 0
    week, sow = to_week_tow(toe_ns - zone_ns)
    week -= BDT_WEEK if system == "C" else 0
    # the message counts the node from Greenwich at the beginning of the week
    from_week = float(np.mod(node - _sidereal(toe_ns) + EARTH_RATE * sow, 2.0 * np.pi))
    source = 517.0 if system == "E" else 0.0
    delays = {"G": (delay, 1.0), "E": (delay, 1.1 * delay), "C": (delay, 0.5 * delay)}[system]
    accuracy = {"G": 2.0, "E": 3.12, "C": 2.0}[system]
    last = {"G": (sow - 3600.0, 4.0), "E": (sow,), "C": (sow, 1.0)}[system]
    rows: tuple[tuple[float, ...], ...] = (
        (1.0, 0.0, 0.0, mean_anomaly),
        (0.0, w.eccentricity, 0.0, float(np.sqrt(w.semi_major_m))),
        (sow, 0.0, from_week, 0.0),
        (w.inclination_rad, 0.0, perigee, NODE_RATE),
        (0.0, source, float(week), 0.0),
        (accuracy, 0.0, *delays),
        last,
    )
    head = f"{system}{w.first + i:02d} {_stamp(toe_ns - zone_ns)}{_numbers((offset, rate, 0.0))}"
    return [head, *("    " + _numbers(row) for row in rows)]


def _state_vector(system: str, i: int, toe_ns: int) -> list[str]:
    w = NOMINAL[system]
    position, velocity = _earth_fixed(system, i, toe_ns)
    offset, rate, _ = _clock(w.first + i)
    utc_ns = toe_ns - _leap_s(toe_ns) * SECOND_NS
    frame_s = float(to_week_tow(utc_ns)[1] % 86_400.0)
    channel = float((i * 5) % 14 - 7)
    last = (0.0, channel, 0.0)
    head = f"{system}{w.first + i:02d} {_stamp(utc_ns)}{_numbers((offset, rate, frame_s))}"
    rows = ((p * 1e-3, v * 1e-3, 0.0, x) for p, v, x in zip(position, velocity, last, strict=True))
    return [head, *("    " + _numbers(row) for row in rows)]


def _earth_fixed(system: str, i: int, t_ns: int) -> tuple[FloatArray, FloatArray]:
    """Return position (m) and velocity (m/s) of a Kepler orbit, Earth-fixed."""
    w = NOMINAL[system]
    node, perigee, mean_anomaly, motion = _orbit(system, i, t_ns)
    e, a = w.eccentricity, w.semi_major_m
    E = mean_anomaly
    for _ in range(10):
        E = mean_anomaly + e * np.sin(E)
    root = np.sqrt(1.0 - e * e)
    flat = a * np.array([np.cos(E) - e, root * np.sin(E), 0.0])
    rate = a * motion / (1.0 - e * np.cos(E)) * np.array([-np.sin(E), root * np.cos(E), 0.0])
    turn = _about_z(node - _sidereal(t_ns)) @ _about_x(w.inclination_rad) @ _about_z(perigee)
    position = turn @ flat
    spin = EARTH_RATE * np.array([-position[1], position[0], 0.0])
    return position, turn @ rate - spin


def _about_z(angle: float) -> FloatArray:
    s, c = np.sin(angle), np.cos(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _about_x(angle: float) -> FloatArray:
    s, c = np.sin(angle), np.cos(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _stamp(t_ns: int) -> str:
    return to_iso(t_ns)[:19].replace("-", " ").replace("T", " ").replace(":", " ")


def _numbers(values: tuple[float, ...]) -> str:
    return "".join(f"{v:19.12E}" for v in values)
