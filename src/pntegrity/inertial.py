"""The inertial side of a run: what the configuration says of it, and its increments in the epochs."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from pntegrity.errors import InputError
from pntegrity.estimators._gnss import GnssOptions
from pntegrity.estimators._ins_alignment import COURSE_MPS, COURSE_SIGMA
from pntegrity.estimators._ins_options import Coupling, Detection, InsOptions
from pntegrity.estimators._usual import MONITORS
from pntegrity.estimators.gnss_ins import GnssIns
from pntegrity.formats._source import read_text
from pntegrity.formats.fixes import POSITION_KEYS, VELOCITY_KEYS, read_fixes
from pntegrity.formats.imu_table import mounting, read_imu
from pntegrity.kernels.factor_set import FactorSet
from pntegrity.kernels.lag import Felt, Lag, find_lag
from pntegrity.physics.frames import enu_rotation
from pntegrity.physics.time import SECOND_NS, from_iso
from pntegrity.records import Epoch, FloatArray, Inertial, Observation
from pntegrity.sensors.imu_spec import read_imu_spec
from pntegrity.sensors.increments import with_increments
from pntegrity.sensors.snapshot import snapshot
from pntegrity.vehicle import check_clocks, sources_of

__all__ = [
    "InertialConfig",
    "estimate_lag",
    "fixes_of",
    "read_factors",
    "usual_monitors",
    "with_course",
    "with_imu",
]

ESTIMATOR = "gnss_ins"
#: The estimator that takes any sources beside the unit.
VEHICLE = "multi_source"
#: What only this estimator uses; a value that is none of these says that it is wanted.
UNUSED: dict[str, tuple[Any, ...]] = {
    "imu": (None,), "fixes": (None,), "factors": (None,), "heading_deg": (None,), "coupling": (None,),
    "zupt": (False,), "lever_arm_m": ((0.0, 0.0, 0.0),), "fix_velocity": (True,),
    "fix_velocity_lag_s": (0.0,),
    "source": ((),),
}  # fmt: skip
#: A lag is believed where this much of the accelerations is explained, and its standard deviation is at most
#: this, s; lags are looked for up to `MOST_LAG_S`.
LEAST_CORRELATION, MOST_SIGMA_S, MOST_LAG_S = 0.6, 0.1, 1.0
#: Positions tell the lag where the accelerations that they give are better than this, m/s^2: a receiver's
#: velocities may be late themselves.
POSITIONS_MPS2 = 1.0
#: A vehicle's usual acceleration: what a velocity of two positions does not know of its end, m/s^2.
USUAL_MPS2 = 1.0

Finite = Annotated[float, Field(allow_inf_nan=False)]
Triple = tuple[Finite, Finite, Finite]


class InertialConfig(BaseModel):
    """What a run is told of its inertial measurement unit; see ``docs/formats/imu.md``.

    `imu` is the table; `imu_spec` names a specification or its file; `lever_arm_m` leads from the unit to the
    antenna, forward, right, down; `imu_axes` and `imu_mount_deg` say how the unit is mounted; `imu_lag_s` by
    how much its stamps are late, or ``"auto"``; `imu_start` when second 0 of bare seconds was. `coupling` is
    tight but where `fde` works on fixes, or `fixes` take the place of observations; `fix_floor_m` and
    `fix_floor_mps` are the smallest sigmas that are believed of these; `fix_velocity_lag_s` says by how much
    their velocities are late, `fix_velocity` whether these are used at all. `factors` is a file that
    ``train-factors`` wrote. `source` describes the sources of ``multi_source``, a table each: `type`, `name`,
    `file` and the fields of the type.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    imu: Path | None = None
    imu_spec: str = "stim300"
    lever_arm_m: Triple = (0.0, 0.0, 0.0)
    imu_axes: str = "x,y,z"
    imu_mount_deg: Triple = (0.0, 0.0, 0.0)
    imu_lag_s: Annotated[float, Field(ge=-10.0, le=10.0)] | Literal["auto"] = 0.0
    imu_start: str | None = None
    coupling: Coupling | None = None
    fde: Detection = "ours"
    fixes: Path | None = None
    fix_floor_m: float = Field(0.0, ge=0.0, allow_inf_nan=False)
    fix_floor_mps: float = Field(0.0, ge=0.0, allow_inf_nan=False)
    fix_velocity: bool = True
    fix_velocity_lag_s: float = Field(0.0, ge=-2.0, le=2.0)
    heading_deg: float | None = Field(None, ge=-360.0, le=360.0)
    zupt: bool = False
    factors: Path | None = None
    source: tuple[dict[str, Any], ...] = ()

    def used_coupling(self) -> Coupling:
        """Return the coupling: as given, or what goes with fixes and with the detection."""
        on_fixes = self.fixes is not None or self.fde in ("factor-set", "lsr")
        return self.coupling or ("loose" if on_fixes else "tight")

    def check_inertial(self, estimator: str) -> None:
        """Refuse what nothing would use, and what cannot be.

        Raises
        ------
        ValueError
            Naming the field.
        """
        if estimator == VEHICLE:
            self._check_vehicle()
            return
        wanted = [name for name, unused in UNUSED.items() if getattr(self, name) not in unused]
        wanted += ["fde"] if self.fde != "ours" else []
        if self.source:
            raise ValueError(f"`source` goes with --estimator {VEHICLE}, not {estimator}")
        if estimator != ESTIMATOR and wanted:
            raise ValueError(f"`{wanted[0]}` goes with --estimator {ESTIMATOR}, not {estimator}")
        if estimator != ESTIMATOR:
            return
        if self.imu is None:
            raise ValueError(
                f"--estimator {ESTIMATOR} needs an inertial measurement unit: give its table (--imu)"
            )
        if self.fixes is not None and self.used_coupling() == "tight":
            raise ValueError("`fixes` have no pseudoranges: they go with loose coupling")
        if self.fixes is not None and self.fde in ("factor-set", "lsr"):
            raise ValueError(f"`fde` {self.fde} tests pseudoranges: it does not go with `fixes`")
        if self.factors is not None and self.fde != "factor-set":
            raise ValueError(
                "`factors` are thresholds of factor-set detection: they go with --fde factor-set"
            )
        self._check_mounting()
        InsOptions(lever_arm_m=self.lever_arm_m, coupling=self.used_coupling(), fde=self.fde)

    def _check_vehicle(self) -> None:
        """Refuse a vehicle that cannot be: no unit, no source, or a source that is not right."""
        if self.imu is None:
            raise ValueError(
                f"--estimator {VEHICLE} needs an inertial measurement unit: give its table (--imu)"
            )
        if not self.source:
            raise ValueError(
                f"--estimator {VEHICLE} needs sources: a [[source]] table each, in --config FILE"
            )
        given = [n for n in ("fixes", "factors", "coupling") if getattr(self, n) is not None]
        if given:
            raise ValueError(f"`{given[0]}` goes with --estimator {ESTIMATOR}, not {VEHICLE}")
        self._check_mounting()
        sources_of(self.source)

    def _check_mounting(self) -> None:
        mounting(self.imu_axes, self.imu_mount_deg)
        self.origin_ns()

    def origin_ns(self) -> int | None:
        """Return the GPS time of second 0 of bare seconds, None where it is not told."""
        if self.imu_start is None:
            return None
        try:
            return from_iso(self.imu_start)
        except ValueError:
            raise ValueError(f"`imu_start` {self.imu_start!r} is no time like 2025-07-08T19:34:00") from None

    def ins_options(self, variant: Literal["exact", "published"] = "exact") -> InsOptions:
        """Return the options of the estimator's inertial side.

        Raises
        ------
        InputError
            A specification or thresholds that cannot be read.
        """
        factors = FactorSet(variant=variant) if self.factors is None else read_factors(self.factors, variant)
        return InsOptions(
            spec=read_imu_spec(self.imu_spec), lever_arm_m=self.lever_arm_m, coupling=self.used_coupling(),
            fde=self.fde, factors=factors,
            heading_rad=None if self.heading_deg is None else float(np.deg2rad(self.heading_deg)),
            zero_velocity=self.zupt,
        )  # fmt: skip


