"""Small RINEX files, written here, not copied from anywhere."""

import pytest


def header_line(text, label):
    return f"{text:<60}{label}\n"


def obs3_header(systems=("G    8 C1C L1C D1C S1C C2W L2W D2W S2W", "R    4 C1C L1C D1C S1C"), scale="GPS"):
    return (
        header_line("     3.04           OBSERVATION DATA    M (MIXED)", "RINEX VERSION / TYPE")
        + header_line("sample              nobody", "PGM / RUN BY / DATE")
        + header_line("SAMP", "MARKER NAME")
        + header_line("1                   RECEIVER            1.0", "REC # / TYPE / VERS")
        + header_line("1                   ANTENNA         NONE", "ANT # / TYPE")
        + header_line("  4000000.0000   300000.0000  4900000.0000", "APPROX POSITION XYZ")
        + header_line("        1.5000        0.0000        0.0000", "ANTENNA: DELTA H/E/N")
        + "".join(header_line(s, "SYS / # / OBS TYPES") for s in systems)
        + header_line("     1.000", "INTERVAL")
        + header_line(f"  2024     2     3     4     5    6.0000000     {scale}", "TIME OF FIRST OBS")
        + header_line("", "END OF HEADER")
    )


def value(x, lli=" "):
    return f"{x:14.3f}{lli} " if x is not None else " " * 16


def obs3_epoch(second, rows, flag=0, minute=5):
    text = f"> 2024 02 03 04 {minute:02d}{second:11.7f}  {flag}{len(rows):3d}\n"
    return text + "".join(f"{sat}{''.join(value(v) for v in values)}".rstrip() + "\n" for sat, values in rows)


def rows_at(k):
    """Three satellites at the k-th second."""
    return [
        ("G05", (21e6 + 100 * k, 1.1e8 + k, -500.0, 45.0, 21e6 + 100 * k + 3, 0.86e8 + k, -390.0, 38.5)),
        ("G12", (23e6 + 50 * k, None, 1200.5, 40.0, None, None, None, None)),
        ("R03", (20e6 - 70 * k, 1.07e8, 33.25, 51.0)),
    ]


@pytest.fixture
def obs3():
    """A RINEX 3.04 observation file: four seconds, three satellites."""
    return obs3_header() + "".join(obs3_epoch(6.0 + k, rows_at(k)) for k in range(4))


@pytest.fixture
def obs2():
    """A RINEX 2.11 observation file: two epochs, GPS and GLONASS."""
    text = (
        header_line("     2.11           OBSERVATION DATA    M (MIXED)", "RINEX VERSION / TYPE")
        + header_line("sample              nobody", "PGM / RUN BY / DATE")
        + header_line("     6    C1    L1    L2    P2    D1    S1", "# / TYPES OF OBSERV")
        + header_line("  2024     2     3     4     5    6.0000000     GPS", "TIME OF FIRST OBS")
        + header_line("", "END OF HEADER")
    )
    for k in range(2):
        text += f" 24  2  3  4  5{6.0 + k:11.7f}  0  2G05R03\n"
        text += "".join(value(v) for v in (21e6 + k, 1.1e8, 0.86e8, 21e6 + 4, -500.0)).rstrip() + "\n"
        text += value(44.0).rstrip() + "\n"
        text += "".join(value(v) for v in (20e6, 1.07e8, 0.83e8, 20e6 + 5, 10.0)).rstrip() + "\n"
        text += value(47.0).rstrip() + "\n"
    return text


NAV_GPS = [
    [-1.0e-4, 1.0e-12, 0.0],
    [17.0, -20.0, 4.5e-9, 1.25],
    [-1.0e-6, 0.008, 5.0e-6, 5153.7],
    [532800.0, -1.0e-7, 1.5, 8.0e-8],
    [0.96, 250.0, -0.7, -8.0e-9],
    [1.0e-10, 1.0, 2299.0, 0.0],
    [2.0, 0.0, -1.1e-8, 17.0],
    [525618.0, 4.0, 0.0, 0.0],
]


def nav_record(head, rows):
    first = head + "".join(f"{v:19.12E}" for v in rows[0])
    return "\n".join([first, *("    " + "".join(f"{v:19.12E}" for v in r) for r in rows[1:])]) + "\n"


def nav3_header(iono=True):
    coefficients = header_line("GPSA   1.1176E-08  7.4506E-09 -5.9605E-08 -5.9605E-08", "IONOSPHERIC CORR")
    coefficients += header_line("GPSB   9.0112E+04  0.0000E+00 -1.9661E+05 -6.5536E+04", "IONOSPHERIC CORR")
    return (
        header_line("     3.04           N: GNSS NAV DATA    M: MIXED", "RINEX VERSION / TYPE")
        + header_line("sample              nobody", "PGM / RUN BY / DATE")
        + (coefficients if iono else "")
        + header_line("    18", "LEAP SECONDS")
        + header_line("", "END OF HEADER")
    )


GLONASS = [
    [5.0e-5, 0.0, 532800.0],
    [11000.0, 1.2, 0.0, 0.0],
    [-8000.0, -2.4, 0.0, 5.0],
    [21600.0, -1.5, 0.0, 0.0],
]


@pytest.fixture
def nav3():
    """A RINEX 3.04 navigation file: G05 and G12 at 04:00, R03 at 04:15 UTC."""
    return (
        nav3_header()
        + nav_record("G05 2024 02 03 04 00 00", NAV_GPS)
        + nav_record("G12 2024 02 03 04 00 00", NAV_GPS)
        + nav_record("R03 2024 02 03 04 15 00", GLONASS)
    )
