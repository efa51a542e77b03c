"""RTKLIB's kinematic PPP through `pyrtklib`, one run in a process of its own.

Three things of RTKLIB 2.4.3 are worked around. It combines E1 with E5b and B1I with B2I, and reads antenna
offsets of neither second; the products are for E1/E5a and B1I/B3I, which are put there, the antennas combined
for them. Its first position, from one frequency, takes the group delay of BDS as if the clocks were those of
B3I. And it counts the satellites of an orbit file in two digits: a larger file is handed to it in parts.
"""

from __future__ import annotations

import re
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from importlib.metadata import version
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["MASK_DEG", "SETTINGS", "Job", "Track", "solve"]

MASK_DEG = 10.0
#: Seconds between the Unix epoch, where RTKLIB's times start, and that of GPS; both scales without leaps.
GPS_START_S = 315964800
SETTINGS = (
    "PPP-kinematic, forward, ionosphere-free, ZTD estimated, solid tides, wind-up, satellite antennas "
    f"(igs14), elevation mask {MASK_DEG:g} deg, no receiver antenna, no code biases, float; noise as RTKLIB "
    "has it: phase 3 mm and 3 mm/sin(el), code 100 times that, GLONASS 1.5 times, the combination 3 "
    "times, satellite clocks 1 mm/s from their nodes, position white with 60 m, ambiguity 0.1 mm/sqrt(s), "
    "ZTD 0.1 mm/sqrt(s), slips by LLI, geometry-free 5 cm and Melbourne-Wuebbena 10 m, innovations over 30 m "
    "dropped"
)

_SYSTEMS = {"G": "SYS_GPS", "R": "SYS_GLO", "E": "SYS_GAL", "C": "SYS_CMP"}
_FREQUENCIES_HZ = {"E": (1575.42e6, 1176.45e6), "C": (1561.098e6, 1268.52e6)}


@dataclass(frozen=True)
class Job:
    """Plain files, and the constellations to use, such as ``"GR"``; `as_is` leaves RTKLIB its own pairs."""

    obs: Path
    nav: tuple[Path, ...]
    orbits: tuple[Path, ...]
    clocks: tuple[Path, ...]
    antennas: Path
    systems: str
    as_is: bool = False


@dataclass(frozen=True, eq=False)
class Track:
    """The epochs with a PPP solution, and what all epochs cost."""

    t_ns: npt.NDArray[np.int64]
    position_m: npt.NDArray[np.float64]
    satellites: npt.NDArray[np.int64]
    epochs: int
    wall_s: float
    cpu_s: float
    version: str


def solve(job: Job) -> Track:
    """Run a job in a process of its own: RTKLIB keeps state in the library, and may abort on bad data.

    Raises
    ------
    concurrent.futures.process.BrokenProcessPool
        If it did.
    """
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        return pool.submit(_solve, job).result()


def _solve(job: Job) -> Track:
    import pyrtklib as r

    obs, nav = _observations(r, job), _products(r, job)
    starts = _starts(obs)
    _set_antennas(r, nav, job, obs.data[0].time.time)
    rtk = r.rtk_t()
    r.rtkinit(rtk, _options(r, job.systems))
    t_ns, places, used = [], [], []
    wall = cpu = 0.0
    for a, b in pairwise(starts):
        first = obs.data[a]
        wall_start, cpu_start = time.perf_counter(), time.process_time()
        r.rtkpos(rtk, first, b - a, nav)
        wall += time.perf_counter() - wall_start
        cpu += time.process_time() - cpu_start
        if rtk.sol.stat == r.SOLQ_PPP:
            t_ns.append((first.time.time - GPS_START_S) * 10**9 + round(first.time.sec * 1e9))
            places.append([rtk.sol.rr[i] for i in range(3)])
            used.append(rtk.sol.ns)
    times = np.array(t_ns, dtype=np.int64)
    position, n = np.array(places).reshape(-1, 3), np.array(used, dtype=np.int64)
    return Track(times, position, n, len(starts) - 1, wall, cpu, f"pyrtklib {version('pyrtklib')}")


def _options(r: Any, systems: str) -> Any:
    o = r.prcopt_default
    o.mode, o.nf, o.elmin = r.PMODE_PPP_KINEMA, 2, float(np.deg2rad(MASK_DEG))
    o.navsys = sum(getattr(r, _SYSTEMS[s]) for s in systems)
    o.ionoopt, o.tropopt, o.sateph = r.IONOOPT_IFLC, r.TROPOPT_EST, r.EPHOPT_PREC
    o.tidecorr, o.modear = 1, r.ARMODE_OFF
    o.posopt[0] = o.posopt[2] = 1  # satellite antennas, wind-up
    return o


def _products(r: Any, job: Job) -> Any:
    nav = r.nav_t()
    for path in job.nav:
        if r.readrnx(str(path), 1, "", r.obs_t(), nav, r.sta_t()) != 1:
            raise RuntimeError(f"RTKLIB could not read {path.name}")
    r.uniqnav(nav)
    for i in range(0 if job.as_is else nav.n):
        if r.satsys(nav.eph[i].sat, r.Arr1Dint(1)) == r.SYS_CMP:
            nav.eph[i].tgd[0] *= 1.0 - _share(*_FREQUENCIES_HZ["C"])
    for path in job.orbits:
        for part in _countable(path):
            r.readsp3(str(part), nav, 0)
    for path in job.clocks:
        if not r.readrnxc(str(path), nav):
            raise RuntimeError(f"RTKLIB could not read {path.name}")
    return nav


