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
from pntegrity.imu_lag import MOST_LAG_S, Track, estimate_lag, tracks, without_lag
from pntegrity.kernels.factor_set import FactorSet
from pntegrity.physics.time import SECOND_NS, from_iso
from pntegrity.records import Epoch, Inertial, Observation
from pntegrity.sensors.imu_check import check_level, check_turns
from pntegrity.sensors.imu_spec import read_imu_spec
from pntegrity.sensors.increments import with_increments
from pntegrity.sensors.reach import check_reach
from pntegrity.vehicle import carried_on, check_clocks, sources_of

__all__ = [
    "InertialConfig",
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
    "fix_velocity_lag_s": (0.0,), "imu_axes": ("x,y,z",), "imu_mount_deg": ((0.0, 0.0, 0.0),),
    "source": ((),),
}  # fmt: skip
#: Of these what a vehicle takes as well.
BOTH = ("imu", "imu_axes", "imu_mount_deg", "heading_deg", "zupt", "lever_arm_m")
#: A vehicle's usual acceleration: what a velocity of two positions does not know of its end, m/s^2.
USUAL_MPS2 = 1.0
#: Of so many epochs the track is made that the gyroscopes are compared with.
MOST_PLACES = 2000

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
            others = f" or {VEHICLE}" if wanted[0] in BOTH else ""
            raise ValueError(f"`{wanted[0]}` goes with --estimator {ESTIMATOR}{others}, not {estimator}")
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
    config: InertialConfig, epochs: Sequence[Epoch], options: GnssOptions, notes: list[str],
    end_ns: int | None = None,
) -> tuple[Epoch, ...]:  # fmt: skip
    """Return the epochs with the increments since the epoch before; those of a vehicle with sources also
    where these are silent.

    Parameters
    ----------
    config : InertialConfig
    epochs : sequence of Epoch
    options : GnssOptions
        For the velocities that tell the lag, where it is ``"auto"``.
    notes : list of str
        Gets what was dropped or estimated.
    end_ns : int, optional
        End of the run, for a vehicle that goes on without sources.

    Raises
    ------
    InputError
        A table that cannot be used, angles in another unit than it says, no time in common with the epochs,
        a lag that cannot be told, or a beacon out of the reach of its own sound.
    """
    assert config.imu is not None
    auto = config.imu_lag_s == "auto"
    whole = read_imu(
        config.imu, lag_s=0.0 if config.imu_lag_s == "auto" else config.imu_lag_s, axes=config.imu_axes,
        mount_deg=config.imu_mount_deg, origin_ns=config.origin_ns(), notes=notes,
    )  # fmt: skip
    check_reach(options.sources, epochs)
    track = tracks(epochs, options) if auto and epochs else None
    _check_angles(whole, epochs, options, config.imu, track)
    if auto:
        lag = None if track is None else estimate_lag(whole, epochs, track, notes)
        whole = without_lag(whole, lag, config.imu, notes)
    if config.source:
        check_clocks(config.source, epochs, whole.t_ns, config.imu, notes)
        epochs = carried_on(epochs, whole.t_ns, notes, end_ns)
    try:
        return with_increments(epochs, whole)
    except ValueError as error:
        hint = "Both must be in GPS time (not UTC) and of the same day; bare seconds begin at --imu-start"
        raise InputError(str(error), path=config.imu, hint=hint) from None


def _check_angles(
    whole: Inertial, epochs: Sequence[Epoch], options: GnssOptions, path: Path, track: Track | None
) -> None:
    """Refuse angles in another unit than the table says, where gravity or the track tells it (InputError);
    `track` is that of all epochs, where it is known.
    """
    if not epochs:
        return
    step = 1 + len(epochs) // MOST_PLACES
    some = epochs[::step]
    place, _, sigma_m = tracks(some, options) if track is None else (track[0][::step], *track[1:])
    check_turns(whole, np.array([e.t_ns for e in some], dtype=np.int64), place, sigma_m, path)
    check_level(whole, path)
