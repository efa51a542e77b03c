"""All evidence campaigns by name, and their figures as the page docs/results.md."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pntegrity.scenarios._campaign import Campaign, from_module
from pntegrity.scenarios._city_campaigns import CITY
from pntegrity.scenarios._real_logs import Row, row, skipped

__all__ = ["CAMPAIGNS", "Campaign", "page", "run_campaign", "section", "summary_line"]

PACKAGES = ("numpy", "scipy", "numba", "sidereon")


def _spp8(data: Path) -> list[Row]:
    from pntegrity.scenarios.evidence_spp8 import evidence

    return [
        row("spp8", r["quantity"], r["must"], r["measured"], r["ok"], interval=r["interval"])
        for r in evidence()
    ]


def _printed(name: str, rows: Sequence[Row]) -> list[Row]:
    return [row(name, r["quantity"], r["published"], r["measured"], r["ok"], note=r["note"]) for r in rows]


def _sraime_spp(data: Path) -> list[Row]:
    from pntegrity.scenarios.reproduce_sraime_spp import reproduce

    return _printed("sraime-spp", reproduce().rows)


def _sraime_ppp(data: Path) -> list[Row]:
    from pntegrity.scenarios.reproduce_sraime_ppp import reproduce

    return _printed("sraime-ppp", reproduce(data=data).rows)


def _ppp_rtk(data: Path) -> list[Row]:
    from pntegrity.scenarios.reproduce_ppp_rtk import reproduce

    return _printed("ppp-rtk", reproduce(data=data).rows)


_ALL = (
    Campaign(
        "spp8",
        "Simulation: false-alarm rates, power and delay",
        """The 8-state positioning filter with 10 satellites, code 1 m, range rate 0.1 m/s, 1 Hz. The
innovations are drawn white, so a false-alarm rate is a property of the monitor alone.""",
        _spp8,
        real=False,
    ),
    Campaign(
        "clean",
        "Real static receiver, no fault",
        """BRUX, 900 epochs at 1 Hz of GPS, GLONASS, Galileo and BDS. The noise model is fitted to the first
half; alarms and whiteness are those of the second. 450 correlated epochs cannot prove a rate of
1e-6, they can only refute it. The white model is the best of its kind: its sigma is fitted to the
same data.""",
        from_module("evidence_real", "clean"),
    ),
    Campaign(
        "delays",
        "Real static receiver: how soon a fault on one code is seen",
        """The same log, second half, each satellite in turn, four onsets, P_FA 1e-6. The best possible test
knows satellite, course, size, sign and onset; its delay is the first at which it alarms with
probability one half. No test of this P_FA is more powerful at any epoch under the same noise model.""",
        from_module("evidence_real", "delays"),
    ),
    Campaign(
        "faults",
        "Real static receiver: injected faults through the whole pipeline",
        """The same log, second half, random satellites, sizes, signs and onsets. With few satellites the
filter ran for a minute on these alone before the fault; the snapshot has the one epoch.""",
        from_module("evidence_faults", "faults"),
    ),
    Campaign(
        "receivers",
        "Other receivers, not calibrated",
        """What the defaults and a fit to the first half of each log say on its second half. In the urban
canyon most measurements are reflected: alarms there are true ones, and a fit takes the reflections
for noise.""",
        from_module("evidence_receivers", "receivers"),
    ),
    Campaign(
        "speed",
        "Speed of the main job",
        "A whole process each time, from the files to the report.",
        from_module("evidence_receivers", "speed"),
    ),
    Campaign(
        "ppp",
        "Precise positions of real logs",
        """Kinematic PPP, position white noise, float, default noise model: two static stations and a road
drive. References are of the antennas. `python -m benchmarks.peers_ppp` runs RTKLIB on the same
files (docs/benchmarks.md).""",
        from_module("evidence_ppp", "accuracy"),
    ),
    Campaign(
        "ppp-clean",
        "Precise logs, no fault",
        """The noise model is fitted to the first half of each log; alarms and whiteness are those of the
second.""",
        from_module("evidence_ppp", "clean"),
    ),
    Campaign(
        "ppp-drive",
        "Precise road drive, no fault: every alarm explained",
        """CARD, the whole pipeline, noise model fitted to the first half. An alarm counts as explained where
