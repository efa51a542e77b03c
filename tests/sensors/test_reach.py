"""Beacons that cannot be where they are said to be: told by positions and the time that sound takes."""

from __future__ import annotations

import numpy as np
import pytest

from pntegrity.errors import InputError
from pntegrity.physics.frames import geodetic_to_ecef
from pntegrity.records import Epoch, Observation
from pntegrity.sensors.fix import Fix
from pntegrity.sensors.lbl import Lbl
from pntegrity.sensors.reach import check_reach
from pntegrity.sensors.usbl import Usbl

SECOND = 10**9
SHIP = geodetic_to_ecef(0.6, 2.1, 0.0)
DOWN = -SHIP / np.linalg.norm(SHIP)
ALONG = np.cross(DOWN, [0.0, 0.0, 1.0])
KEYS = ("gnss:RX", "gnss:RY", "gnss:RZ")


def fix(t_s):
    aux = {"cov": np.eye(3)}
    return Observation("gnss", t_s * SECOND, KEYS, SHIP, np.ones(3), aux)


def beacon(far_m):
    """Return a beacon's table: 1 km deep, and so far to the side."""
    return dict(zip(("x_m", "y_m", "z_m"), (SHIP + 1000.0 * DOWN + far_m * ALONG).tolist(), strict=True))


def log(*heard, fixes=True):
    """Return epochs 2 s apart, a fix and what was heard in each."""
    said = [Observation(s, t * SECOND + 10**8, k, np.array(y)) for t in range(0, 40, 2) for s, k, y in heard]
    positions = [fix(t) for t in range(0, 40, 2)] if fixes else []
    return [Epoch(o.t_ns, (o,)) for o in sorted([*positions, *said], key=lambda o: o.t_ns)]


def lbl(*far_m, **fields):
    return Lbl(beacons={f"T{i}": beacon(f) for i, f in enumerate(far_m)}, **fields)


@pytest.mark.parametrize(("far_m", "refused"), [(0.0, False), (4000.0, False), (30_000.0, True), (5e5, True)])
def test_a_beacon_is_refused_where_no_sound_comes_from_but_not_one_that_was_moved(far_m, refused):
    sources = (Fix("gnss"), lbl(0.0, far_m))
    epochs = log(("lbl", ("lbl:R.T0", "lbl:R.T1"), [0.67, 0.67]))
    if not refused:
        check_reach(sources, epochs)
        return
    with pytest.raises(InputError, match=r"source lbl: beacon 'T1' is .* km from where gnss"):
        check_reach(sources, epochs)


def test_times_there_and_back_are_halved_and_ranges_are_taken_as_they_are():
    epochs = log(("lbl", ("lbl:R.T0",), [30.0]))
    check_reach((Fix("gnss"), lbl(80_000.0)), epochs)
    check_reach((Fix("gnss"), lbl(80_000.0, two_way=True)), epochs)
    with pytest.raises(InputError, match="beacon 'T0'"):
        check_reach((Fix("gnss"), lbl(200_000.0, two_way=True)), epochs)
    near = log(("usbl", ("usbl:R.range", "usbl:A.bearing"), [1000.0, 0.3]))
    check_reach((Fix("gnss"), Usbl(transponder=beacon(0.0))), near)
    with pytest.raises(InputError, match="source usbl: the transponder is"):
        check_reach((Fix("gnss"), Usbl(transponder=beacon(1e6))), near)


def test_without_a_position_or_with_few_odd_replies_nothing_is_said():
    sources = (Fix("gnss"), lbl(0.0, 5e5))
    heard = ("lbl", ("lbl:R.T0", "lbl:R.T1"), [0.67, 0.67])
    check_reach(sources, log(heard, fixes=False))
    check_reach((lbl(0.0, 5e5),), log(heard))
    check_reach(sources, [])
    odd = log(("lbl", ("lbl:R.T0",), [0.67]))
    odd[1] = Epoch(odd[1].t_ns, (Observation("lbl", odd[1].t_ns, ("lbl:R.T0",), np.array([1e-6])),))
    check_reach((Fix("gnss"), lbl(0.0)), odd)
