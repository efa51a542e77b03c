"""The whole command on BRUX: five monitors, exclusion, report.

``python -m benchmarks.process --data FOLDER``. The first call, which fills numba's cache, is not counted.
With ``--profile N`` it also prints the N most expensive functions of one more run (CPU time under cProfile,
which weighs small functions too heavily).
"""

from __future__ import annotations

import argparse
import cProfile
import os
import pstats
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

from benchmarks.workload import DEFAULT_DATA, brux

__all__ = ["measure"]

MAIN = "from pntegrity.cli import main; main()"


def arguments_of(data: Path, out: Path) -> list[str]:
    """Return the command line of the run, on the compressed files as they are."""
    folder = data / "brux-static-2019014"
    (obs,), (nav,) = folder.glob("*_MO.rnx.gz"), folder.glob("*_MN.rnx.gz")
    truth = "4027881.6280,306998.5370,4919498.9840"
    return ["run", "--obs", str(obs), "--nav", str(nav), "--out", str(out), "--truth-ecef", truth]


def measure(command: list[str], times: int) -> list[tuple[float, float]]:
    """Return wall and CPU seconds of some calls after a first that is not counted."""
    out = []
    for k in range(times + 1):
        before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        subprocess.run(
            [sys.executable, *command], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        wall = time.perf_counter() - start
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        if k:
            out.append((wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime))
    return out


def show(name: str, found: list[tuple[float, float]]) -> float:
    """Print the medians of a measurement; return that of CPU time."""
    wall, cpu = statistics.median(w for w, _ in found), statistics.median(c for _, c in found)
    print(f"{name:34} wall {wall:6.2f} s (best {min(w for w, _ in found):.2f})   CPU {cpu:6.2f} s")
    return cpu


def profiled(command: list[str], most: int) -> None:
    """Print the most expensive functions, by own time and by time with what they call."""
    from pntegrity.cli import main

    profile = cProfile.Profile(time.process_time)
    sys.argv = ["pntegrity", *command]
    with suppress(SystemExit):
        profile.runcall(main)
    for order in ("tottime", "cumtime"):
        pstats.Stats(profile).strip_dirs().sort_stats(order).print_stats(most)


def main() -> None:
    """Measure the process."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=DEFAULT_DATA, help="folder of the real logs")
    parser.add_argument("--times", type=int, default=5, help="calls that count; their median is printed")
    parser.add_argument("--profile", type=int, default=0, help="also print so many functions of a profile")
    options = parser.parse_args()
    try:
        brux(options.data).close()
    except FileNotFoundError as error:
        sys.exit(f"nothing to measure: {error}")
    with tempfile.TemporaryDirectory(prefix="pntegrity-bench-") as folder:
        command = arguments_of(options.data, Path(folder) / "out")
        print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}, {options.times} calls after the first")
        imports = show(
            "imports alone", measure(["-c", "import pntegrity.run, pntegrity.report.write"], options.times)
        )
        run = show("pntegrity run, BRUX, all results", measure(["-c", MAIN, *command], options.times))
        print(f"CPU of the run in units of the imports: {run / imports:.1f}")
        if options.profile:
            profiled(command, options.profile)


if __name__ == "__main__":
    main()
