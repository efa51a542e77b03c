"""Satellites as a source: raw pseudoranges and range rates of one receiver, without its clock as a state."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
import numpy.typing as npt
from scipy.linalg import block_diag

from pntegrity.kernels.linear import inverse_definite
from pntegrity.kernels.rotations import skew
from pntegrity.physics.signals import WORDS
from pntegrity.physics.tables import Klobuchar
from pntegrity.records import Epoch, FloatArray, Observation, group_of
from pntegrity.sensors._acoustic import check_positive, variances, vector
from pntegrity.sensors.noise import NoiseModel
from pntegrity.sensors.pseudoranges import Rows, code_rows, rate_rows, system_of
from pntegrity.sensors.snapshot import Fix, snapshot
from pntegrity.sensors.source import Nuisance, Pose, SourceRows
from pntegrity.states import sensor_of

__all__ = ["OFFSET_M", "OFFSET_MPS", "Gnss"]

#: Standard deviations of what the rows of a constellation, and all range rates, may share: m, m/s.
OFFSET_M, OFFSET_MPS = 1e4, 1e3


@dataclass(frozen=True, eq=False)
class Gnss:
    """Pseudoranges (m) and range rates (m/s) of satellites, one signal a satellite.

    Rows are ``"gnss:R.G05"`` and ``"gnss:D.G05"``. The receiver's clock, the biases between constellations
    and the clock's drift are no states: the rows of a constellation, and all range rates, share an offset
    that is new at each epoch, ``R = diag(sigma^2) + c^2 1 1^T``. This is what is left of a clock state with
    the prior variance ``c^2`` when it is integrated out, and exact for a clock of which nothing is known from
    one epoch to the next; with ``c`` far above all else a common value of the rows does not count, so their
    median is taken off first. A clock that is known to be steady would tell more, where satellites are few:
    `estimators.gnss_ins` has clock states.

    What an observation of it needs in `aux`: ``sv_pos_m``, ``sv_vel_mps``, ``sv_clk_m``, ``sv_clk_rate_mps``,
    ``freq_hz``, ``iono_factor``, ``cn0_dbhz`` (nan where it is not known).

    Parameters
    ----------
    name : str
    mask_deg : float
        Elevation mask.
    doppler : bool
        Whether range rates are used.
    lever_arm_m : sequence of float
        From the IMU to the antenna, forward, right, down.
    sigma_m, sigma_mps : float
        Standard deviations of a pseudorange and of a range rate at the zenith with a strong signal, where the
        observation declares none. They count as white from epoch to epoch.
    slow_sigma_m : float
        The part of a pseudorange's error that depends on elevation only, up to three times this near the
        horizon: orbit, clock, atmosphere.
    cn0_ref_dbhz : float
        Below this C/N0 `sigma_m` and `sigma_mps` grow, tenfold for 20 dB.
    elevation_power : float
        They also grow with this power of ``1 / sin(elevation)``.
    glonass_factor : float
        Errors of GLONASS pseudoranges are larger by this.
    klobuchar : Klobuchar, optional
        Broadcast ionosphere coefficients; the loader takes them from the navigation files.

    Raises
    ------
    ValueError
        Naming the field and what is allowed.
    """

    fitted: ClassVar[tuple[str, ...]] = ("sigma_m", "sigma_mps", "slow_sigma_m")
    name: str = "gnss"
    mask_deg: float = 10.0
    doppler: bool = True
    lever_arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sigma_m: float = 3.0
    sigma_mps: float = 0.15
    slow_sigma_m: float = 1.0
    cn0_ref_dbhz: float = 45.0
    elevation_power: float = 0.0
    glonass_factor: float = 2.0
    klobuchar: Klobuchar | None = None

    def __post_init__(self) -> None:
        check_positive("`sigma_m`", self.sigma_m)
        check_positive("`sigma_mps`", self.sigma_mps)
        for field in ("slow_sigma_m", "cn0_ref_dbhz", "elevation_power"):
            check_positive(f"`{field}`", getattr(self, field), zero=True)
        check_positive("`glonass_factor`", self.glonass_factor)
        if not isinstance(self.mask_deg, int | float) or not -90.0 <= self.mask_deg < 90.0:
            raise ValueError(f"`mask_deg` must be degrees from -90 to below 90, not {self.mask_deg!r}")
        if not isinstance(self.doppler, bool):
            raise ValueError(f"`doppler` must be true or false, not {self.doppler!r}")
        vector("lever_arm_m", self.lever_arm_m)

    @property
    def mask_rad(self) -> float:
        """Elevation mask."""
        return float(np.deg2rad(self.mask_deg))

    @cached_property
    def noise(self) -> NoiseModel:
        """How large the errors of a row are."""
        return NoiseModel(
            code_white_m=self.sigma_m, code_multipath_m=0.0, code_bias_m=self.slow_sigma_m,
            doppler_mps=self.sigma_mps, cn0_ref_dbhz=self.cn0_ref_dbhz, elevation_power=self.elevation_power,
            glonass_factor=self.glonass_factor, bds2_factor=1.0, name=self.name,
        )  # fmt: skip

    def nuisances(self) -> tuple[Nuisance, ...]:
        """Return no states: clocks are in the covariance of the rows."""
        return ()

    def rows(self, observation: Observation, pose: Pose) -> SourceRows:
        """Return the rows of an observation at a predicted pose.

        Parameters
        ----------
        observation : Observation
            Pseudoranges (kind ``R``) and range rates (kind ``D``).
        pose : Pose
        """
        arm = pose.C @ np.asarray(self.lever_arm_m)
        swing = pose.C @ np.cross(pose.rate_radps, self.lever_arm_m)
        place, velocity = pose.position_m + arm, pose.velocity_mps + swing
        sky = _sky(observation)
        code = self._part("R", code_rows(sky, place, self), sky.observations[0])
        rate = self._part("D", rate_rows(sky, place, velocity, self), sky.observations[1])
        H = {
            "pos": np.vstack([-code.los, np.zeros_like(rate.los)]),
            "vel": np.vstack([np.zeros_like(code.los), -rate.los]),
            "att": np.vstack([code.los @ skew(arm), rate.los @ skew(swing)]),
            "bg": np.vstack([np.zeros_like(code.los), -rate.los @ pose.C @ skew(self.lever_arm_m)]),
        }
        reasons = (*code.reasons, *rate.reasons)
        if not code.keys and not rate.keys:
            reasons = (*reasons, f"no satellite above the mask of {self.mask_deg:g} deg")
        return SourceRows(
            code.keys + rate.keys, np.concatenate([code.nu, rate.nu]), H, block_diag(code.R, rate.R),
            "; ".join(dict.fromkeys(reasons)),
        )  # fmt: skip

    def position(self, observation: Observation) -> tuple[FloatArray, FloatArray | None, FloatArray] | None:
        """Return the antenna's position by least squares, its velocity where range rates give one, and the
        covariance of both; None where there is no position.

        Parameters
        ----------
        observation : Observation
        """
        sky = _sky(observation)
        fix = snapshot(sky, self, np.zeros(3))
        if fix.reason:
            return None
        cov = self._spread(sky, fix)
        if fix.velocity_mps is None or fix.velocity_cov is None:
            return fix.position_m, None, cov
        return fix.position_m, fix.velocity_mps, block_diag(cov, fix.velocity_cov)

    def _spread(self, sky: Epoch, fix: Fix) -> FloatArray:
        """Return the covariance of a least-squares position with a clock a constellation."""
        rows = code_rows(sky, fix.position_m, self)
        systems = np.array([system_of(k) for k in rows.keys])
        A = np.hstack([-rows.los, (systems[:, None] == np.unique(systems)).astype(np.float64)])
        A /= self.noise.snapshot_sigma_m(rows.scale, rows.slow)[:, None]
        return inverse_definite(A.T @ A)[:3, :3]

    def _part(self, kind: str, rows: Rows, said: Observation) -> _Part:
        """Return the rows of a kind, less what they share."""
        if kind == "R":
            sigma, offset = self.noise.snapshot_sigma_m(rows.scale, rows.slow), OFFSET_M
            of = [system_of(k) for k in rows.keys]
        else:
            sigma, offset = self.noise.doppler_mps * rows.scale, OFFSET_MPS
            of = [""] * len(rows.keys)
        at = np.array([said.keys.index(k) for k in rows.keys], dtype=np.intp)
        variance = variances(said.select(at), sigma.tolist())
        crowd = Counter(of)
        alone = [k for k, group in zip(rows.keys, of, strict=True) if crowd[group] == 1]
        kept = np.array([crowd[group] > 1 for group in of], dtype=bool)
        rows, groups = rows.select(kept), np.array(of, dtype="U1")[kept]
        together = groups[:, None] == groups
        nu = _centred(rows.y - rows.predicted, groups)
        R = np.diag(variance[kept]) + offset**2 * together
        keys = tuple(f"{self.name}:{kind}.{group_of(k)}" for k in rows.keys)
        return _Part(keys, nu, rows.los, R, tuple(_alone(self.name, kind, k) for k in alone))


@dataclass(frozen=True, eq=False)
class _Part:
    """Rows of one kind."""

    keys: tuple[str, ...]
    nu: FloatArray
    los: FloatArray
    R: FloatArray
    reasons: tuple[str, ...]


def _alone(name: str, kind: str, key: str) -> str:
    among = WORDS.get(system_of(key), "its constellation") if kind == "R" else "the range rates"
    return f"{name}: {group_of(key)} is the only one of {among}: it tells nothing but the receiver's clock"


def _centred(nu: FloatArray, groups: npt.NDArray[np.str_]) -> FloatArray:
    """Return values less the median of their group."""
    out = nu.copy()
    for group in np.unique(groups):
        out[groups == group] -= np.median(nu[groups == group])
    return out


def _sky(o: Observation) -> Epoch:
    """Return what was said as the rows of satellites expect it: codes and range rates apart, keys of
    satellites; what is not finite is not there.
    """
    finite = np.isfinite(o.y) & np.isfinite(o.aux["sv_pos_m"]).all(axis=1)
    parts = []
    for sensor, kind in (("code", "R"), ("doppler", "D")):
        mine = np.array([k.partition(":")[2].startswith(f"{kind}.") for k in o.keys], dtype=bool)
        some = o.select(mine & finite)
        keys = tuple(f"{sensor_of(k)}:{kind}" for k in some.keys)
        parts.append(Observation(sensor, o.t_ns, keys, some.y, some.sigma, some.aux))
    return Epoch(o.t_ns, tuple(parts))