def read_factors(path: Path, variant: Literal["exact", "published"] = "exact") -> FactorSet:
    """Return the options of factor-set detection in the table ``[factors]`` of a file.

    Raises
    ------
    InputError
        No such file or table, an unknown name, a value that is no positive number, or thresholds of the other
        variant.
    """
    hint = "Write one with `pntegrity train-factors`"
    try:
        table = tomllib.loads(read_text(path)).get("factors")
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"is not TOML: {error}", path=path, hint=hint) from None
    if not isinstance(table, dict):
        raise InputError("has no [factors] table", path=path, hint=hint)
    numbers = {f.name: int if f.name == "window" else float for f in fields(FactorSet) if f.name != "variant"}
    values = {k: v for k, v in table.items() if k != "variant"}
    if table.get("variant", variant) != variant:
        raise InputError(
            f"[factors] are thresholds of the variant {table['variant']!r}, not {variant!r}", path=path,
            hint=f"Give --variant {table['variant']}, or train them with the other",
        )  # fmt: skip
    for name, value in values.items():
        if name not in numbers:
            raise InputError(
                f"[factors] has the unknown name {name!r}", path=path, hint=f"Known: {', '.join(numbers)}"
            )
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value < np.inf:
            raise InputError(
                f"[factors] {name} must be a positive number, not {value!r}", path=path, hint=hint
            )
    known: dict[str, Any] = {"variant": variant} | {
        name: numbers[name](value) for name, value in values.items()
    }
    return FactorSet(**known)


