"""SRAIME's PPP experiment (Table 3) regenerated: alarms, real false-alarm rates, what could be seen.

The paper prints neither noise nor motion model, nor which satellite and frequency carries the fault. So the
fault goes to each satellite in turn, with many seeds, under three noise models (that of GINav, which the
paper ran, the same with its term for coarse clocks, and this package's), five motion models and both readings
of the frequency. The receiver's observations of that drive are not public: they are simulated, on the real
track under the real orbits where the data folder is given.

References
----------
Yu et al. (2023), A State-Domain Robust Autonomous Integrity Monitoring by Extrapolation Method for Single
Receiver Positioning in the Presence of Slowly Growing Fault, Satellite Navigation.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from pntegrity.records import FloatArray
from pntegrity.scenarios._ppp_runs import (
    VAN,
    Case,
    Experiment,
    monitors_of,
    real_drive,
    simulated_drive,
)
from pntegrity.scenarios._spp_runs import BoolArray, Interval
from pntegrity.scenarios.reproduce_sraime_spp import Result, Row, row

__all__ = ["reproduce"]

READINGS = {"on the ionosphere-free pair": 1.0, "on the first carrier": 2.546}
"""What a metre of fault is on the pair: the first carrier of GPS enters 2.546 times."""
WORDS = {
    "literature": "noise of GINav", "clocked": "noise of GINav with its clock term",
    "ours": "noise of this package",
    "white": "white position", "velocity": "velocity, 0.1 m/s^2", "brisk": "velocity, 0.3 m/s^2",
    "walk": "walk 1 cm/sqrt(s)", "static": "walk 0.1 mm/sqrt(s)",
}  # fmt: skip
PRINTED = {"RCTM": "RCTM", "SRCTM": "SRCTM", "SRAIME": "SRAIME (published), position"}
EXACT = ("SRAIME (exact), position", "SRAIME (exact), ambiguities", "SRAIME (exact), both", "AIME (exact)")
INEXACT = ("SRAIME (published), position", "SRAIME (published), ambiguities")


def reproduce(seeds: int = 20, *, data: Path | None = None, seed: int = 1) -> Result:
    """Run the experiment.

    Parameters
    ----------
    seeds : int
        Runs with different noise of each satellite.
    data : Path, optional
        Folder of the real logs; with it the track, the orbits and the clocks are real.
    seed : int
        Of all random numbers.
    """
    if seeds < 1:
        raise ValueError(f"`seeds` must be at least 1, not {seeds}")
    e = Experiment.load()
    real = data is not None and (data / VAN).is_dir()
    drive = (
        real_drive(data, e["systems"]) if real and data else simulated_drive(e["last_s"] + 1, e["systems"])
    )
    rng = np.random.default_rng(seed)
    note = (
        f"{drive.label}; observations are simulated, since the log is not public; {seeds} seeds a satellite"
    )
    rows = [row("geometry", None, drive.label, None, note)]
    for noise in e.facts["noise"]:
        for motion in e.facts["motion"]:
            label = f"{WORDS[noise]}, {WORDS[motion]}"
            rows += _Runs(Case.of(e, drive, noise, motion), label, seeds, rng).rows()
    rows += [_closest(e, rows, name) for name in PRINTED]
    return Result(tuple(rows), "SRAIME, PPP experiment (Table 3)")


class _Runs:
    """The runs of one case: each satellite in turn at fault, `seeds` noises each."""

    def __init__(self, case: Case, label: str, seeds: int, rng: np.random.Generator) -> None:
        self.case, self.label, self.e = case, label, case.experiment
        keys = case.carriers
        self._noise = case.noise(seeds * len(keys), rng)
        means = zip(*(case.means(k) for k in keys), strict=True)
        self._means = [np.repeat(np.stack(m, axis=1), seeds, axis=1) for m in means]

    def rows(self) -> Iterator[Row]:
        """Yield the rows of the case."""
        for reading in READINGS:
            yield self._printed_row(reading)
        yield self._exact_row()
        yield self._honest_row()
        yield self._bound_row()

    def _white(self, reading: str) -> list[FloatArray]:
        factor = READINGS[reading]
        return [n + factor * m for n, m in zip(self._noise, self._means, strict=True)]

    def _found(self, alarm: BoolArray) -> tuple[list[int], str]:
        """Return first and last alarm, and their share and the false ones in words."""
        before = self.e["onset_s"] - self.e["quiet_s"]
        found = Interval.of(alarm, before)
        false = 100.0 * float(alarm[:before].mean())
        return [
            t + self.e["quiet_s"] for t in found.as_list
        ], f"{100.0 * found.share:.0f} %, {false:.2g} false"

    def _summary(self, alarms: Mapping[str, BoolArray]) -> tuple[dict[str, list[int]], str]:
        found = {name: self._found(alarm) for name, alarm in alarms.items()}
        words = "; ".join(f"{name} {text}" for name, (_, text) in found.items())
        return {
            name: times for name, (times, _) in found.items()
        }, f"runs that alarm, false alarms in 100 s: {words}"

    def _printed_row(self, reading: str) -> Row:
        white, each = self._white(reading), monitors_of(self.e)
        times, note = self._summary({n: self.case.alarms(each[m], white) for n, m in PRINTED.items()})
        printed = self.e.facts["published"]
        ok = all(_near(self.e, times[n], printed[n]) for n in PRINTED)
        return row(f"alarms of the published tests, s: {self.label}, {reading}", printed, times, ok, note)

    def _exact_row(self) -> Row:
        white, each = self._white(next(iter(READINGS))), monitors_of(self.e)
        alarms = {n: self.case.alarms(each[n], white) for n in EXACT}
        times, note = self._summary(alarms | {"GLR": self.case.glr_alarms(white)})
        return row(f"alarms of the exact tests, s: {self.label}", None, times, None, note)

    def _honest_row(self) -> Row:
        """Look at the published statistic's real P_FA, and again with the threshold at which that is the
        nominal.
        """
        white, each, p = self._white(next(iter(READINGS))), monitors_of(self.e), self.e["p_fa"]
        real = {n: self.case.real_p_fa(each[n]) for n in INEXACT}
        times, note = self._summary({n: self.case.alarms(each[n], white, honest=True) for n in INEXACT})
        rates = ", ".join(f"{n} {v:.2g}" for n, v in real.items())
        quantity = f"alarms of the published SRAIME at a real P_FA of {p:g}, s: {self.label}"
        ok = _near(self.e, times[INEXACT[0]], self.e.facts["published"]["SRAIME"])
        return row(
            quantity,
            self.e.facts["published"]["SRAIME"],
            times,
            ok,
            f"real P_FA at nominal {p:g}: {rates}; {note}",
        )

    def _bound_row(self) -> Row:
        case, e = self.case, self.e
        times = [case.bound_s(k) for k in case.carriers]
        seen, half = sorted(t for t in times if t is not None), (len(times) - 1) // 2
        middle = seen[half] if len(seen) > half else None
        first = e.facts["published"]["SRAIME"][0]
        size = 100 * e["slope_m"] * (first - e["onset_s"])
        note = (
            f"median over {len(times)} satellites, {len(seen)} seen at all; matched filter over the "
            "innovations, "
            f"onset and course known, power 0.5; at {first} s the fault is {size:.0f} cm"
        )
        quantity = f"earliest time any test of P_FA {e['p_fa']:g} sees the fault, s: {self.label}"
        return row(quantity, first, middle, middle is not None and middle <= first, note)


def _near(e: Experiment, times: list[int], printed: list[int]) -> bool:
    return len(times) == len(printed) and all(
        abs(a - b) <= e["alarm_s"] for a, b in zip(times, printed, strict=True)
    )


def _closest(e: Experiment, rows: list[Row], name: str) -> Row:
    """Say which settings give the paper's times of one test."""
    printed = e.facts["published"][name]
    quantity = f"settings closest to the printed {name}"
    runs = [r for r in rows if isinstance(r["measured"], dict) and len(r["measured"].get(name, ())) == 2]
    if not runs:
        return row(quantity, printed, None, False, "it alarms nowhere")
    best = min(runs, key=lambda r: sum(abs(a - b) for a, b in zip(r["measured"][name], printed, strict=True)))
    times = best["measured"][name]
    return row(quantity, printed, times, _near(e, times, printed), best["quantity"].partition(": ")[2])