what was left out is shown to be wrong by something that the monitors did not use.""",
        from_module("evidence_ppp_drive", "drive"),
    ),
    Campaign(
        "ppp-van",
        "Precise van run, simulated on the real track",
        """The observations of this run are not public: GPS and GLONASS are simulated on its true track under
the real orbits and clocks of the day, with noise that makes the clean error that of GINav's own
solution of the real data.""",
        from_module("evidence_ppp_drive", "van"),
    ),
    Campaign(
        "ppp-ramps",
        "Precise static log: one carrier grows by 1 cm an epoch",
        """ESBC, second half, each satellite in turn, three onsets, P_FA 1e-6, fitted noise model.""",
        from_module("evidence_ppp_faults", "carrier_ramps"),
    ),
    Campaign(
        "ppp-faults",
        "Precise logs: code and carrier of a satellite grow, through the whole pipeline",
        """Each satellite in turn, 40 epochs of growth, exclusion and repair; distances are to the run without
the fault.""",
        from_module("evidence_ppp_faults", "satellite_ramps"),
    ),
    Campaign(
        "ppp-speed",
        "Speed of precise positioning",
        "One thread; best of five runs over the log.",
        from_module("evidence_ppp", "speed"),
    ),
    Campaign(
        "sraime-spp",
        "The published SPP experiment (Table 1 of the SRAIME paper)",
        "The column *must* holds the published figure; *met* tells whether it is reproduced.",
        _sraime_spp,
        real=False,
    ),
    Campaign(
        "sraime-ppp",
        "The published PPP experiment (Table 3 of the SRAIME paper)",
        """The column *must* holds the published figures; *met* tells whether they are reproduced. The drive
is the real one, the observations are simulated.""",
        _sraime_ppp,
    ),
    Campaign(
        "rtk-cases",
        "PPP-RTK, simulated: protection levels in four cases",
        """Simulated GPS and BDS under the real orbits over OPEC, code 0.3 m and carrier 3 mm at the zenith,
products of 0.1 and 0.2 m. *white*: the filter of the literature; *correlated* and *default*: one Gauss-Markov
state a product (30 min), code and carrier of which 70 % last 60 s; *white* and *correlated* have slant delays
that walk 1 mm/√s, as a prototype had, *default* 3. Cases 1 to 4: faults of nothing; satellites (1e-5); and
the troposphere product; and all ionosphere products. Risk 1e-7 an epoch. Levels do not depend on data.""",
        from_module("evidence_rtk_cases", "cases"),
    ),
    Campaign(
        "rtk-risk",
        "PPP-RTK, simulated: misleading information where errors last longer than assumed",
        """The same geometry, case 4. Gains, thresholds and levels are the filter's; the truth has other
correlation times, which the table names. Faults of every mode, with random shape (step or ramp of code and
carrier, step of code, step of the product), onset and size, weighted by the mode's probability. An alert
counts at its own epoch only: what it would have excluded later is left in.""",
        from_module("evidence_rtk_risk", "risk"),
    ),
    Campaign(
        "ppp-rtk",
        "The published PPP-RTK experiment (solution separation)",
        """The column *must* holds the published statement; *met* tells whether it is reproduced. Orbits are
real, of another station and day; observations and products are simulated.""",
        _ppp_rtk,
    ),
    Campaign(
        "rtk-speed",
        "Speed of the bank of subfilters",
        """CPU time of one thread, the best of many calls. A bank has the filter, one member without each of