def fixes_of(config: InertialConfig, notes: list[str]) -> tuple[Epoch, ...]:
    """Return the epochs of a receiver's own fixes; where these have no velocities, those that begin have one
    of their positions.
    """
    assert config.fixes is not None
    epochs = read_fixes(
        config.fixes, origin_ns=config.origin_ns(), sigma_floor_m=config.fix_floor_m,
        sigma_floor_mps=config.fix_floor_mps, velocity=config.fix_velocity,
        velocity_lag_s=config.fix_velocity_lag_s, notes=notes,
    )  # fmt: skip
    return epochs if any(len(e.observations[0].keys) == 6 for e in epochs) else with_course(epochs)


def usual_monitors(estimator: str, values: dict[str, Any]) -> tuple[str, ...] | None:
    """Return the monitors that suit the fixes of a run, None where it has none: a fix is one group, which
    nothing beside it in the same epoch can contradict.
    """
    return MONITORS if estimator == ESTIMATOR and values.get("fixes") else None


def with_course(epochs: Sequence[Epoch]) -> tuple[Epoch, ...]:
    """Return fixes without velocities so that an alignment can start: with a velocity from two positions, up
    to the first that is fast enough to tell a course, and again after a gap in which a filter starts anew.

    Further ones would only count positions twice.
    """
    out: list[Epoch] = []
    waiting = True
    for i, epoch in enumerate(epochs):
        waiting |= i > 0 and (epoch.t_ns - epochs[i - 1].t_ns) * 1e-9 > GnssIns.max_gap_s
        found = _moved(epochs, i) if waiting else None
        if found is not None:
            fix, sigma = found
            epoch = replace(epoch, observations=(fix,))
            waiting = float(np.linalg.norm(fix.y[3:])) <= max(COURSE_MPS, COURSE_SIGMA * sigma)
        out.append(epoch)
    return tuple(out)


