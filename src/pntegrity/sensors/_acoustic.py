"""What acoustic sources share: beacons, the water, transducers on a vehicle that moves and turns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from pntegrity.kernels.rotations import rotation, skew
from pntegrity.physics.acoustics import (
    FASTEST_MPS,
    SLOWEST_MPS,
    Arrival,
    Path,
    SoundSpeed,
    arrival_at,
    path_between,
)
from pntegrity.physics.frames import geodetic_of, geodetic_to_ecef
from pntegrity.records import FloatArray, Observation
from pntegrity.sensors.source import Pose, SourceRows
from pntegrity.states import freeze

__all__ = [
    "Beacon", "Mounted", "Row", "Travel", "Water", "assemble", "beacon_of", "check_flag", "check_number",
    "check_positive", "depth_of", "matrix_of", "received_ns", "travel", "variances", "vector", "ways",
]  # fmt: skip

PROFILE = ("depth_m", "speed_mps")
ECEF, GEODETIC = ("x_m", "y_m", "z_m"), ("lat_deg", "lon_deg", "height_m")
#: How far before its first time a track still tells where the vehicle was, ns.
TRACK_SLACK_NS = 20_000_000
#: Lever arms longer than this are a slip of units, m.
LONGEST_ARM_M = 500.0


@dataclass(frozen=True, eq=False)
class Beacon:
    """A transponder: where it is, ECEF, and how long it waits before it replies."""

    position_m: FloatArray
    delay_s: float = 0.0

    def __post_init__(self) -> None:
        freeze(self, "position_m")


def beacon_of(name: str, table: Any, field: str = "beacons") -> Beacon:
    """Return a beacon of its table.

    Parameters
    ----------
    name : str
    table : mapping
        ``x_m``, ``y_m``, ``z_m`` (ECEF), or ``lat_deg``, ``lon_deg``, ``height_m`` above the ellipsoid; and
        ``delay_s``.
    field : str
        Where it stands, for messages.

    Raises
    ------
    ValueError
        No coordinates, unknown keys, numbers out of range.
    """
    where = f"`{field}`: beacon {name!r}"
    if not isinstance(table, Mapping):
        raise ValueError(f"{where} must be a table with its coordinates, not {table!r}")
    extra = set(table) - {*ECEF, *GEODETIC, "delay_s"}
    if extra:
        raise ValueError(f"{where} has unknown keys: {', '.join(sorted(extra))}")
    given = next((names for names in (ECEF, GEODETIC) if set(names) <= set(table)), None)
    if given is None:
        raise ValueError(
            f"{where} has no coordinates: give x_m, y_m, z_m (ECEF), or lat_deg, lon_deg and height_m above "
            "the ellipsoid"
        )
    a, b, c = (check_number(table[n], f"{where}: `{n}`") for n in given)
    if given == GEODETIC and (abs(a) > 90.0 or abs(b) > 360.0):
        raise ValueError(f"{where}: `lat_deg` {a:g} and `lon_deg` {b:g} are no place")
    place = np.array([a, b, c]) if given == ECEF else geodetic_to_ecef(np.radians(a), np.radians(b), c)
    if not 6.3e6 < float(np.linalg.norm(place)) < 6.5e6:
        raise ValueError(
            f"{where} is not near the surface of the Earth: {', '.join(ECEF)} must be ECEF, in metres, and "
            "height_m above the ellipsoid"
        )
    delay = check_number(table.get("delay_s", 0.0), f"{where}: `delay_s`")
    check_positive(f"{where}: `delay_s`", delay, zero=True)
    return Beacon(place, delay)


def check_number(value: Any, what: str) -> float:
    """Return a finite number (ValueError, named `what`: it is none)."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise ValueError(f"{what} must be a number, not {value!r}")
    return float(value)


def check_flag(what: str, value: Any) -> None:
    """Check that a value is true or false (ValueError, named `what`)."""
    if not isinstance(value, bool):
        raise ValueError(f"{what} must be true or false, not {value!r}")


def check_positive(what: str, value: Any, *, zero: bool = False) -> None:
    """Check that a value is a number above zero, or zero where that is allowed.

    Raises
    ------
    ValueError
        Named `what`.
    """
    number = check_number(value, what)
    if not (number > 0.0 or (zero and number == 0.0)):
        raise ValueError(f"{what} must be {'0 or ' if zero else ''}positive, not {value!r}")


def vector(what: str, value: Sequence[float]) -> FloatArray:
    """Return three numbers, each no larger than `LONGEST_ARM_M`, as a vector.

    Raises
    ------
    ValueError
        Named `what`.
    """
    out = np.asarray(value, dtype=np.float64)
    if out.shape != (3,) or not (np.abs(out) <= LONGEST_ARM_M).all():
        raise ValueError(
            f"`{what}` must be three numbers forward, right, down up to {LONGEST_ARM_M:g}, not {value}"
        )
    return out


