"""An inertial measurement unit with any number of sources: fixes, ranges, angles, velocities, depths."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators._ins_motion import advance, inertial_prior, with_large_turns
from pntegrity.estimators._ins_solution import Aside, mean_of, with_aside
from pntegrity.estimators._ins_start import align, begun
from pntegrity.estimators._navigation import not_started
from pntegrity.estimators._usual import Usual
from pntegrity.kernels.rotations import rotation
from pntegrity.records import Epoch, FloatArray, Layout, Observation, Prior, State, Update
from pntegrity.sensors.source import Nuisance, Pose, Source, SourceRows, Track
from pntegrity.states import is_left_out

__all__ = ["MultiSource"]

POLICY: Mapping[str, Any] = {
    "keep_rows": 0, "most_excluded": 0.7, "restart_s": float("inf"), "history": 240, "trust_prior": True,
    "identifying": ("source_separation", "sensor_window"), "proof": "trial", "reacquire_s": 60.0,
}  # fmt: skip
#: How long ago a signal may have left, s.
REMEMBERED_S = 12.0
#: What stands for a fix where no source gives one.
NO_FIX = Observation("fix", 0, (), np.zeros(0), aux={"cov": np.zeros((0, 0))})
FIX = ("fix:X", "fix:Y", "fix:Z", "fix:DX", "fix:DY", "fix:DZ")


@dataclass(frozen=True, eq=False)
class Vessel(Aside):
    """What stands beside the mean, and where the vehicle was lately."""

    track: Track | None = None


@dataclass(frozen=True)
class MultiSource(Usual):
    """Error-state filter of an INS that takes the rows of each source as they come.

    What a source measures is told by its type in `sensors`, by how its rows depend on position, velocity,
    attitude, gyroscope bias and states of its own; the filter knows no source by name. Rows
    ``"<source>:<kind>.<sensor>"`` are left out with their source, or with their sensor
    (``"<source>.<sensor>"``).

    Parameters
    ----------
    options : GnssOptions
        `options.sources` are the sources, `options.ins` the inertial side.

    References
    ----------
    Groves (2013), Principles of GNSS, inertial, and multisensor integrated navigation systems, ch. 16.
    """

    max_gap_s: ClassVar[float] = 600.0
    monitors: ClassVar[tuple[str, ...]] = ("source_separation", "sensor_window", "separation")
    monitoring: ClassVar[dict[str, dict[str, Any]]] = {
        "source_separation": {"longest": 80}, "separation": {"pairs": False, "levels": "observed"},
    }  # fmt: skip
    options: GnssOptions = field(default_factory=GnssOptions)

    @property
    def policy(self) -> Mapping[str, Any]:  # type: ignore[override]
        """What suits the pipeline: the INS goes on without any source, and no restart loses the attitude; who
        is named is left out, until a trial has proved it.
        """
        return POLICY

    def predict(self, state: State, epoch: Epoch) -> Prior:
        """Return the prior at `epoch`; an empty one as long as position and attitude are not known."""
        dt = (epoch.t_ns - state.t_ns) * 1e-9
        if not len(state):
            return self._start(state, epoch, ())
        if dt > self.options.max_gap_s or dt <= 0.0:
            event = f"restart after a gap of {dt:.0f} s"
            return self._start(State.empty(state.t_ns), epoch, (event,), len(state))
        moved = with_large_turns(advance(state, epoch.imu, dt, self.options.ins), state, dt)
        aside: Vessel = state.aside
        track = _further(aside.track, epoch.t_ns, moved.position_m, moved.C)
        known = replace(aside, C=moved.C, rate_radps=moved.rate_radps, track=track)
        return inertial_prior(state, moved, known, epoch.t_ns, [n.walk for n in self._nuisances])

    def relax(self, prior: Prior) -> Prior:
        """Return the prior with position and velocity born anew; all else stays known."""
        return begun(prior, "position and velocity started anew") if len(prior.state) else prior

    def correct(self, prior: Prior, epoch: Epoch, exclude: frozenset[str] = frozenset()) -> Update:
        """Use the rows of all sources but for those in `exclude`."""
        if not len(prior.state):
            return not_started(prior)
        found = [s.rows(o, self._pose(prior.state, s)) for s, o in _observed(self.options.sources, epoch)]
        keys = tuple(k for rows in found for k in rows.keys)
        nu, H, R = _stacked(found, prior.state.layout)
        used = np.array([not is_left_out(k, exclude) for k in keys], dtype=bool)
        reason = "" if used.any() else _why(found)
        update = Update.of(
            prior, tuple(k for k, u in zip(keys, used, strict=True) if u), nu[used], H[used],
            R[np.ix_(used, used)], reason=reason,
        )  # fmt: skip
        if not used.all():
            spare = tuple(k for k, u in zip(keys, used, strict=True) if not u)
            names = tuple(n for n in sorted(exclude) if any(is_left_out(k, frozenset([n])) for k in spare))
            update = update.with_spares(
                spare, nu[~used], H[~used], R[np.ix_(~used, ~used)], names, R[np.ix_(~used, used)]
            )
        return with_aside(update, _corrected(update))

    def _start(self, old: State, epoch: Epoch, events: tuple[str, ...], n_old: int = 0) -> Prior:
        """Return the start at a fix of any source that gives one."""
        fixes = (_as_fix(s, o) for s, o in _observed(self.options.sources, epoch))
        fix = next((f for f in fixes if f is not None), NO_FIX)
        loose = replace(self.options, ins=replace(self.options.ins, coupling="loose", fde="none"))
        prior = align(old, replace(epoch, observations=(fix,)), loose, events, n_old)
        return self._with_nuisances(prior, epoch) if len(prior.state) else prior

    def _with_nuisances(self, prior: Prior, epoch: Epoch) -> Prior:
        """Return a start with the sources' own states behind those of the INS."""
        own = self._nuisances
        n, m = len(prior.state), len(own)
        layout = Layout((*prior.state.layout.names, *(x.name for x in own)))
        P = np.zeros((n + m, n + m))
        P[:n, :n] = prior.state.P
        P[range(n, n + m), range(n, n + m)] = [x.sigma**2 for x in own]
        aside: Aside = prior.state.aside
        mean = np.concatenate([prior.state.mean, np.zeros(m)])
        track = _further(None, epoch.t_ns, mean[:3], aside.C)
        vessel = Vessel(aside.C, aside.rate_radps, aside.arm_m, aside.factors, track=track)
        F = np.zeros((n + m, prior.F.shape[1]))
        return replace(prior, state=State(epoch.t_ns, mean, P, layout, vessel), F=F, Q=P)

    @property
    def _nuisances(self) -> tuple[Nuisance, ...]:
        return tuple(n for s in self.options.sources for n in s.nuisances())

    def _pose(self, state: State, source: Source) -> Pose:
        aside: Vessel = state.aside
        assert aside.track is not None
        own = {n.name: float(state.mean[state.layout.index[n.name]]) for n in source.nuisances()}
        return Pose(state.t_ns, state.mean[:3], state.mean[3:6], aside.C, aside.rate_radps, aside.track, own)