17 satellites, and *warm pairs* without two; a satellite has two codes, two carriers and a product, and
three states of its own (60 in all) or four, with a bias of its product (77). The numpy filter is the
textbook's.""",
        from_module("evidence_rtk_speed", "speed"),
        real=False,
    ),
    Campaign(
        "rtk-opec",
        "PPP-RTK on a real static receiver taken for a moving one, no fault",
        """OPEC, GPS and BDS, 30 s, position white noise, a cold start every 10 min after 02:00, each run to
the end of 50 min or of the log. **The products are self-derived**: made of the station's own data with
fixed coordinates, 30 s late; errors of 0.2 m slant and 0.1 m zenith are added, Gauss-Markov over 1800 s, ten
seeds. The default noise model but for satellite clocks, which walk half as much: chosen among some thirty
settings on 00:00-02:00 alone, as the one with the smallest horizontal error of those whose errors are 0.7 to
1.3 of their sigmas there. Receiver and sky are the same for all seeds: the errors of their own are one
sample. The reference is a mean of PPP, good to 1-3 cm. Levels for a risk of 1e-7 an epoch.""",
        from_module("evidence_rtk_opec", "clean"),
    ),
    Campaign(
        "rtk-opec-faults",
        "PPP-RTK on the same log: faults of satellites and of products",
        """A start at 02:00, faults 10 and 30 min later, each satellite in turn, two seeds of product errors
for 5 m and 0.5 m and one for the others; exclusion by warm subfilters. A level may leave a fault whose
probability is 1e-5 a hundredth of its cases unseen and beyond it.""",
        from_module("evidence_rtk_opec", "faults"),
    ),
    Campaign(
        "rtk-clas",
        "PPP-RTK with the corrections of CLAS, no fault",
        """A static receiver, 15 min of GPS, Galileo and QZSS at 1 Hz, position white noise, corrections and
their qualities as broadcast, float. *chosen*: code 0.15 m and carrier 2 mm at the zenith, from the
residuals at the known place in the first 300 s; *default*: the default model.
`python -m benchmarks.peers_clas` runs cssrlib on the same files.""",
        from_module("evidence_rtk_clas", "whole"),
    ),
    Campaign(
        "rtk-clas-ramp",
        "PPP-RTK with the corrections of CLAS: a satellite that runs away",
        """The same log; code and carriers of one satellite after the other grow by 2 cm/s from 300 s on
(*chosen*: and from 600 s on), looked at for 120 s. Induced errors are distances from the run without the
fault. cssrlib goes on as *fixed* then, metres off (docs/benchmarks.md).""",
        from_module("evidence_rtk_clas", "ramps"),
    ),
    *CITY,
    Campaign(
        "acoustics",
        "Real acoustic ranges: how well the model explains them",
        """Residuals where GNSS and attitude say that the vessel was: two-way ranges of a Wave Glider (NCL1)
and of a ship (SAGA) to transponders on the sea floor, as ranges one way; and what least squares finds in
them.""",
        from_module("evidence_acoustics", "acoustics"),
    ),
    Campaign(
        "vessels",
        "Real vessels with GNSS, ranges to beacons and a simulated IMU: faults through the whole chain",
        """A Wave Glider (NCL1) and a ship (SAGA), real fixes and two-way travel times, each a TOML file
(docs/examples); the IMU (STIM300, 100 Hz) is simulated on the receiver's own track, the truth. Sigmas
were chosen on a part of each log, the GNSS floor of NCL1 on the quoted spans as well. The rules of
identification were made with the quoted spans in view; drifts at other times are beside them. One fault a
run, from 300 s to 600 s of 1,500 s.""",
        from_module("evidence_vessels", "evidence"),
    ),
    Campaign(
        "multi-level",
        "Several sources beside an INS, simulated: which one, which sensor, when is it back",
        """The linear study of INS, GNSS, LBL and USBL, 200 s at 2 Hz, 200 runs of each case, with a seed on
which no rule was chosen; the rules of identification, the noise of the USBL angles and the rates were
chosen on another seed of the same cases.""",
        from_module("reproduce_multi_level", "multi_level"),
        real=False,
    ),
    Campaign(
        "vessel-cases",
        "Several sources beside an INS, simulated: the six cases through the whole chain",
        """The ship of the linear study as a log: increments of its INS at 100 Hz, pseudoranges of 12
satellites, travel times to four beacons, USBL, 2 Hz; filter, source and sensor level, exclusion with a re-run
from before the onset, trial and re-admission as `pntegrity run` has them. 40 runs without a fault, 20 of each
case; 6 with the published monitors and five passes.""",
        from_module("evidence_vessel_cases", "vessel_cases"),
        real=False,
    ),
    Campaign(
        "vessel-pairs",
        "Several sources beside an INS, simulated: sources led astray, alone and two together",
        """The same ship. From 60 s on a source measures as from a place that drifts off by 0.3 m/s, as a
spoofed receiver would, or a wrong sound speed; or two do so together; or a satellite and a beacon jump at
once. Two sources at fault at once have a probability of 1e-8, which the risk tree leaves out: until the first
alarm such a drift may be misleading (stated), from then on not. At the end of a drift the state may have
followed it: who contradicts it then need not be at fault.""",
        from_module("evidence_vessel_pairs", "vessel_pairs"),
        real=False,
    ),
    Campaign(
        "vessel-noise",
        "Several sources beside an INS: are the sigmas of the sources right?",
        """`pntegrity calibrate --config vehicle.toml`: sigmas are fitted on the first half of a log, without
what the monitors leave out of it, and judged on the second: errors in units of each sigma, alarms at
1e-6. The simulated ship is given sigmas that are wrong; those of the real vessels are those of
docs/examples.""",
        from_module("evidence_vessel_noise", "vessel_noise"),
    ),
    Campaign(
        "vessel-speed",
        "Several sources beside an INS: speed",
        """CPU time on one core of the ship with four sources (12 satellites, four beacons, USBL, depth) at
1 Hz, increments at 100 Hz, with all monitors: source level, sensor level, protection levels, trials.""",
        from_module("evidence_vessel_cases", "vessel_speed"),
        real=False,
    ),
)
CAMPAIGNS: Mapping[str, Campaign] = {c.name: c for c in _ALL}


