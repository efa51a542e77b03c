"""From chosen rows and satellite states to epochs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pntegrity.physics._choice import Chosen
from pntegrity.physics.orbits import SatelliteStates
from pntegrity.physics.signals import SPEED_OF_LIGHT_MPS, frequency_hz
from pntegrity.physics.tables import Klobuchar, SignalTable
from pntegrity.records import Epoch, FloatArray, Observation

__all__ = ["Bands", "Extra", "GnssEpochs", "assemble", "bands", "take"]

Index = npt.NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class GnssEpochs:
    """The epochs of a log.

    Parameters
    ----------
    epochs : tuple of Epoch
        One a time tag, also where no satellite is left (its notes tell why).
    notes : tuple of str
        What was left out over the whole log, counted.
    klobuchar : Klobuchar or None
        Ionosphere coefficients of the navigation files.
    products : tuple of str
        Where products of the atmosphere come from, in words.
    """

    epochs: tuple[Epoch, ...]
    notes: tuple[str, ...]
    klobuchar: Klobuchar | None
    products: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Extra:
    """What precise positioning needs of each chosen row beside satellite states, shapes (n,).

    Parameters
    ----------
    code_m, carrier_m : ndarray, shape (n,) or (n, 2)
        To be added to the prediction: antennas, tides, wind-up, biases; of the pair, or of each band.
    arc : ndarray of int64
        Number of the carrier's arc; another one where the ambiguity is another one.
    arc_reason : ndarray of int64
        Why an arc begins at this row (`kernels.slips.WORDS`), 0 where it goes on.
    carrier_shift_m : ndarray
        To be added to the carrier: jumps of the receiver's clock that the file shows in its code only.
    clock_node_s : ndarray, shape (n, 2)
        Time since the last and until the next sample of the satellite's clock.
    """

    code_m: FloatArray
    carrier_m: FloatArray
    arc: npt.NDArray[np.int64]
    arc_reason: npt.NDArray[np.int64]
    carrier_shift_m: FloatArray
    clock_node_s: FloatArray


@dataclass(frozen=True, eq=False)
class Bands:
    """Frequencies of the first and second code (nan: none) and the pair's ionosphere-free coefficients."""

    freq_hz: FloatArray
    freq2_hz: FloatArray

    def combine(self, first: FloatArray, second: FloatArray) -> FloatArray:
        """Return the ionosphere-free combination, or the first where there is no second."""
        gamma = (self.freq_hz / self.freq2_hz) ** 2
        return np.where(np.isnan(self.freq2_hz), first, (gamma * first - second) / (gamma - 1.0))

    @property
    def wavelengths_m(self) -> tuple[FloatArray, FloatArray]:
        """Wavelengths of both."""
        return SPEED_OF_LIGHT_MPS / self.freq_hz, SPEED_OF_LIGHT_MPS / self.freq2_hz


def bands(table: SignalTable, channels: Mapping[str, int], chosen: Chosen, at: Index) -> Bands:
    """Return the frequencies of some of the chosen rows."""
    sat = chosen.sat[at]
    return Bands(*(_frequencies(table, channels, sat, r[at]) for r in (chosen.first, chosen.second)))


def take(values: FloatArray, rows: Index) -> FloatArray:
    """Return values of table rows, nan where there is no row."""
    return np.where(rows >= 0, values[rows], np.nan)


def assemble(
    table: SignalTable,
    channels: Mapping[str, int],
    t_ns: npt.NDArray[np.int64],
    chosen: Chosen,
    states: SatelliteStates,
    reasons: npt.NDArray[np.object_],
    extra: Extra | None = None,
    combined: bool = True,
) -> tuple[tuple[Epoch, ...], list[str]]:
    """Return the epochs at the time tags, and notes on what was left out.

    Pairs are combined, or have a row on each band.
    """
    offset = int(np.searchsorted(table.t_ns, t_ns[0]))
    n = len(t_ns)
    sensors = _measurements(table, channels, chosen, states, extra, combined)
    per_sensor = [
        _slices(name, t_ns, chosen.epoch[at] - offset, keys, y, aux)
        for name, (at, keys, y, aux) in sensors.items()
    ]
    lost = np.flatnonzero(reasons != "")
    texts = [f"{s}: {r}" for s, r in zip(chosen.sat[lost].tolist(), reasons[lost].tolist(), strict=True)]
    bounds = np.searchsorted(chosen.epoch[lost] - offset, np.arange(n + 1)).tolist()
    epochs = tuple(
        Epoch(
            t,
            tuple(o for s in per_sensor if (o := s[i]) is not None),
            tuple(texts[bounds[i] : bounds[i + 1]]),
        )
        for i, t in enumerate(t_ns.tolist())
    )
    return epochs, _counted(chosen.sat[lost].tolist(), reasons[lost].tolist(), n)