def _observed(sources: tuple[Source, ...], epoch: Epoch) -> list[tuple[Source, Observation]]:
    """Return the sources that said something, with what they said."""
    pairs = ((s, epoch.sensor(s.name)) for s in sources)
    return [(s, o) for s, o in pairs if o is not None and len(o.keys)]


def _as_fix(source: Source, observation: Observation) -> Observation | None:
    """Return what a source says of the position as a fix, None where it does not."""
    told = getattr(source, "position", None)
    found = told(observation) if told is not None else None
    if found is None:
        return None
    position, velocity, cov = found
    y = position if velocity is None else np.concatenate([position, velocity])
    return Observation("fix", observation.t_ns, FIX[: len(y)], y, aux={"cov": cov})


def _stacked(found: list[SourceRows], layout: Layout) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return innovations, Jacobian and covariance of all rows."""
    m = sum(len(rows.keys) for rows in found)
    nu, H, R, at = np.zeros(m), np.zeros((m, len(layout))), np.zeros((m, m)), 0
    for rows in found:
        here = slice(at, at + len(rows.keys))
        nu[here], R[here, here] = rows.nu, rows.R
        for block, part in rows.H.items():
            columns = layout.block(block)
            if len(columns):
                H[here, columns] = part
        at = here.stop
    return nu, H, R


def _why(found: list[SourceRows]) -> str:
    return next((rows.reason for rows in found if rows.reason), "no source gave anything to use")


def _corrected(update: Update) -> Vessel:
    """Return what stands beside a posterior: the whole track is put right, by what the update found wrong."""
    state = update.posterior
    aside: Vessel = state.aside
    assert aside.track is not None
    track, step = aside.track, state.mean - update.prior.mean
    age_s = (state.t_ns - track.t_ns) * 1e-9
    position = track.position_m + step[:3] - age_s[:, None] * step[3:6]
    return replace(aside, track=Track(track.t_ns, position, rotation(mean_of(state, "att")) @ track.C))


def _further(track: Track | None, t_ns: int, position_m: FloatArray, C: FloatArray) -> Track:
    """Return the track with one more pose, without what is too long ago."""
    if track is None:
        return Track(np.array([t_ns]), position_m[None], C[None])
    kept = track.t_ns >= t_ns - round(REMEMBERED_S * 1e9)
    return Track(
        np.append(track.t_ns[kept], t_ns), np.vstack([track.position_m[kept], position_m]),
        np.concatenate([track.C[kept], C[None]]),
    )  # fmt: skip