def matrix_of(what: str, angles_deg: Sequence[float]) -> FloatArray:
    """Return the matrix (3, 3) that turns transducer axes into body axes, both forward, right, down.

    Parameters
    ----------
    what : str
        The field, for messages.
    angles_deg : sequence of float
        Roll, pitch and yaw of the transducer in the body: ``Rz(yaw) Ry(pitch) Rx(roll)``.
    """
    roll, pitch, yaw = np.radians(vector(what, angles_deg))
    return np.asarray(rotation([0.0, 0.0, yaw]) @ rotation([0.0, pitch, 0.0]) @ rotation([roll, 0.0, 0.0]))


def _numbers(values: Any, what: str) -> FloatArray:
    values = values.tolist() if isinstance(values, np.ndarray) else values
    if not isinstance(values, Sequence) or isinstance(values, str):
        raise ValueError(f"{what} must be a list of numbers, not {values!r}")
    return np.array([check_number(v, what) for v in values])


class Water:
    """The water as an acoustic source's fields describe it.

    Parameters
    ----------
    speed_mps : float
        Used where there is no profile.
    profile : SoundSpeed, mapping or None
        ``depth_m`` and ``speed_mps``, lists.
    sea_height_m : float or None
        Height of the sea surface above the ellipsoid; needed with a profile.

    Raises
    ------
    ValueError
        Not in range, or a profile without the height of the surface.
    """

    def __init__(self, speed_mps: float, profile: Any, sea_height_m: float | None) -> None:
        if profile is not None and sea_height_m is None:
            raise ValueError(
                "`sea_height_m`, the height of the sea surface above the ellipsoid, goes with `profile`"
            )
        self.sea_height_m = 0.0 if sea_height_m is None else check_number(sea_height_m, "`sea_height_m`")
        if profile is None:
            speed_mps = check_number(speed_mps, "`sound_speed_mps`")
            if not SLOWEST_MPS <= speed_mps <= FASTEST_MPS:
                raise ValueError(
                    f"`sound_speed_mps` must lie between {SLOWEST_MPS:g} and {FASTEST_MPS:g} m/s, not "
                    f"{speed_mps:g}"
                )
            profile = SoundSpeed.constant(speed_mps)
        elif isinstance(profile, Mapping):
            if set(profile) != set(PROFILE):
                raise ValueError("`profile` must have the lists `depth_m` and `speed_mps`, nothing else")
            profile = SoundSpeed(*(_numbers(profile[n], f"`profile`: `{n}`") for n in PROFILE))
        if not isinstance(profile, SoundSpeed):
            raise ValueError(
                f"`profile` must be the name of a file, or lists `depth_m` and `speed_mps`, not {profile!r}"
            )
        self.sound: SoundSpeed = profile

    def check(self, beacon: Beacon, name: str) -> None:
        """Check that the profile reaches a beacon (ValueError, with both depths)."""
        if not self.sound.is_constant:
            depth = depth_of(beacon.position_m, self.sea_height_m)
            self.sound.check(depth, f"beacon {name!r}")

    def path(self, here_m: FloatArray, there_m: FloatArray) -> Path:
        """Return the direct ray between two places (ValueError: none, or the profile does not reach)."""
        path = path_between(self.sound, here_m, there_m, self.sea_height_m)
        if not np.isfinite(path.time_s):
            raise ValueError("no sound arrives without turning")
        return path

    def arrival(self, here_m: FloatArray, there_m: FloatArray) -> Arrival:
        """Return from where the sound of another place comes (ValueError as `path`)."""
        arrival = arrival_at(self.sound, here_m, there_m, self.sea_height_m)
        if not np.isfinite(arrival.direction).all():
            raise ValueError("no sound arrives without turning")
        return arrival


def depth_of(place_m: FloatArray, sea_height_m: float) -> float:
    """Return the depth of a place below the sea surface."""
    return sea_height_m - geodetic_of(*place_m.tolist())[2]