def _counted(sats: list[str], reasons: list[str], n: int) -> list[str]:
    """Return a line a reason: which satellites it left out, and at how many of the `n` epochs."""
    by_reason: dict[str, Counter[str]] = {}
    for sat, reason in zip(sats, reasons, strict=True):
        by_reason.setdefault(reason, Counter())[sat] += 1
    return [
        f"{reason}: {', '.join(f'{sat} {k}' for sat, k in sorted(counts.items()))} of {n} epochs"
        for reason, counts in sorted(by_reason.items())
    ]


@dataclass(frozen=True, eq=False)
class _Rows:
    """Rows to be: which of `Chosen` and which band of it (0 or 1), table rows of both codes and carriers."""

    at: Index
    slot: Index
    code: tuple[Index, Index]
    carrier: tuple[Index, Index]
    band: Bands
    iono_factor: FloatArray

    def part(self, values: FloatArray) -> FloatArray:
        """Return what belongs to the rows of values of each pair, (n,), or of each band, (n, 2)."""
        return values[self.at] if values.ndim == 1 else values[self.at, self.slot]


def _pairs(table: SignalTable, channels: Mapping[str, int], chosen: Chosen, ok: Index) -> _Rows:
    """Return one row a pair."""
    band = bands(table, channels, chosen, ok)
    code, carrier = (
        (one[ok], two[ok])
        for one, two in ((chosen.first, chosen.second), (chosen.carrier_first, chosen.carrier_second))
    )
    return _Rows(ok, np.zeros_like(ok), code, carrier, band, np.where(code[1] >= 0, 0.0, 1.0))


def _singles(table: SignalTable, channels: Mapping[str, int], chosen: Chosen, ok: Index) -> _Rows:
    """Return two rows a pair, one a band; there are carriers where there are both."""
    pairs = _pairs(table, channels, chosen, ok)
    none = np.full(2 * len(ok), -1)
    whole = (pairs.carrier[0] >= 0) & (pairs.carrier[1] >= 0)
    code, carrier = (np.stack(rows, axis=1) for rows in (pairs.code, pairs.carrier))
    carrier[~whole] = -1
    freq = np.stack([pairs.band.freq_hz, pairs.band.freq2_hz], axis=1)
    return _Rows(
        ok.repeat(2), np.tile([0, 1], len(ok)), (code.ravel(), none), (carrier.ravel(), none),
        Bands(freq.ravel(), np.full(len(none), np.nan)), np.asarray((freq[:, :1] / freq) ** 2).ravel(),
    )  # fmt: skip


