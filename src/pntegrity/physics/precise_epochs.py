"""Signals and precise products -> the epochs that precise point positioning takes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from pntegrity.errors import InputError
from pntegrity.kernels import slips
from pntegrity.physics._assembly import Bands, Extra, GnssEpochs, assemble, bands
from pntegrity.physics._choice import Chosen, check_systems, choose, systems_left_out, window
from pntegrity.physics.arcs import SlipLimits, arcs_of, clock_resets_m
from pntegrity.physics.corrections import Antennas, Corrections, Site, corrections_m, sky_of
from pntegrity.physics.orbits import SatelliteStates
from pntegrity.physics.precise import NO_CLOCK, NO_ORBIT, clock_nodes_s, clock_pieces, precise_states
from pntegrity.physics.products import (
    CodeBiases,
    OceanLoading,
    PolarMotion,
    PreciseClocks,
    PreciseOrbits,
    ReceiverAntenna,
)
from pntegrity.physics.signals import CLOCK_SIGNALS, SPEED_OF_LIGHT_MPS, WORDS, frequency_hz
from pntegrity.physics.ssr import SsrBiases
from pntegrity.physics.tables import SignalTable
from pntegrity.physics.time import SECOND_NS, to_iso
from pntegrity.records import Epoch, FloatArray

__all__ = ["Products", "SiteFacts", "precise_epochs"]

TRACK_NS = 60 * SECOND_NS
"""Positions along the way are made this far apart."""
Locate = Callable[[Sequence[Epoch]], FloatArray]
Join = Callable[[FloatArray, FloatArray], FloatArray]


@dataclass(frozen=True, eq=False)
class Products:
    """Orbits and clocks, and what else is known of the satellites."""

    orbits: PreciseOrbits
    clocks: PreciseClocks
    biases: CodeBiases | None = None
    antennas: Antennas | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class SiteFacts:
    """What is known of the receiver's antenna and its marker; see `corrections.Site`."""

    antenna: ReceiverAntenna | None = None
    ocean: OceanLoading | None = None
    pole: PolarMotion | None = None
    tides: bool = True
    limits: SlipLimits = field(default_factory=SlipLimits)


def precise_epochs(
    table: SignalTable,
    products: Products,
    locate: Locate,
    *,
    systems: str = "GREC",
    signals: Mapping[str, tuple[str, ...]] | None = None,
    start_ns: int | None = None,
    end_ns: int | None = None,
    site: SiteFacts | None = None,
    channels: Mapping[str, int] | None = None,
    combined: bool = True,
) -> GnssEpochs:
    """Return the epochs of a signal table with precise satellite positions, clocks and corrections.

    Parameters
    ----------
    table : SignalTable
    products : Products
    locate : callable
        Takes epochs and returns where the receiver was, good to a kilometre, (n, 3), nan where unknown.
    systems, signals, start_ns, end_ns
        As for `gnss_epochs`; `PRECISE_PAIRS` are preferred.
    site : SiteFacts, optional
    channels : mapping of str to int, optional
        GLONASS channels that the file does not give.
    combined : bool
        False: pairs are not combined, a satellite has a row of code and one of carrier on either band.

    Returns
    -------
    GnssEpochs
        As `gnss_epochs` gives with ``ionosphere_free``, or uncombined: keys ``"G05:C1W"``, ``"G05:C2W"``,
        ``"G05:L1C"``, ``"G05:L2W"``; ``iono_factor`` is then the delay in units of that on the satellite's
        first band. Clocks refer to the ionosphere-free combination of `CLOCK_SIGNALS`: where no biases are
        given, slant delays made of these rows contain the satellite's bias between these two codes.
        `aux` has also ``model_m`` (to be added to predictions: antennas, tides, wind-up, path delay, code
        biases); of ``"carrier"``: ``arc`` and ``arc_reason``; of all ``clk_node_s``, the time since the last
        and until the next sample of the satellite's clock (n, 2).

    Raises
    ------
    InputError
        No time tag in the interval, none of the systems in the file, no satellite with orbit and clock.
    """
    check_systems(systems)
    site = site or SiteFacts()
    t_ns, rows = window(table, systems, start_ns, end_ns)
    chosen = choose(table, rows, signals or {}, pair=True, precise=True)
    states = _states(table, products, chosen)
    reasons = np.where(chosen.reason == "", states.reason, chosen.reason)
    _check_any(table, products, states, reasons)
    channels = {**(channels or {}), **table.glonass_channels}
    rough, _ = assemble(table, channels, *_thinned(t_ns, table, chosen, states, reasons))
    track = _track(t_ns, rough, locate)
    extra, notes = _extra(table, channels, products, site, chosen, states, t_ns, track, combined)
    epochs, counted = assemble(table, channels, t_ns, chosen, states, reasons, extra, combined)
    return GnssEpochs(epochs, (*systems_left_out(table, systems), *products.notes, *notes, *counted), None)


