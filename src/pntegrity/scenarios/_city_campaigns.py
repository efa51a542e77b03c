"""Campaigns on fusions of GNSS with an IMU in the city."""

from __future__ import annotations

from pntegrity.scenarios._campaign import Campaign, from_module

__all__ = ["CITY"]

NAGOYA = """The real drive through Nagoya under real ephemerides, GPS and BDS at 1 Hz, houses, tunnels and
errors simulated: in streets satellites have blocks of the errors of the real log of Tsim Sha Tsui. 20 seeds
that no option was chosen on. Every method has the same filter settings; the *EKF* takes fixes of unweighted
least squares, *weighted* the noise model's weights; *LSR* leaves out one satellite at most. Errors are means
over the seeds, gains are of these means. The interval of a gain is a bootstrap's over seeds."""

CITY = (
    Campaign(
        "factor-set-rate",
        "False-alarm rate of the factor-set detection factor",
        """A fault-free sky of two constellations, pseudorange noise 1 m: how often the published and the
exact detection factor alarm, with sigmas that have settled and with sigmas that adapt; subsets tested
beside ARAIM's.""",
        from_module("evidence_factor_set_rate", "factor_set_rate"),
        real=False,
    ),
    Campaign(
        "city-thresholds",
        "Fusion in the city: thresholds of the factor sets, on tuning seeds",
        """The drive through Nagoya at moderate load with five tuning seeds. Thresholds of the two checks, of
missed detection and of false alarm: trained on the same drive under an open sky with the least and the most
standard deviations that the paper allows, those of the paper, and two pairs of wider ones. Of these the pair
with the smallest error is what the other campaigns take.""",
        from_module("evidence_city", "thresholds"),
    ),
    Campaign(
        "city-moderate",
        "Fusion in the city, simulated: moderate load",
        f"""{NAGOYA} Half of the satellites of a street are free of the library's errors.""",
        from_module("evidence_city", "moderate"),
    ),
    Campaign(
        "city-full",
        "Fusion in the city, simulated: all errors of the real log",
        f"""{NAGOYA} All satellites of a street have the library's errors.""",
        from_module("evidence_city", "full"),
    ),
    Campaign(
        "city-low-cost",
        "Fusion in the city, simulated: all errors of the real log, consumer IMU",
        f"""{NAGOYA} All satellites of a street have the library's errors; the IMU is a consumer's.""",
        from_module("evidence_city", "low_cost"),
    ),
    Campaign(
        "city-open",
        "Fusion under an open sky, simulated",
        """The drive through Nagoya without houses and tunnels, five seeds, STIM300; the figures of
city-moderate.""",
        from_module("evidence_city", "open_sky"),
    ),
    Campaign(
        "city-tst",
        "Fusion in the city: real GPS and BDS, IMU simulated on the truth",
        """The log of Tsim Sha Tsui, its epochs that have a truth, at 1 Hz; the IMU at 125 Hz with ten seeds.
Methods and settings are those of city-moderate. The noise model of all filters was chosen on this log.""",
        from_module("evidence_city_tst", "tst"),
    ),
    Campaign(
        "city-levels",
        "Fusion in the city: protection levels",
        """The tight filter with its own detection, levels by separation of subfilters without single
satellites, sectors of the sky and constellations (*city*), without single satellites alone, and *K sigma* of
the filter beside. The real log of Tsim Sha Tsui with two IMUs, and five quoted drives through Nagoya.""",
        from_module("evidence_city_levels", "city_levels"),
    ),
    Campaign(
        "city-nees",
        "Fusion: do the filters know how wrong they are?",
        """Three minutes of the drive through Nagoya under an open sky, STIM300, 50 runs. Errors of code and
range rate are drawn from the noise model that the filter has (C/N0 from the elevation, 40 to 50 dBHz), those
of the IMU from its specification. The filter starts at its own fix with 100 m and 10 m/s; attitude (0.1
degrees level, 1 degree heading) and errors of the IMU start with errors drawn from the filter's covariance.
NEES: squared errors over the covariance, as many as there are states where it is right.""",
        from_module("evidence_city_nees", "nees"),
    ),
    Campaign(
        "ins-real",
        "Real inertial logs: a walk, a drive with faults and outages, two fused drives",
        """A hand-held unit with raw GNSS; a car with RTK fixes, into which faults and outages are put, beside
python-ins; two drives with a receiver's fixes, whose reference is the receiver's own fusion.""",
        from_module("evidence_ins_real", "ins_real"),
    ),
    Campaign(
        "mechanisation",
        "Mechanisation beside python-ins and theory",
        """The same increments through both; growth of errors with the biases of a STIM300; CPU time of one
thread.""",
        from_module("evidence_mechanisation", "mechanisation"),
        real=False,
    ),
    Campaign(
        "ins-speed",
        "Cost of the inertial filters",
        """Nagoya, 10 Hz of GPS and BDS, 125 Hz of the IMU, CPU time of one thread, the fastest of some
rounds; the filter's own two steps, without a monitor.""",
        from_module("evidence_ins_speed", "ins_speed"),
    ),
)
