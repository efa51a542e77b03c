"""Satellites as a source of a vehicle: RINEX files in, observations of one source out."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pntegrity.errors import InputError
from pntegrity.formats.rinex_nav import read_navigation
from pntegrity.formats.rinex_obs import read_observations
from pntegrity.physics.gnss_epochs import gnss_epochs
from pntegrity.records import Epoch, Observation, group_of

__all__ = ["merged", "satellites_of"]

#: What the rows of a satellite need beside the measured value.
AUX = ("sv_pos_m", "sv_vel_mps", "sv_clk_m", "sv_clk_rate_mps", "freq_hz", "cn0_dbhz", "iono_factor")
HINT = 'A source of type gnss has obs = "its observations.rnx" and nav = ["ephemerides of the day.rnx"]'


def satellites_of(
    table: Mapping[str, Any], notes: list[str]
) -> tuple[Mapping[str, Any], tuple[Observation, ...]]:
    """Return what a receiver's files say of its satellites.

    Parameters
    ----------
    table : mapping
        A ``[[source]]`` table of type gnss: ``obs``, a RINEX file, ``nav``, one or several; and ``name`` and
        ``systems``.
    notes : list of str
        Gets what was left out.

    Returns
    -------
    fields : mapping
        Fields of `sensors.gnss.Gnss` that the files tell: ``klobuchar``.
    said : tuple of Observation
        One an epoch that has any satellite, pseudoranges ``"<name>:R.G05"`` (m), and behind them range rates
        ``"<name>:D.G05"`` (m/s).

    Raises
    ------
    InputError
        No files named, files that cannot be used, or no satellite with an ephemeris.
    """
    name = str(table.get("name", "gnss"))
    obs, nav = _files(table, "obs", name), _files(table, "nav", name)
    if len(obs) > 1:
        raise InputError(f"source {name}: `obs` is one file, not {len(obs)}", hint=HINT)
    try:
        signals = read_observations(obs[0])
        found = gnss_epochs(signals, read_navigation(nav), systems=str(table.get("systems", "GREC")))
    except InputError as error:
        raise InputError(
            f"source {name}: {error.message}", path=error.path, line=error.line, epoch=error.epoch,
            hint=error.hint or HINT,
        ) from None  # fmt: skip
    except ValueError as error:
        raise InputError(f"source {name}: {error}", hint=HINT) from None
    notes += [f"source {name}: {note}" for note in (*signals.notes, *found.notes)]
    said = (merged(epoch, name) for epoch in found.epochs)
    return {"klobuchar": found.klobuchar}, tuple(o for o in said if len(o.keys))


def _files(table: Mapping[str, Any], field: str, name: str) -> list[Path]:
    """Return the files of a field (InputError where there are none)."""
    given = table.get(field)
    files = list(given) if isinstance(given, list | tuple) else [given] if given else []
    if not files:
        raise InputError(f"source {name}: no `{field}`", hint=HINT)
    if not all(isinstance(f, str | Path) for f in files):
        raise InputError(f"source {name}: `{field}` must name files, not {given!r}", hint=HINT)
    return [Path(f) for f in files]


def merged(epoch: Epoch, name: str) -> Observation:
    """Return the pseudoranges and range rates of an epoch as one source says them.

    Parameters
    ----------
    epoch : Epoch
        As `physics.gnss_epochs` gives it, one signal a satellite.
    name : str
        Of the source.
    """
    keys: list[str] = []
    parts: list[Observation] = []
    for sensor, kind in (("code", "R"), ("doppler", "D")):
        found = epoch.sensor(sensor)
        if found is not None:
            keys += [f"{name}:{kind}.{group_of(k)}" for k in found.keys]
            parts.append(found)
    if not parts:
        return Observation(name, epoch.t_ns, (), np.zeros(0))
    aux = {a: np.concatenate([p.aux[a] for p in parts]) for a in AUX}
    return Observation(name, epoch.t_ns, tuple(keys), np.concatenate([p.y for p in parts]), aux=aux)