def _states(table: SignalTable, products: Products, chosen: Chosen) -> SatelliteStates:
    usable = np.where(chosen.reason == "", table.pseudorange_m[chosen.first], np.nan)
    t_ns = table.t_ns[chosen.epoch]
    return precise_states(products.orbits, products.clocks, chosen.sat, t_ns, usable)


def _check_any(
    table: SignalTable, products: Products, states: SatelliteStates, reasons: npt.NDArray[np.object_]
) -> None:
    if states.ok.any():
        return
    if {NO_ORBIT, NO_CLOCK} & set(reasons.tolist()):
        first, last = products.orbits.coverage_ns
        raise InputError(
            f"no satellite has both a precise orbit and a clock from {to_iso(int(table.t_ns[0]))} to "
            f"{to_iso(int(table.t_ns[-1]))}; the orbits cover {to_iso(first)} to {to_iso(last)}",
            path=table.source,
            hint="Give the SP3 (and CLK) files of the same days",
        )
    why = ", ".join(f"{r} ({n})" for r, n in Counter(reasons.tolist()).most_common(3))
    raise InputError(
        f"no satellite can be used: {why}",
        path=table.source,
        hint="Precise positioning needs code and carrier on two frequencies",
    )


# --- where the receiver was ---------------------------------------------------------------------------------


def _thinned(
    t_ns: npt.NDArray[np.int64], table: SignalTable, chosen: Chosen, states: SatelliteStates,
    reasons: npt.NDArray[np.object_],
) -> tuple[npt.NDArray[np.int64], Chosen, SatelliteStates, npt.NDArray[np.object_]]:  # fmt: skip
    """Return the rows with all but one epoch a minute hidden."""
    kept = np.zeros(len(table.t_ns), dtype=bool)
    last = -TRACK_NS
    first = int(np.searchsorted(table.t_ns, t_ns[0]))
    for i, t in enumerate(t_ns.tolist(), first):
        if t - last >= TRACK_NS or i == first + len(t_ns) - 1:
            kept[i], last = True, t
    return t_ns, chosen, replace(states, ok=states.ok & kept[chosen.epoch]), reasons


def _track(t_ns: npt.NDArray[np.int64], rough: Sequence[Epoch], locate: Locate) -> FloatArray:
    """Return a position for each time tag, between and around those that could be located."""
    seen = np.array([bool(e.observations) for e in rough])
    positions = np.full((len(rough), 3), np.nan)
    positions[seen] = locate([e for e, s in zip(rough, seen, strict=True) if s])
    known = np.isfinite(positions).all(axis=1)
    if not known.any():
        raise InputError(
            "no position could be made from code anywhere in the interval",
            hint="At least 5 satellites with code on two frequencies are needed at some epoch",
        )
    return np.stack([np.interp(t_ns, t_ns[known], positions[known, i]) for i in range(3)], axis=1)


# --- corrections and arcs -----------------------------------------------------------------------------------


def _extra(
    table: SignalTable, channels: Mapping[str, int], products: Products, facts: SiteFacts, chosen: Chosen,
    states: SatelliteStates, t_ns: npt.NDArray[np.int64], track_m: FloatArray, combined: bool,
) -> tuple[Extra, list[str]]:  # fmt: skip
    everything = np.arange(len(chosen))
    band = bands(table, channels, chosen, everything)
    order = np.lexsort((chosen.epoch, chosen.sat))
    order = order[states.ok[order]]
    shift, resets = clock_resets_m(table, chosen, band, order)
    piece = clock_pieces(products.clocks, chosen.sat, table.t_ns[chosen.epoch])
    arcs = arcs_of(table, chosen, band, order, piece, shift, facts.limits)
    join = Bands(band.freq_hz[order], band.freq2_hz[order]).combine if combined else None
    code, carrier, notes = _models(table, products, facts, chosen, states, t_ns, track_m, band, order, join)
    if resets:
        notes.append(f"{resets} jumps of the receiver clock in code only: carriers moved along")
    nodes = clock_nodes_s(products.clocks, chosen.sat, table.t_ns[chosen.epoch])
    found = Extra(code, carrier, arcs.number, arcs.reason, shift, nodes)
    return found, notes + _slips_in_words(arcs.reason)


def _slips_in_words(reason: npt.NDArray[np.int64]) -> list[str]:
    counts = np.bincount(reason, minlength=len(slips.WORDS) + 1)
    found = ", ".join(f"{word} {counts[code]}" for code, word in slips.WORDS.items() if counts[code])
    return [f"carrier arcs begin: {found}"] if found else []


