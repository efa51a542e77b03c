"""Whether beacons are where their sound can come from: no farther than it travels in the time it took."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from pntegrity.errors import InputError
from pntegrity.physics.acoustics import FASTEST_MPS
from pntegrity.records import Epoch, FloatArray, Observation
from pntegrity.sensors._acoustic import Beacon, ways
from pntegrity.sensors.lbl import Lbl
from pntegrity.sensors.source import Source
from pntegrity.sensors.usbl import Usbl
from pntegrity.states import sensor_of

__all__ = ["check_reach"]

#: What positions, lever arms and the way of a vehicle since its last position may add, m and m/s; positions
#: that are older than this, s, are not asked.
SLACK_M, SLACK_MPS, OLDEST_S = 300.0, 30.0, 10.0
#: A beacon is refused that is so many times too far, as by a slip of signs or units, at so many of its
#: replies at least, and at this share of them; one that is nearer may be a fault, which monitors find.
TIMES, FEWEST, SHARE = 5.0, 3, 0.9
#: Of so many positions, evenly chosen, the distances are looked at.
MOST_PLACES = 200

Place = tuple[int, FloatArray, str]


def check_reach(sources: Sequence[Source], epochs: Sequence[Epoch]) -> None:
    """Check that the beacons of acoustic sources are within the reach of their sound.

    Parameters
    ----------
    sources : sequence of Source
        Of a vehicle; without one that tells a position nothing is said.
    epochs : sequence of Epoch
        What they said.

    Raises
    ------
    InputError
        A beacon's coordinates and its travel times or ranges cannot both be right; it is named, with both
        distances.
    """
    acoustic = [s for s in sources if isinstance(s, Lbl | Usbl)]
    places = _places(sources, epochs) if acoustic else []
    if not places:
        return
    t_ns = np.array([t for t, _, _ in places])
    seen: dict[tuple[str, str], list[tuple[float, float, str]]] = {}
    for o in (o for e in epochs for o in e.observations):
        source = next((s for s in acoustic if s.name == o.sensor), None)
        if source is None:
            continue
        k = int(np.argmin(np.abs(t_ns - o.t_ns)))
        old_s = abs(int(t_ns[k]) - o.t_ns) * 1e-9
        if old_s > OLDEST_S:
            continue
        for name, beacon, reach_m in _reached(source, o):
            far_m = float(np.linalg.norm(places[k][1] - beacon.position_m))
            slack_m = SLACK_M + SLACK_MPS * old_s
            seen.setdefault((source.name, name), []).append((far_m - slack_m, reach_m, places[k][2]))
    for (source_name, name), found in seen.items():
        _check(source_name, name, found)


def _check(source: str, name: str, found: Sequence[tuple[float, float, str]]) -> None:
    far = np.array([least > TIMES * reach for least, reach, _ in found])
    if far.sum() < FEWEST or far.mean() < SHARE:
        return
    least, reach, who = np.median([f[0] for f in found]), np.median([f[1] for f in found]), found[0][2]
    raise InputError(
        f"source {source}: {name} is {(least + SLACK_M) * 1e-3:.5g} km from where {who} says that the "
        f"vehicle is, but its sound comes from within {reach * 1e-3:.3g} km",
        hint="See its coordinates (signs; x_m, y_m, z_m ECEF in metres; lat_deg and lon_deg in degrees) and "
        "the unit of its times or ranges",
    )


def _places(sources: Sequence[Source], epochs: Sequence[Epoch]) -> list[Place]:
    """Return times and positions that a source tells by itself, and which."""
    told = {s.name: s for s in sources if hasattr(s, "position")}
    said = [o for e in epochs for o in e.observations if o.sensor in told and len(o.keys)]
    out: list[Place] = []
    for o in said[:: 1 + len(said) // MOST_PLACES]:
        found = told[o.sensor].position(o)
        if found is not None:
            out.append((o.t_ns, found[0], o.sensor))
    return out


def _reached(source: Source, o: Observation) -> Iterator[tuple[str, Beacon, float]]:
    """Yield who was heard, where it should be, and how far it can be at most, m."""
    for i, (key, y) in enumerate(zip(o.keys, o.y.tolist(), strict=True)):
        what = sensor_of(key)
        if isinstance(source, Lbl) and what in source.places:
            yield f"beacon {what!r}", source.places[what], FASTEST_MPS * y / ways(o, i, source.two_way)
        elif isinstance(source, Usbl) and what == "range":
            yield "the transponder", source.beacon, y
        elif isinstance(source, Usbl) and what == "time":
            yield "the transponder", source.beacon, FASTEST_MPS * y / ways(o, i, source.two_way)