def _moved(epochs: Sequence[Epoch], i: int) -> tuple[Observation, float] | None:
    """Return a fix with the mean velocity since an earlier one, and its standard deviation.

    The earlier one is as long ago as makes the least of both errors: those of the positions over the time,
    and half of an acceleration times the time.
    """
    fix = epochs[i].observations[0]
    assert fix.sigma is not None
    noise = float(np.sqrt(np.mean(fix.sigma**2)))
    span_ns = round(np.sqrt(np.sqrt(8.0) * noise / USUAL_MPS2) * SECOND_NS)
    j = i - 1
    while j > 0 and epochs[i].t_ns - epochs[j].t_ns < span_ns:
        j -= 1
    dt = (epochs[i].t_ns - epochs[j].t_ns) * 1e-9
    if j < 0 or dt > MOST_LAG_S + 2e-9 * span_ns:
        return None
    before = epochs[j].observations[0]
    cov = np.zeros((6, 6))
    cov[:3, :3] = fix.aux["cov"]
    cov[3:, 3:] = (fix.aux["cov"] + before.aux["cov"]) / dt**2 + (0.5 * USUAL_MPS2 * dt) ** 2 * np.eye(3)
    y = np.concatenate([fix.y, (fix.y - before.y) / dt])
    keys = POSITION_KEYS + VELOCITY_KEYS
    told = replace(fix, keys=keys, y=y, sigma=np.sqrt(np.diagonal(cov)), aux={"cov": cov})
    return told, float(np.sqrt(np.trace(cov[3:, 3:]) / 3.0))


def with_imu(
    config: InertialConfig, epochs: Sequence[Epoch], options: GnssOptions, notes: list[str]
) -> tuple[Epoch, ...]:
    """Return the epochs with the increments since the epoch before.

    Parameters
    ----------
    config : InertialConfig
    epochs : sequence of Epoch
    options : GnssOptions
        For the velocities that tell the lag, where it is ``"auto"``.
    notes : list of str
        Gets what was dropped or estimated.

    Raises
    ------
    InputError
        A table that cannot be used, no time in common with the epochs, or a lag that cannot be told.
    """
    assert config.imu is not None
    auto = config.imu_lag_s == "auto"
    whole = read_imu(
        config.imu, lag_s=0.0 if config.imu_lag_s == "auto" else config.imu_lag_s, axes=config.imu_axes,
        mount_deg=config.imu_mount_deg, origin_ns=config.origin_ns(), notes=notes,
    )  # fmt: skip
    if auto:
        whole = _without_lag(whole, estimate_lag(whole, epochs, options, notes), config.imu, notes)
    if config.source:
        check_clocks(config.source, epochs, whole.t_ns, config.imu, notes)
    try:
        return with_increments(epochs, whole)
    except ValueError as error:
        hint = "Both must be in GPS time (not UTC) and of the same day; bare seconds begin at --imu-start"
        raise InputError(str(error), path=config.imu, hint=hint) from None


def _without_lag(whole: Inertial, lag: Lag | None, path: Path, notes: list[str]) -> Inertial:
    good = lag is not None and lag.correlation >= LEAST_CORRELATION and lag.sigma_s <= MOST_SIGMA_S
    if lag is None or not good or abs(lag.lag_s) > MOST_LAG_S - MOST_SIGMA_S:
        found = ""
        if lag is not None:
            best = f"the best is {lag.lag_s:.2f} s +- {lag.sigma_s:.2f} s"
            found = f": {best}, which explains {lag.correlation:.2f} of what moves"
        raise InputError(
            f"the lag of its stamps cannot be told from the motion{found}", path=path,
            hint="Give it with --imu-lag-s SECONDS; see whether units and axes (--imu-axes) are right",
        )  # fmt: skip
    notes.append(
        f"{path.name}: stamps are {lag.lag_s:.3f} s late (+- {lag.sigma_s:.3f} s; correlation "
        f"{lag.correlation:.2f}), by comparison with the motion of the antenna"
    )
    return replace(whole, t_ns=whole.t_ns - round(lag.lag_s * SECOND_NS))