def _models(
    table: SignalTable, products: Products, facts: SiteFacts, chosen: Chosen, states: SatelliteStates,
    t_ns: npt.NDArray[np.int64], track_m: FloatArray, band: Bands, order: npt.NDArray[np.intp],
    combine: Join | None,
) -> tuple[FloatArray, FloatArray, list[str]]:  # fmt: skip
    """Return what is to be added to predicted code and carrier, and notes; both bands combined, or side by
    side, shape (n, 2).
    """
    site = Site(track_m, table.antenna_delta_hen_m, facts.antenna, facts.ocean, facts.pole, facts.tides)
    first = int(np.searchsorted(table.t_ns, t_ns[0]))
    sky = sky_of(t_ns, chosen.epoch[order] - first, chosen.sat[order], states.position_m[order], site)
    both = []
    notes: list[str] = []
    for slot, (rows, wave) in enumerate(zip((chosen.first, chosen.second), band.wavelengths_m, strict=True)):
        names = table.signal[rows[order]].astype("<U1")
        part = corrections_m(sky, names, wave[order], site, products.antennas)
        both.append(_with_signal_biases(part, table, products.biases, chosen, order, slot))
        notes += part.notes
    join = combine or _side_by_side
    bias = _biases(table, products.biases, chosen, order, notes, apart=combine is None)
    found = join(both[0].code_m, both[1].code_m) + join(*bias)
    code = np.full((len(chosen), *found.shape[1:]), np.nan)
    carrier = code.copy()
    code[order] = found
    carrier[order] = join(both[0].carrier_m, both[1].carrier_m)
    return code, carrier, list(dict.fromkeys(notes))


def _with_signal_biases(
    part: Corrections, table: SignalTable, biases: object, chosen: Chosen, order: npt.NDArray[np.intp],
    slot: int,
) -> Corrections:  # fmt: skip
    """Return corrections of one band with the biases that a service tells of its code and carrier."""
    if not isinstance(biases, SsrBiases):
        return part
    sats, t_ns = chosen.sat[order], table.t_ns[chosen.epoch[order]]
    code = table.signal[(chosen.first, chosen.second)[slot][order]]
    carrier = table.signal[(chosen.carrier_first, chosen.carrier_second)[slot][order]]
    return replace(
        part,
        code_m=part.code_m + biases.of_m("code", sats, code, t_ns),
        carrier_m=part.carrier_m + biases.of_m("phase", sats, carrier, t_ns),
    )


def _side_by_side(first: FloatArray, second: FloatArray) -> FloatArray:
    return np.stack([first, second], axis=1)


def _biases(
    table: SignalTable,
    biases: CodeBiases | None,
    chosen: Chosen,
    order: npt.NDArray[np.intp],
    notes: list[str],
    apart: bool = False,
) -> tuple[FloatArray, FloatArray]:
    """Return by how much the two codes are longer than those that the clocks refer to, m.

    Where the second is of another band, the combination is another one too: what that changes is added to
    both. For codes `apart` it is by how much they are longer than the clocks' combination, where that is
    known.
    """
    out = []
    unknown: Counter[str] = Counter()
    for slot, rows in enumerate((chosen.first, chosen.second)):
        names = np.char.add(chosen.sat[order], table.signal[rows[order]])
        kinds, inverse = np.unique(names, return_inverse=True)
        values = np.zeros((len(kinds), 2))
        for i, kind in enumerate(kinds.tolist()):
            reference = CLOCK_SIGNALS[kind[0]][slot]
            found = 0.0 if reference == kind[3:] else None
            if found is None and biases is not None:
                found = biases.difference_s(kind[:3], kind[3:], reference)
            if found is None:
                unknown[f"{WORDS[kind[0]]} C{kind[3:]} against C{reference}"] += 1
            known = _against_combination(kind, biases, slot) if apart else 0.0
            values[i] = (found or 0.0) + known, _other_band(kind, biases) if slot and not apart else 0.0
        out.append(SPEED_OF_LIGHT_MPS * values[inverse])
    notes += [f"no code bias of {what} ({n} satellites): taken as 0" for what, n in unknown.items()]
    common = out[0][:, 1] + out[1][:, 1]
    return out[0][:, 0] + common, out[1][:, 0] + common


def _against_combination(kind: str, biases: CodeBiases | None, slot: int) -> float:
    """Return by how much one of the clocks' two codes is longer than their combination, s."""
    one, two = CLOCK_SIGNALS[kind[0]]
    between = biases.difference_s(kind[:3], one, two) if biases is not None else None
    gamma = (frequency_hz(kind[0], one, 0) / frequency_hz(kind[0], two, 0)) ** 2
    return (between or 0.0) * (gamma if slot else 1.0) / (1.0 - gamma)


def _other_band(kind: str, biases: CodeBiases | None) -> float:
    """Return by how much the clocks' own codes, combined for the band of a second code, are longer, s."""
    one, two = CLOCK_SIGNALS[kind[0]]
    if biases is None or kind[3] == two[0]:
        return 0.0
    apart = biases.difference_s(kind[:3], one, two) or 0.0
    f1, f2, reference = (frequency_hz(kind[0], name, 0) for name in (one, kind[3:], two))
    return apart * (1.0 / ((f1 / f2) ** 2 - 1.0) - 1.0 / ((f1 / reference) ** 2 - 1.0))
