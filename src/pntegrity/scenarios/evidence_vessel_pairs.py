"""Campaign: sources that are led astray, alone and two together, through the whole chain."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from pntegrity.evaluate.intervals import binomial_interval
from pntegrity.scenarios._real_logs import Row, row
from pntegrity.scenarios._vessel_logs import facts, ship, ship_log
from pntegrity.scenarios._vessel_pipeline import Run, monitors_of, run_log
from pntegrity.scenarios._vessel_rows import finite
from pntegrity.simulate.vessel_log import VesselLog, led_astray, with_faults
from pntegrity.states import source_of

__all__ = ["CAMPAIGN", "vessel_pairs"]

CAMPAIGN = "vessel-pairs"
SEED, RUNS, SECONDS = 7000, 12, 150.0
BEGIN_S, MPS = 60.0, 0.3
WAYS = {"north": (0.0, MPS, 0.0), "east": (MPS, 0.0, 0.0)}
#: A pair is to be out so soon, s.
SOON_S = 3.0


@dataclass(frozen=True, eq=False)
class Astray:
    """Runs of a fault: who is at fault, and until when."""

    name: str
    guilty: frozenset[str]
    end_s: float
    runs: tuple[Run, ...]

    def first(self, run: Run) -> float:
        """Return when the first alarm comes, s after the begin; inf: never while the fault lasts."""
        found = (t for t, o in run.between(BEGIN_S, self.end_s) if o.status == "alert")
        return next(found, float("inf")) - BEGIN_S

    def healthy_out(self, run: Run, certain: bool) -> bool:
        """Tell whether anybody healthy was left out; `certain`: not in doubt."""
        made = (e for _, o in run.between(BEGIN_S, SECONDS) for e in o.exclusions)
        return any(source_of(e.group) not in self.guilty and not (certain and e.doubtful) for e in made)

    def out(self, run: Run, within_s: float) -> frozenset[str]:
        """Return which sources are left out, they or sensors of theirs, soon after the begin."""
        return frozenset(source_of(n) for _, n in run.excluded(BEGIN_S, BEGIN_S + within_s + 1e-6))

    def misled(self, run: Run) -> tuple[int, int]:
        """Return how many epochs are misleading before the first alarm, and from it on."""
        bad: npt.NDArray[np.bool_] = run.beyond()
        begun = run.t_s >= BEGIN_S + self.first(run)
        return int(bad[~begun].sum()), int(bad[begun].sum())

    def settled_s(self, run: Run) -> float:
        """Return how long after the fault's end the last alert is; inf: there is one at the end."""
        last = max((t for t, o in run.between(BEGIN_S, SECONDS) if o.status != "ok"), default=self.end_s)
        return float("inf") if last >= run.t_s[-1] else max(last - self.end_s, 0.0)


def vessel_pairs(data: Path) -> list[Row]:
    """Return the figures of all faults."""
    with threadpool_limits(1, user_api="blas"):
        study, vessel = facts(), ship(SECONDS)
        logs = [ship_log(vessel, SEED + i) for i in range(RUNS)]

        def runs(
            name: str, guilty: Sequence[str], end_s: float, spoilt: Callable[[VesselLog], VesselLog]
        ) -> Astray:
            found = (run_log(vessel, spoilt(log), monitors_of(study)) for log in logs)
            return Astray(name, frozenset(guilty), end_s, tuple(found))

        rows = _pair(runs("GNSS 40 m and LBL 5 ms at once", ("gnss", "lbl"), 80.0, _jumps))
        for way, enu in WAYS.items():
            for source in ("gnss", "lbl"):
                rows += _alone(
                    runs(f"{source} drifts {way}", (source,), 100.0, _drift((source,), enu, 100.0))
                )
            for end_s in (80.0, 100.0):
                both = ("gnss", "lbl")
                name = f"GNSS and LBL drift {way} together for {end_s - BEGIN_S:.0f} s"
                rows += _together(runs(name, both, end_s, _drift(both, enu, end_s)))
        return rows


