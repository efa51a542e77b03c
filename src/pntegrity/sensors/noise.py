"""How large the errors of code and range rate are, and how long they last.

Real code errors are not white: a bias a satellite (orbit, clock, atmosphere, inter-frequency), multipath of
some ten seconds, and little white noise. The filter carries the first two as first-order Gauss-Markov states.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import Literal

import numpy as np

from pntegrity.records import FloatArray

#: BDS-2 satellites have numbers up to this one.
LAST_BDS2 = "18"


#: How much more than those of GPS the clocks of other constellations walk.
SATELLITE_CLOCKS = {"G": 1.0, "R": 2.0, "E": 0.33, "C": 0.45, "J": 1.0}


@dataclass(frozen=True)
class NoiseModel:
    """Standard deviations at the zenith, correlation times, and the process noise of motion and clock.

    Parameters
    ----------
    code_white_m, code_multipath_m : float
        Code noise, scaled by ``1 / sin(elevation)`` and by C/N0 (see `scale`).
    code_multipath_tau_s : float
        Correlation time of multipath.
    code_smoothing_tau_s : float
        Time constant of the smoothing that the receiver applies to its code: multipath is then second order.
        Zero: none.
    code_bias_m, code_bias_tau_s : float
        Slow error of a satellite, scaled by ``1 / sin(elevation)`` up to 3 (atmosphere). Zero
        `code_multipath_m` or `code_bias_m`: no such states.
    glonass_factor, bds2_factor : float
        Code errors of GLONASS (lower chip rate, inter-frequency biases) and of BDS-2 (multipath aboard the
        satellite) are larger by these.
    doppler_mps : float
        Range rate noise, scaled like code.
    cn0_ref_dbhz : float
        Below this C/N0 the noise grows, tenfold for 20 dB.
    elevation_power : float
        Noise grows with this power of ``1 / sin(elevation)``; 0 where C/N0 tells all, as in cities.
    accel_mps2 : float
        White acceleration, m/s^2/sqrt(Hz).
    clock_m : float
        Receiver clock, random walk of the phase, m/sqrt(s).
    clock_drift_mps : float
        Receiver clock, random walk of the drift, m/s/sqrt(s).
    isb_m : float
        Inter-system biases, random walk, m/sqrt(s).
    glonass_code_bias_m : float
        A further, constant code bias of each GLONASS satellite (its frequency's path through the receiver).
    carrier_m : float
        White carrier noise at the zenith, scaled like code.
    glonass_carrier_factor : float
        Carrier errors of GLONASS are larger by this.
    ambiguity_m : float
        Ambiguities, random walk, m/sqrt(s): what satellite orbits and clocks, multipath and the atmosphere
        leave in carriers changes slowly, and would make innovations coloured.
    zwd_m, zwd_walk_m : float
        Zenith wet delay: standard deviation at the start about the standard atmosphere's, random walk
        m/sqrt(s).
    gradient_m, gradient_walk_m : float
        Horizontal gradients of the wet delay: standard deviation, random walk m/sqrt(s). Zero `gradient_m`:
        none.
    satellite_clock_m : float
        Random walk of a GPS satellite's clock, m/sqrt(s): what linear interpolation between the samples of
        precise clocks leaves. `SATELLITE_CLOCKS` has the others in its units.
    position_m : float
        How far the position may walk, m/sqrt(s), where the motion is a random walk.
    iono_walk_m : float
        Slant ionosphere delays on the first frequency, random walk, m/sqrt(s).
    product_tau_s : float
        Correlation time of the errors of atmosphere products: each product has a state of its stated standard
        deviation. Zero: their errors are taken for white.
    product_white : float
        White noise of a product beside that state, in units of its stated standard deviation.
    correlated_part, correlated_tau_s : float
        Share of the variance of code and carrier that is correlated over this time, for precise filters: see
        `inflation`.
    satellites : tuple of (str, float, float)
        Satellite, code factor, range-rate or carrier factor (whichever the estimator uses beside code): what
        a calibration found beside the above, at its site and hours.
    factors : tuple of (str, float)
        Multipliers of the monitors' thresholds, from a calibration.
    name : str
        What the reports call the model.
    """

    code_white_m: float = 0.03
    code_multipath_m: float = 0.08
    code_multipath_tau_s: float = 6.0
    code_smoothing_tau_s: float = 0.0
    code_bias_m: float = 1.0
    code_bias_tau_s: float = 36000.0
    glonass_factor: float = 2.0
    bds2_factor: float = 2.0
    doppler_mps: float = 0.01
    cn0_ref_dbhz: float = 35.0
    elevation_power: float = 1.0
    accel_mps2: float = 2.0
    clock_m: float = 0.05
    clock_drift_mps: float = 0.05
    isb_m: float = 0.001
    glonass_code_bias_m: float = 0.0
    carrier_m: float = 0.003
    glonass_carrier_factor: float = 1.5
    ambiguity_m: float = 2e-4
    zwd_m: float = 0.2
    zwd_walk_m: float = 1e-4
    gradient_m: float = 0.0
    gradient_walk_m: float = 1e-5
    satellite_clock_m: float = 2.5e-3
    position_m: float = 1.0
    iono_walk_m: float = 1e-3
    product_tau_s: float = 1800.0
    product_white: float = 0.1
    correlated_part: float = 0.0
    correlated_tau_s: float = 60.0
    satellites: tuple[tuple[str, float, float], ...] = ()
    factors: tuple[tuple[str, float], ...] = ()
    name: str = "default"

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if f.type == "float" and not (
                isinstance(value, int | float) and np.isfinite(value) and value >= 0.0
            ):
                raise ValueError(f"noise model: `{f.name}` must be a number of at least 0, not {value!r}")
        for tau in ("code_multipath_tau_s", "code_bias_tau_s"):
            if getattr(self, tau) <= 0.0:
                raise ValueError(f"noise model: `{tau}` must be above 0, not {getattr(self, tau)}")
        if self.correlated_part > 1.0:
            raise ValueError(f"noise model: `correlated_part` must be at most 1, not {self.correlated_part}")
        if self.product_tau_s > 0.0 and self.product_white <= 0.0:
            raise ValueError("noise model: `product_white` must be above 0 where products are correlated")
        if self.code_smoothing_tau_s == self.code_multipath_tau_s:
            raise ValueError("noise model: `code_smoothing_tau_s` must differ from `code_multipath_tau_s`")
        for name in ("code_white_m", "doppler_mps", "carrier_m"):
            if getattr(self, name) <= 0.0:
                raise ValueError(f"noise model: `{name}` must be above 0, not {getattr(self, name)}")

    def factor(self, monitor: str) -> float:
        """Return the threshold factor of a monitor, 1 where none was calibrated."""
        return dict(self.factors).get(monitor, 1.0)

    def scale(self, el_rad: FloatArray, cn0_dbhz: FloatArray) -> FloatArray:
        """Return how much larger than at the zenith the noise is: ``1/sin el``, and more below the reference
        C/N0.
        """
        low = np.fmax(self.cn0_ref_dbhz - cn0_dbhz, 0.0)  # of nan and 0 this is 0
        low_sky = np.sin(np.maximum(el_rad, np.deg2rad(3.0))) ** self.elevation_power
        return np.asarray(10.0 ** (low / 20.0) / low_sky)

    def obliquity(self, el_rad: FloatArray) -> FloatArray:
        """Return by how much the slow errors are larger than at the zenith."""
        return np.asarray(np.minimum(1.0 / np.sin(np.maximum(el_rad, 0.1)), 3.0))

    def code_factor(self, keys: tuple[str, ...]) -> FloatArray:
        """Return by how much the fast code errors of the rows' satellites are larger than those of GPS, shape
        (n,).
        """
        return _code_factor(keys, self.glonass_factor, self.bds2_factor, self.satellites)

    def bias_factor(self, keys: tuple[str, ...]) -> FloatArray:
        """Return by how much the biases of the rows' constellations are larger than those of GPS, shape (n,).

        What a calibration finds of single satellites is not in it: a log is too short to show how large a
        bias may be.
        """
        return _code_factor(keys, self.glonass_factor, self.bds2_factor, ())

    def rate_factor(self, keys: tuple[str, ...]) -> FloatArray:
        """Return by how much the range-rate or carrier errors of the rows' satellites are larger, shape
        (n,).
        """
        return _rate_factor(keys, self.satellites)

    def carrier_factor(self, keys: tuple[str, ...]) -> FloatArray:
        """Return by how much the carrier errors of the rows' satellites are larger than those of GPS, shape
        (n,).
        """
        return _carrier_factor(keys, self.glonass_carrier_factor, self.satellites)

    def satellite_clock_factor(self, keys: tuple[str, ...]) -> FloatArray:
        """Return how much more than those of GPS the clocks of the rows' satellites walk, shape (n,)."""
        return _by_system(keys)

    def inflation(self, dt: float) -> float:
        """Return by how much the variance of code and carrier must grow for a filter that takes it for white,
        where the satellite was seen `dt` seconds before: ``1 - f + f max(1, 2 tau / dt)``.

        A mean over a long time of errors that are correlated over ``tau`` is as good as one of white errors
        of ``2 tau / dt`` times their variance.
        """
        f = self.correlated_part
        return 1.0 - f + f * max(1.0, 2.0 * self.correlated_tau_s / dt)

    def snapshot_sigma_m(self, scale: FloatArray, slow: FloatArray) -> FloatArray:
        """Return the total standard deviation of a code row, for a solver without error states.

        Parameters
        ----------
        scale, slow : ndarray, shape (n,)
            `scale` times `code_factor`, and `obliquity` times `bias_factor`.
        """
        fast = np.hypot(self.code_white_m, self.code_multipath_m)
        return np.asarray(np.hypot(fast * scale, self.code_bias_m * slow))


@lru_cache(maxsize=512)
def _by_system(keys: tuple[str, ...]) -> FloatArray:
    return np.array([SATELLITE_CLOCKS.get(k[0], 1.0) for k in keys])


@lru_cache(maxsize=512)
def _code_factor(
    keys: tuple[str, ...], glonass: float, bds2: float, satellites: tuple[tuple[str, float, float], ...]
) -> FloatArray:
    own = {sat: code for sat, code, _ in satellites}
    family = [glonass if k[0] == "R" else bds2 if k[0] == "C" and k[1:3] <= LAST_BDS2 else 1.0 for k in keys]
    return np.array([f * own.get(k[:3], 1.0) for f, k in zip(family, keys, strict=True)])


@lru_cache(maxsize=512)
def _rate_factor(keys: tuple[str, ...], satellites: tuple[tuple[str, float, float], ...]) -> FloatArray:
    own = {sat: rate for sat, _, rate in satellites}
    return np.array([own.get(k[:3], 1.0) for k in keys])


@dataclass(frozen=True)
class Fitted:
    """A parameter of the noise model that a calibration fits.

    Parameters
    ----------
    name : str
        Field of `NoiseModel`.
    low, high : float
        The range it may take.
    start : float, optional
        Where the fit starts; None: where the model stands. A far start may end in a random walk of biases
        that explains everything.
    kind : str
        ``"white"``: size of white noise of rows, ``"slow"``: size of errors that last; a white model has none
        of these. ``""``: any other.
    size : str
        Of a correlation time the field that holds the size: it is scaled along, at equal drive.
    rows : str
        Whose errors it is the size of, ``"code"`` or ``"carrier"``, where a calibration shall raise them all
        to bound the tails; ``""``: neither.
    """

    name: str
    low: float
    high: float
    start: float | None = None
    kind: Literal["white", "slow", ""] = ""
    size: str = ""
    rows: Literal["code", "carrier", ""] = ""


@lru_cache(maxsize=512)
def _carrier_factor(
    keys: tuple[str, ...], glonass: float, satellites: tuple[tuple[str, float, float], ...]
) -> FloatArray:
    family = np.array([glonass if k[0] == "R" else 1.0 for k in keys])
    return np.asarray(family * _rate_factor(keys, satellites))


#: A white model: no correlated states; what the simulations of the literature assume.
WHITE = NoiseModel(code_white_m=1.0, code_multipath_m=0.0, code_bias_m=0.0, doppler_mps=0.1, name="white")

#: What precise point positioning starts from: ionosphere-free code and carrier of a geodetic receiver, a
#: little
#: above what two of them show.
PPP = NoiseModel(
    code_white_m=0.8, code_multipath_m=0.0, code_bias_m=0.9, code_bias_tau_s=300.0, glonass_code_bias_m=4.0,
    carrier_m=0.002, ambiguity_m=3e-4, isb_m=0.001, satellite_clock_m=0.007, name="default",
)  # fmt: skip

#: What uncombined PPP-RTK starts from. On real logs slant delays walk about 3 mm/sqrt(s): with a third of it
#: positions are centimetres to decimetres off, and the filter does not know.
PPP_RTK = NoiseModel(
    code_white_m=0.3, code_multipath_m=0.0, code_bias_m=0.0, glonass_code_bias_m=4.0, carrier_m=0.003,
    ambiguity_m=3e-5, isb_m=0.001, satellite_clock_m=0.007, zwd_walk_m=1e-4, iono_walk_m=3e-3,
    product_tau_s=1800.0, correlated_part=0.7, correlated_tau_s=60.0, name="default",
)  # fmt: skip

#: The same as the literature has it: white products, code and carrier, constant ambiguities.
PPP_RTK_PUBLISHED = replace(
    PPP_RTK, ambiguity_m=0.0, product_tau_s=0.0, correlated_part=0.0, name="published"
)

#: What a receiver in a city starts from: multipath is an error of each satellite that lasts a minute, larger
#: where C/N0 is low, at any elevation; what is larger is for the tests. The clock is that of a cheap
#: oscillator.
CITY = NoiseModel(
    code_white_m=0.7, code_multipath_m=1.0, code_multipath_tau_s=60.0, code_bias_m=0.0, doppler_mps=0.05,
    cn0_ref_dbhz=45.0, elevation_power=0.0, bds2_factor=1.0, clock_m=0.1, clock_drift_mps=0.1, isb_m=0.01,
    name="city",
)  # fmt: skip