def run_campaign(name: str, data: Path | None) -> list[Row]:
    """Return the rows of a campaign; one that needs real data and has none says so.

    Parameters
    ----------
    name : str
        Of `CAMPAIGNS`.
    data : Path, optional
        Folder of the real logs.
    """
    from threadpoolctl import threadpool_limits

    campaign = CAMPAIGNS[name]
    if campaign.real and (data is None or not data.is_dir()):
        return skipped(name, "no folder with the real logs was given (--data)")
    with threadpool_limits(1, user_api="blas"):
        return list(campaign.run(data or Path()))


def page(text: str, found: Mapping[str, Sequence[Row]]) -> str:
    """Return the page with the sections of some campaigns replaced; what is missing in `text` is appended.

    Parameters
    ----------
    text : str
        The page so far; empty: a new one.
    found : mapping of str to rows
    """
    text = text or "# Results\n\nEvery figure on this page is made by the command above its table.\n"
    for name, rows in found.items():
        begin, end = f"<!-- evidence {name} -->", f"<!-- end of evidence {name} -->"
        block = f"{begin}\n{section(CAMPAIGNS[name], rows)}{end}"
        marked = re.compile(re.escape(begin) + ".*?" + re.escape(end), re.DOTALL)
        parts = marked.split(text, maxsplit=1)
        text = block.join(parts) if len(parts) > 1 else f"{text.rstrip()}\n\n{block}\n"
    return text


def section(campaign: Campaign, rows: Sequence[Row]) -> str:
    """Return one campaign as Markdown: what was done, the command, the table, the versions."""
    option = " --data FOLDER" if campaign.real else ""
    head = ("quantity", "must", "measured", "99 % interval", "met", "note")
    lines = [
        f"## {campaign.title}",
        "",
        campaign.text,
        "",
        "```",
        f"pntegrity evidence {campaign.name}{option} --write docs/results.md",
        "```",
        "",
        "| " + " | ".join(head) + " |",
        "|" + "---|" * len(head),
        *(_line(r) for r in rows),
        "",
        f"*{_versions()}*",
        "",
    ]
    return "\n".join(lines)


def summary_line(rows: Sequence[Row]) -> str:
    """Return how many requirements were met, and which were not."""
    judged = [r for r in rows if r["ok"] is not None]
    missed = [r["quantity"] for r in judged if not r["ok"]]
    met = f"{len(judged) - len(missed)} of {len(judged)} requirements met"
    text = f"{met}, {len(rows) - len(judged)} figures stated"
    return text + ("; missed: " + "; ".join(missed) if missed else "")


def _line(r: Row) -> str:
    met = {True: "yes", False: "**no**", None: ""}[r["ok"]]
    cells = (
        r["quantity"],
        _text(r["must"]),
        _text(r["measured"]),
        _text(r["interval"], " to "),
        met,
        r["note"],
    )
    return "| " + " | ".join(c.replace("|", "\\|") for c in cells) + " |"


def _text(value: Any, joint: str = "-") -> str:
    if value is None or value == []:
        return ""
    if isinstance(value, Mapping):
        return ", ".join(f"{k} {_text(v)}" for k, v in value.items())
    if isinstance(value, Sequence) and not isinstance(value, str):
        return joint.join(_text(v) for v in value)
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _versions() -> str:
    return ", ".join(f"{name} {version(name)}" for name in PACKAGES)