class Mounted(NamedTuple):
    """A transducer at an instant: where it is, and how that moves with small turns of the vehicle.

    Parameters
    ----------
    position_m : ndarray, shape (3,)
        ECEF.
    C : ndarray, shape (3, 3)
        Body axes to ECEF.
    by_turn : ndarray, shape (3, 3)
        Derivative of the position by the attitude error.
    """

    position_m: FloatArray
    C: FloatArray
    by_turn: FloatArray

    @staticmethod
    def at(pose: Pose, t_ns: int, arm_m: FloatArray) -> Mounted:
        """Return where a transducer is at a time of a pose's track.

        Raises
        ------
        ValueError
            Where the track does not reach back that far, or the time is yet to come.
        """
        if t_ns == pose.t_ns:
            x, C = pose.position_m, pose.C
        else:
            first, last = int(pose.track.t_ns[0]), max(int(pose.track.t_ns[-1]), pose.t_ns)
            if t_ns < first - TRACK_SLACK_NS:
                raise ValueError(f"the track begins {(first - t_ns) * 1e-9:.3f} s after the signal was sent")
            if t_ns > last + TRACK_SLACK_NS:
                raise ValueError(f"its time is {(t_ns - last) * 1e-9:.3f} s ahead of the vehicle's")
            x, C = pose.track.at(t_ns)
        arm = C @ arm_m
        return Mounted(x + arm, C, -skew(arm))


class Travel(NamedTuple):
    """How long a sound was in the water, s, its derivatives by position, velocity and attitude, and the
    reply's delay.
    """

    time_s: float
    by_place: FloatArray
    by_speed: FloatArray
    by_turn: FloatArray
    delay_s: float

    @property
    def slopes(self) -> dict[str, FloatArray]:
        """Derivatives by block of states."""
        return {"pos": self.by_place, "vel": self.by_speed, "att": self.by_turn}


def travel(
    water: Water, o: Observation, i: int, pose: Pose, arm_m: FloatArray, beacon: Beacon, two_way: bool
) -> Travel:
    """Return the travel of a row's sound, one way or there and back.

    Parameters
    ----------
    water : Water
    o : Observation
        `aux` ``"ways"`` goes before `two_way`; ``"t0_ns"`` and ``"received_ns"`` tell when the sound left and
        came.
    i : int
        Which row.
    pose : Pose
    arm_m : ndarray, shape (3,)
    beacon : Beacon
    two_way : bool

    Raises
    ------
    ValueError
        As `Mounted.at` and `Water.path`.
    """
    received = received_ns(o, i)
    two_way = ways(o, i, two_way) == 2
    times, ends = [received], [Mounted.at(pose, received, arm_m)]
    if two_way:
        sent = int(o.aux["t0_ns"][i]) if "t0_ns" in o.aux else received - round(float(o.y[i]) * 1e9)
        times.append(sent)
        ends.append(Mounted.at(pose, sent, arm_m))
    paths = [water.path(end.position_m, beacon.position_m) for end in ends]
    turns = [path.slowness_spm @ end.by_turn for path, end in zip(paths, ends, strict=True)]
    by_place = np.sum([path.slowness_spm for path in paths], axis=0)
    ages_s = [(pose.t_ns - t) * 1e-9 for t in times]
    by_speed = -np.sum([age * path.slowness_spm for age, path in zip(ages_s, paths, strict=True)], axis=0)
    time = sum(path.time_s for path in paths)
    delay_s = beacon.delay_s if two_way else 0.0
    return Travel(time, by_place, by_speed, np.sum(turns, axis=0), delay_s)


def ways(o: Observation, i: int, two_way: bool) -> int:
    """Return whether a row's time is of one way or of two: as it says itself, else as its source does."""
    return int(o.aux["ways"][i]) if "ways" in o.aux else 2 if two_way else 1


def received_ns(o: Observation, i: int) -> int:
    """Return when a row was received."""
    return int(o.aux["received_ns"][i]) if "received_ns" in o.aux else o.t_ns


@dataclass(frozen=True)
class Row:
    """One row that can be used: key, innovation, Jacobian by block, variance."""

    key: str
    nu: float
    H: Mapping[str, FloatArray | float]
    var: float


def assemble(rows: Sequence[Row], blocks: Mapping[str, int], reasons: Sequence[str]) -> SourceRows:
    """Return rows of one source.

    Parameters
    ----------
    rows : sequence of Row
    blocks : mapping of str to int
        The blocks of states that the source knows, and their widths.
    reasons : sequence of str
        Why rows were left out.
    """
    H = {
        name: np.array([np.broadcast_to(r.H.get(name, 0.0), (width,)) for r in rows]).reshape(
            len(rows), width
        )
        for name, width in blocks.items()
    }
    return SourceRows(
        tuple(r.key for r in rows), np.array([r.nu for r in rows]), H, np.diag([r.var for r in rows]),
        "; ".join(dict.fromkeys(reasons)),
    )  # fmt: skip


def variances(observation: Observation, sigma: Sequence[float]) -> FloatArray:
    """Return the variances of rows: declared by the observation where it does, else of `sigma`."""
    return np.square(np.asarray(sigma if observation.sigma is None else observation.sigma, dtype=np.float64))
