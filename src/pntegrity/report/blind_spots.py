"""What a filter and its noise model hide from every monitor, in words, with the figures of the model in
use.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pntegrity.estimators._ins_options import InsOptions
from pntegrity.exclusion import SEPARATION
from pntegrity.protocols import Monitor
from pntegrity.report.units import duration, length
from pntegrity.sensors.noise import NoiseModel

__all__ = ["blind_spots"]

#: Over these times the growth of what walks is told, s.
TIMES_S = (60.0, 600.0, 3600.0)


def blind_spots(
    estimator: str,
    noise: NoiseModel,
    motion: str = "white",
    monitors: Sequence[Monitor] = (),
    ins: InsOptions | None = None,
) -> tuple[str, ...]:
    """Say what the noise model and the estimator hide from every monitor, with figures.

    Parameters
    ----------
    estimator : str
        Name of the estimator.
    noise : NoiseModel
    motion : str
        What the estimator knows of the motion.
    monitors : sequence of Monitor
        Those that run.
    ins : InsOptions, optional
        The inertial side of an estimator that has one; None: the usual.
    """
    if estimator == "spp":
        spots: tuple[str, ...] = (
            "Every epoch stands alone: a fault is seen only by its contradiction to the other satellites of "
            "that epoch.",
        )
    elif estimator in ("ppp", "ppp_rtk"):
        spots = _precise(noise, motion, monitors)
    elif estimator == "gnss_ins":
        spots = _inertial(noise, ins or InsOptions())
    elif estimator == "multi_source":
        spots = SOURCES
    else:
        spots = _code(noise)
    return (*spots, *(_products(noise) if estimator == "ppp_rtk" else ()), *_separation(monitors))


SOURCES = (
    "A source that nothing contradicts is believed: a slow error of the only one that tells a direction "
    "moves "
    "the position with it, as far as the INS does not hold against it.",
    "Errors of a source are taken for white. One that lasts is believed a little more with each measurement, "
    "and the standard deviation becomes too small.",
    "Where all sources are silent the INS carries the position on, and nothing tests it.",
)


def _inertial(noise: NoiseModel, ins: InsOptions) -> tuple[str, ...]:
    """Say what an INS bridges, what its aiding absorbs, and what no test of single rows can see."""
    own = _tight(noise) if ins.coupling == "tight" else _loose(ins)
    return (
        *own,
        "Where GNSS is missing the INS carries the position on, and nothing tests it: an error of the IMU "
        f"that its specification ({ins.spec.name}) does not expect grows unseen until satellites return. Its "
        "standard deviation grows as the specification says and no faster.",
        "An error that most satellites share moves the position: the few good ones are then the ones that "
        "stand out and are left out. A protection level covers what its fault modes name (single satellites, "
        "groups that fail together), not every set of reflected signals.",
    )


def _tight(noise: NoiseModel) -> tuple[str, ...]:
    states = noise.code_multipath_m > 0.0 or noise.code_bias_m > 0.0
    absorbed = (
        "Each satellite has an error of its own that lasts a while. A reflection that comes slowly, or that "
        "was there when the satellite came into view, is taken for it and is not a fault; it moves the "
        "position by what the other satellites and the INS do not hold against it.",
    )
    return (*(absorbed if states else ()), *_code(noise))


def _loose(ins: InsOptions) -> tuple[str, ...]:
    detection = {
        "lsr": "The residuals of the least-squares fix are tested one satellite at a time",
        "factor-set": "Sets of pseudoranges are tested for agreement with each other",
    }
    tested = detection.get(ins.fde, "The rows of the fix are not tested")
    return (
        f"The filter takes fixes. {tested}, without the INS: errors that agree with each other pass, and "
        "their fix is taken with the uncertainty of a good one.",
        "A fix has no error that lasts in the filter's eyes: an error common to several fixes in a row is "
        "believed a little more with each of them, and the standard deviation becomes too small.",
    )


def _products(noise: NoiseModel) -> tuple[str, ...]:
    """Say what is hidden by the bias states of atmosphere products."""
    if noise.product_tau_s > 0.0:
        return (
            "An error of an atmosphere product is taken for its bias, which is expected to be of the stated "
            f"size over {duration(noise.product_tau_s)}: errors of that size and duration are not faults.",
        )
    return (
        "Errors of atmosphere products are taken for white. Those of real products last for minutes: sigmas "
        "and protection levels are then too small.",
    )


def _separation(monitors: Sequence[Monitor]) -> tuple[str, ...]:
    """Say what the comparison of solutions leaves to the protection levels."""
    found = [getattr(m, "levels", "tested") for m in monitors if m.name == SEPARATION]
    if not found:
        return ()
    if found == ["observed"]:
        return (
            "SEPARATION does not alarm here: what a fault moves the position by is in the protection levels, "
            "for the fault modes of the integrity support message and no others.",
        )
    return (
        "SEPARATION sees a fault where it moves the position by more than its thresholds. What moves it less "
        "goes unseen and is covered by the protection levels, for the fault modes of the integrity support "
        "message and no others.",
    )


def _code(noise: NoiseModel) -> tuple[str, ...]:
    spots = []
    if noise.code_bias_m > 0.0:
        rate = noise.code_bias_m * np.sqrt(2.0 / noise.code_bias_tau_s)
        spots.append(
            "A code error that was there when a satellite rose is taken for its bias (sigma "
            f"{noise.code_bias_m:g} m): up to about {3.0 * noise.code_bias_m:.0f} m goes unseen. Slow growth "
            "is "
            f"followed by the bias state, which may walk {length(rate)} in 1 s and "
            f"{length(rate * np.sqrt(60.0))} in 60 s."
        )
    if noise.code_multipath_m > 0.0:
        spots.append(
            f"Multipath is expected ({noise.code_multipath_m:g} m{_grows(noise)} over "
            f"{noise.code_multipath_tau_s:g} s): errors of that size and duration are not faults."
        )
    return (*spots, "An error that all satellites share is the receiver's clock, for every monitor.")


def _grows(noise: NoiseModel) -> str:
    """Say with what multipath grows: with the elevation alone where that is so, else with C/N0."""
    if noise.elevation_power == 0.0:
        return f" at {noise.cn0_ref_dbhz:g} dB-Hz and above, more below,"
    power = "" if noise.elevation_power == 1.0 else f"^{noise.elevation_power:g}"
    return f" / sin(elevation){power}"


def _precise(noise: NoiseModel, motion: str, monitors: Sequence[Monitor]) -> tuple[str, ...]:
    spots = [_at_birth(noise), _growth(noise)]
    blind = [m.name.upper() for m in monitors if getattr(m, "block", "") == "pos"]
    if motion == "white" and blind:
        spots.append(
            f"{' and '.join(blind)} compare the position with its prediction. Under motion 'white' nothing "
            "predicts it: every epoch forgets the position, and slow faults are seen by the other monitors "
            "only. "
            "Where the motion is known, tell it (--motion)."
        )
    return (
        *spots,
        "An error that all satellites share is the receiver's clock; one that a whole constellation shares "
        "is "
        "its inter-system bias, unless it grows faster than "
        f"{length(3.0 * noise.isb_m * np.sqrt(60.0))} in 60 s.",
        "A fault of the carrier alone and one of the whole satellite (orbit, clock) can hardly be told "
        "apart, "
        "as the code is too noisy: it is the satellite that is named, not the kind.",
    )


def _at_birth(noise: NoiseModel) -> str:
    code = 3.0 * noise.code_white_m
    text = (
        "A carrier error that was there when its arc began is in the ambiguity, whatever its size. A "
        "constant "
        f"code error goes unseen up to about 3 sigma of the code, {length(code)} at the zenith and "
        f"{length(2.0 * code)} at 30° elevation"
    )
    if noise.code_bias_m > 0.0:
        return f"{text}, or of the satellite's code bias, {length(3.0 * noise.code_bias_m)} at the zenith."
    if noise.glonass_code_bias_m > 0.0:
        return f"{text}; with GLONASS up to 3 sigma of the satellite's code bias, {_glonass(noise)}."
    return f"{text}."


def _glonass(noise: NoiseModel) -> str:
    return length(3.0 * noise.glonass_code_bias_m)


def _growth(noise: NoiseModel) -> str:
    sizes = [noise.ambiguity_m * np.sqrt(t) for t in TIMES_S]
    grown = ", ".join(f"{length(s)} in {duration(t)}" for s, t in zip(sizes, TIMES_S, strict=True))
    return (
        f"Ambiguities walk (sigma {grown}), which carries slow errors of orbits, clocks and multipath: a "
        "carrier "
        "fault that grows no faster than about three times that is followed, not seen."
    )