def _countable(path: Path) -> list[Path]:
    """Return the orbit file, or one for each constellation where two digits cannot count the satellites."""
    text = path.read_text("latin-1")
    if int(text.split("\n")[2][3:6]) < 100:
        return [path]
    head, *epochs = re.split(r"^(?=\*)", text.removesuffix("EOF\n"), flags=re.MULTILINE)
    lines = head.split("\n")
    middle = [line for line in lines if line.startswith("%")]
    out = []
    for system in _SYSTEMS:
        bodies = [re.findall(rf"^(?:\*|P{system}).*\n", e, re.MULTILINE) for e in epochs]
        sats = "".join(line[1:4] for line in bodies[0][1:]).ljust(255)
        count = f"{len(bodies[0]) - 1:3d}"
        listed = [f"+  {count if k == 0 else '   '}   {sats[51 * k : 51 * k + 51]}" for k in range(5)]
        rows = [*lines[:2], *listed, *("++".ljust(60),) * 5, *middle, *("/*",) * 4]
        out.append(path.with_name(f"{path.stem}.{system}.sp3"))
        out[-1].write_text("\n".join(rows) + "\n" + "".join(line for b in bodies for line in b) + "EOF\n")
    return out


def _observations(r: Any, job: Job) -> Any:
    """Return the rows of the chosen constellations, those of Galileo and BDS as the products want them."""
    path = job.obs.with_name("relabelled.rnx")
    text = job.obs.read_text("latin-1")
    path.write_text(text if job.as_is else _b3_as_b2(text), "latin-1")
    obs = r.obs_t()
    if r.readrnx(str(path), 1, "", obs, r.nav_t(), r.sta_t()) != 1:
        raise RuntimeError(f"RTKLIB could not read {job.obs.name}")
    r.sortobs(obs)
    chosen = {getattr(r, _SYSTEMS[s]): s for s in job.systems}
    b1, b3 = r.obs2code("2I"), r.obs2code("6I")
    n = 0
    for i in range(obs.n):
        row = obs.data[i]
        if (system := chosen.get(r.satsys(row.sat, r.Arr1Dint(1)))) is None:
            continue
        if system == "E" and not job.as_is:
            for column in (row.P, row.L, row.D, row.SNR, row.LLI, row.code):
                column[1], column[2] = column[2], 0
        elif system == "C" and not job.as_is:
            row.code[0], row.code[1] = b1, b3
        obs.data[n] = row
        n += 1
    obs.n = n
    return obs


def _b3_as_b2(text: str) -> str:
    """Return an observation file that calls B3I what RTKLIB reads as its second BDS frequency."""
    head, rest = text.split("END OF HEADER", 1)
    lines, system = [], ""
    for line in head.split("\n"):
        if "SYS / # / OBS TYPES" in line:
            system = line[0].strip() or system
            if system == "C":
                line = re.sub(r"\b([CLDS])7", r"\g<1>8", line[:60]) + line[60:]
                line = re.sub(r"\b([CLDS])6", r"\g<1>7", line[:60]) + line[60:]
        lines.append(line)
    return "\n".join(lines) + "END OF HEADER" + rest


def _set_antennas(r: Any, nav: Any, job: Job, unix_s: int) -> None:
    """Give each satellite the antenna that is valid, that of B3I read as the second of BDS."""
    text = job.antennas.read_text("latin-1")
    if not job.as_is:
        text = re.sub(r"   C02( +START)", r"   C03\1", text)
        text = re.sub(r"   C06( +START)", r"   C02\1", text)
    path = job.antennas.with_name("relabelled.atx")  # RTKLIB knows the format by the suffix
    path.write_text(text, "latin-1")
    found = r.pcvs_t()
    if not r.readpcv(str(path), found):
        raise RuntimeError(f"RTKLIB could not read {job.antennas.name}")
    pairs = {} if job.as_is else {getattr(r, _SYSTEMS[s]): f for s, f in _FREQUENCIES_HZ.items()}
    for i in range(found.n):
        one = found.pcv[i]
        if not one.sat or one.ts.time > unix_s or (one.te.time and one.te.time < unix_s):
            continue
        system = r.satsys(one.sat, r.Arr1Dint(1))
        if system in pairs:
            _combine(one, 2 if system == r.SYS_GAL else 1, _share(*pairs[system]))
        nav.pcvs[one.sat - 1] = one


def _combine(antenna: Any, source: int, share: float) -> None:
    """Put the combination on both frequencies: whatever RTKLIB combines them with, it gets that."""
    for table, n in ((antenna.off, 3), (antenna.var, 19)):
        for k in range(n):
            table[0, k] = table[1, k] = share * table[0, k] + (1.0 - share) * table[source, k]


def _starts(obs: Any) -> list[int]:
    times = [(obs.data[i].time.time, obs.data[i].time.sec) for i in range(obs.n)]
    return [0, *(i for i in range(1, len(times)) if times[i] != times[i - 1]), len(times)]


def _share(f1_hz: float, f2_hz: float) -> float:
    return f1_hz**2 / (f1_hz**2 - f2_hz**2)