def _jumps(log: VesselLog) -> VesselLog:
    sky = log.epochs[0].sensor("gnss")
    assert sky is not None
    return with_faults(
        log, [(sky.keys[2], 40.0, 0.0, BEGIN_S, 80.0), ("lbl:R.AP2", 0.005, 0.0, BEGIN_S, 80.0)]
    )


def _drift(
    names: Sequence[str], enu_mps: tuple[float, float, float], end_s: float
) -> Callable[[VesselLog], VesselLog]:
    return lambda log: led_astray(log, names, enu_mps, BEGIN_S, end_s)


def _pair(found: Astray) -> list[Row]:
    share = sum(found.out(r, SOON_S) == found.guilty for r in found.runs) / len(found.runs)
    quantity = f"{found.name}: both left out, and nobody else, within {SOON_S:g} s"
    note = "share of the runs; sensors where these are told"
    return [row(CAMPAIGN, quantity, "at least 0.5", share, share >= 0.5, note=note), *_safe(found)]


def _alone(found: Astray) -> list[Row]:
    right = sum(any(n in found.guilty for n in found.out(r, found.end_s - BEGIN_S)) for r in found.runs)
    healthy = sum(found.healthy_out(r, certain=False) for r in found.runs)
    low, high = binomial_interval(healthy, len(found.runs))
    return [
        row(CAMPAIGN, f"{found.name}: left out, runs", "all", f"{right} of {len(found.runs)}",
            right == len(found.runs), note=_when(found)),
        row(CAMPAIGN, f"{found.name}: runs with a healthy source left out", "at most 0.02",
            healthy / len(found.runs), low <= 0.02, interval=(low, high)),
        *_safe(found),
    ]  # fmt: skip


def _together(found: Astray) -> list[Row]:
    first = np.array([found.first(r) for r in found.runs])
    never = int(np.isinf(first).sum())
    note = f"median of {len(found.runs)} runs, from {first.min():.3g} s on; none before its end in {never}"
    quantity = f"{found.name}: first alarm after, s"
    return [
        row(CAMPAIGN, quantity, "stated", finite(float(np.median(first))), note=note),
        *_safe(found),
    ]


def _safe(found: Astray) -> list[Row]:
    """Return whether a healthy source is blamed for certain, who is misled, and when all is well again."""
    sure = sum(found.healthy_out(r, certain=True) for r in found.runs)
    doubt = sum(found.healthy_out(r, certain=False) for r in found.runs)
    before, after = np.array([found.misled(r) for r in found.runs]).sum(axis=0).tolist()
    again = np.array([found.settled_s(r) for r in found.runs])
    earlier = f"; before the first alarm {before}" if before else ""
    return [
        row(CAMPAIGN, f"{found.name}: a healthy source left out for certain, runs", "0", sure, sure == 0,
            note=f"in doubt in {doubt} of {len(found.runs)}"),
        row(CAMPAIGN, f"{found.name}: misleading epochs from the first alarm on", "0", after, after == 0,
            note=f"of {sum(len(r.outcomes) for r in found.runs)}{earlier}"),
        row(CAMPAIGN, f"{found.name}: last alert after its end, s", "stated",
            finite(float(np.quantile(again, 0.5, method="nearest"))),
            note=f"median; {int(np.isinf(again).sum())} of {len(again)} still in alert "
                 f"{SECONDS - found.end_s:.0f} s after it"),
    ]  # fmt: skip


def _when(found: Astray) -> str:
    times = [
        min((t for t, n in r.excluded(BEGIN_S, found.end_s) if source_of(n) in found.guilty), default=np.inf)
        for r in found.runs
    ]
    low, mid, high = np.quantile(np.array(times) - BEGIN_S, [0.0, 0.5, 1.0], method="nearest")
    return f"after {mid:.3g} s (median; {low:.3g} to {high:.3g}): {MPS * mid:.1f} m"
