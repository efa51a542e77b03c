"""Records without data for the audits."""

from dataclasses import replace

import numpy as np
import pytest

from pntegrity.records import Prior, State, Update
from pntegrity.simulate.linear import gains, spp_model


def filtered(rows: list[tuple[int, ...]], restart: tuple[int, ...] = ()) -> tuple[Update, ...]:
    """Return updates of the SPP filter with these satellites at each epoch; it starts anew where told."""
    model = spp_model(8)
    out: list[Update] = []
    for k, satellites in enumerate(rows):
        index = [*satellites, *(s + 8 for s in satellites)]
        begins = k == 0 or k in restart
        F = np.zeros((8, 0)) if begins else model.F
        P = model.P0 if begins else model.F @ out[-1].posterior.P @ model.F.T + model.Q
        prior = Prior(State(model.t_ns(k), np.zeros(8), P, model.layout), F, model.Q)
        keys = tuple(model.keys[i] for i in index)
        out.append(
            Update.of(prior, keys, np.zeros(len(index)), model.H[index], model.R[np.ix_(index, index)])
        )
    return tuple(out)


@pytest.fixture(scope="session")
def steady() -> tuple[Update, ...]:
    """150 epochs of ten satellites."""
    return gains(spp_model(), 150)


@pytest.fixture(scope="session")
def eventful() -> tuple[Update, ...]:
    """Satellites rise and set, an epoch has no rows, the filter starts anew, a repair goes back in time."""
    everyone = tuple(range(8))
    rows = [everyone[:6]] * 20 + [everyone] * 15 + [()] + [everyone[2:]] * 30 + [everyone] * 64
    updates = filtered(rows, restart=(66,))
    mixed = replace(updates[3], consumed=2)
    return (*updates[:3], mixed, *updates[4:90], *updates[80:])