def _measurements(
    table: SignalTable,
    channels: Mapping[str, int],
    chosen: Chosen,
    states: SatelliteStates,
    extra: Extra | None,
    combined: bool,
) -> dict[str, tuple[Index, list[str], FloatArray, dict[str, npt.NDArray[np.generic]]]]:
    """Return for each sensor: rows of `chosen`, keys, values and aux."""
    rows = (_pairs if combined else _singles)(table, channels, chosen, np.flatnonzero(states.ok))
    band, code, carrier = rows.band, rows.code, rows.carrier
    wave = band.wavelengths_m
    cycles = [w * take(table.carrier_cycles, c) for w, c in zip(wave, carrier, strict=True)]
    rate = -wave[0] * _first_of(table.doppler_hz, carrier[0], code[0])
    values = {
        "code": band.combine(*(take(table.pseudorange_m, c) for c in code)),
        "doppler": np.where(rows.slot == 0, rate, np.nan),
        "carrier": band.combine(*cycles),
    }
    aux = _aux(table, chosen, states, rows)
    own: dict[str, dict[str, npt.NDArray[np.generic]]] = {name: {} for name in values}
    if extra is not None:
        values["carrier"] = values["carrier"] + extra.carrier_shift_m[rows.at]
        aux["clk_node_s"] = extra.clock_node_s[rows.at]
        own["code"] = {"model_m": rows.part(extra.code_m)}
        own["carrier"] = {
            "model_m": rows.part(extra.carrier_m), "arc": extra.arc[rows.at],
            "arc_reason": extra.arc_reason[rows.at],
        }  # fmt: skip
    out = {}
    for (name, y), letter in zip(values.items(), "CDL", strict=True):
        at = np.flatnonzero(np.isfinite(y + own[name].get("model_m", 0.0)))
        first, second = carrier if letter == "L" else code
        second = second[at] if letter != "D" else np.full(len(at), -1)
        keys = _keys(table, chosen.sat[rows.at[at]], letter, first[at], second)
        out[name] = rows.at[at], keys, y[at], {k: v[at] for k, v in (aux | own[name]).items()}
    return out


def _first_of(values: FloatArray, *rows: Index) -> FloatArray:
    """Return the values of the first of several rows that has one."""
    out = take(values, rows[-1])
    for r in reversed(rows[:-1]):
        own = take(values, r)
        out = np.where(np.isfinite(own), own, out)
    return out


def _aux(
    table: SignalTable, chosen: Chosen, states: SatelliteStates, rows: _Rows
) -> dict[str, npt.NDArray[np.generic]]:
    at = rows.at
    both = (chosen.carrier_first[at], chosen.carrier_second[at])
    lli = [np.where(c >= 0, table.lli[c], 0) for c in both]
    return {
        "sv_pos_m": states.position_m[at],
        "sv_vel_mps": states.velocity_mps[at],
        "sv_clk_m": states.clock_m[at],
        "sv_clk_rate_mps": states.clock_rate_mps[at],
        "sv_var_m2": states.variance_m2[at],
        "freq_hz": rows.band.freq_hz,
        "cn0_dbhz": _first_of(table.cn0_dbhz, rows.carrier[0], rows.code[0]),
        "lli": (lli[0] | lli[1]).astype(np.int8),
        "iono_factor": rows.iono_factor,
    }


def _frequencies(
    table: SignalTable, channels: Mapping[str, int], sat: npt.NDArray[np.str_], rows: Index
) -> FloatArray:
    """Return carrier frequencies, nan where there is no row or the GLONASS channel is unknown."""
    names = np.char.add(sat, table.signal[rows]) if len(rows) else sat
    kinds, inverse = np.unique(names, return_inverse=True)
    values = [frequency_hz(k[0], k[3:], channels.get(k[:3])) for k in kinds.tolist()]
    return np.where(rows >= 0, np.array(values)[inverse], np.nan)


def _keys(
    table: SignalTable, sat: npt.NDArray[np.str_], letter: str, first: Index, second: Index
) -> list[str]:
    signal = table.signal[first].astype("<U2")
    tail = np.where(second >= 0, np.char.add(f"+{letter}", table.signal[second]), "")
    names = np.char.add(np.char.add(sat, f":{letter}"), np.char.add(signal, tail))
    kinds, inverse = np.unique(names, return_inverse=True)
    shared: list[str] = kinds.astype(object)[inverse].tolist()  # one str object a key, not one a row
    return shared


def _slices(
    sensor: str,
    t_ns: npt.NDArray[np.int64],
    epoch: npt.NDArray[np.int64],
    keys: list[str],
    y: FloatArray,
    aux: dict[str, npt.NDArray[np.generic]],
) -> list[Observation | None]:
    """Return one observation for each time tag, None where the sensor has no row."""
    for a in (y, *aux.values()):
        a.flags.writeable = False
    bounds = np.searchsorted(epoch, np.arange(len(t_ns) + 1)).tolist()
    out: list[Observation | None] = []
    for t, i, j in zip(t_ns.tolist(), bounds, bounds[1:], strict=False):
        part = {k: v[i:j] for k, v in aux.items()}
        out.append(Observation(sensor, t, tuple(keys[i:j]), y[i:j], None, part) if j > i else None)
    return out