def estimate_lag(
    whole: Inertial, epochs: Sequence[Epoch], options: GnssOptions, notes: list[str] | None = None
) -> Lag | None:
    """Return by how much the stamps of an IMU are late, None where the motion does not tell.

    What the unit felt is compared with the accelerations of the antenna: from fixes' positions, where these
    are good enough (centimetres), or else from velocities; see `kernels.lag.find_lag`.

    Parameters
    ----------
    whole : Inertial
        As `read_imu` gives it without a lag.
    epochs : sequence of Epoch
        With fixes, or code and range rates.
    options : GnssOptions
        For snapshots from code and range rates.
    notes : list of str, optional
        Gets a word on velocities of fixes that are late against their positions.
    """
    if not epochs or not len(whole.t_ns):
        return None
    first = epochs[0].t_ns
    felt = Felt(
        np.asarray((whole.t_ns - first) * 1e-9), whole.dt_s, whole.angle_rad[:, 2], whole.velocity_mps[:, :2]
    )
    positions, speeds, noise = _tracks(epochs, options)
    by_speed = _lag_of(felt, epochs, speeds, 1)
    step = np.median(np.diff([e.t_ns for e in epochs])) * 1e-9 if len(epochs) > 1 else 1.0
    if not noise * np.sqrt(6.0) / step**2 <= POSITIONS_MPS2:
        return by_speed
    by_place = _lag_of(felt, epochs, positions, 2)
    if by_place and by_speed and notes is not None:
        late = by_place.lag_s - by_speed.lag_s
        if abs(late) > 3.0 * np.hypot(by_place.sigma_s, by_speed.sigma_s):
            notes.append(
                f"velocities of the fixes are {late:.2f} s late against their positions: take that times the "
                "usual acceleration for their smallest sigma (--fix-floor-mps)"
            )
    return by_place or by_speed


def _lag_of(felt: Felt, epochs: Sequence[Epoch], track: FloatArray, order: int) -> Lag | None:
    there = np.isfinite(track).all(axis=1)
    t_s = np.array([e.t_ns - epochs[0].t_ns for e in epochs])[there] * 1e-9
    return find_lag(felt, np.asarray(t_s), track[there], order, MOST_LAG_S)


def _tracks(epochs: Sequence[Epoch], options: GnssOptions) -> tuple[FloatArray, FloatArray, float]:
    """Return positions and velocities, north and east, shapes (n, 2), nan where there are none, and the
    standard deviation that fixes state for their positions; inf for snapshots.
    """
    both = [_from_fix(e) or _from_sources(e, options) or _from_snapshot(e, options) for e in epochs]
    place = np.array([p for p, _, _ in both])
    known = place[np.isfinite(place).all(axis=1)]
    if not len(known):
        return np.full((len(both), 2), np.nan), np.full((len(both), 2), np.nan), np.inf
    north_east = enu_rotation(known[0])[[1, 0]]
    speed = np.array([v for _, v, _ in both])
    noise = float(np.median([s for _, _, s in both]))
    return (place - known[0]) @ north_east.T, speed @ north_east.T, noise


Motion = tuple[FloatArray, FloatArray, float]


def _from_fix(epoch: Epoch) -> Motion | None:
    fix = epoch.sensor("fix")
    if fix is None or fix.sigma is None:
        return None
    row = dict(zip(fix.keys, fix.y.tolist(), strict=True))
    place = np.array([row.get(k, np.nan) for k in POSITION_KEYS])
    return place, np.array([row.get(k, np.nan) for k in VELOCITY_KEYS]), float(fix.sigma[:3].max())


def _from_sources(epoch: Epoch, options: GnssOptions) -> Motion | None:
    """Return what the first source that tells a position says of it."""
    for source in options.sources:
        said, told = epoch.sensor(source.name), getattr(source, "position", None)
        found = told(said) if said is not None and len(said.keys) and told is not None else None
        if found is not None:
            place, speed, cov = found
            sigma = float(np.sqrt(np.diag(cov)[:3].max()))
            return place, np.full(3, np.nan) if speed is None else speed, sigma
    return None


def _from_snapshot(epoch: Epoch, options: GnssOptions) -> Motion:
    nothing = np.full(3, np.nan)
    if epoch.sensor("code") is None or epoch.sensor("doppler") is None:
        return nothing, nothing, np.inf
    fix = snapshot(epoch, options, np.zeros(3))
    speed = nothing if fix.reason or fix.velocity_mps is None else fix.velocity_mps
    return (nothing if fix.reason else fix.position_m), speed, np.inf
