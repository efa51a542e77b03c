"""Damaged bytes: a reader gives a result or an `InputError`, nothing else."""

import contextlib
import tempfile
from pathlib import Path

from conftest_samples import NAV_GPS, nav3_header, nav_record, obs3_epoch, obs3_header, rows_at
from hypothesis import given, settings
from hypothesis import strategies as st

from pntegrity.errors import InputError
from pntegrity.formats.rinex_nav import read_navigation
from pntegrity.formats.rinex_obs import read_observations
from pntegrity.formats.truth import read_truth

OBS = (obs3_header() + "".join(obs3_epoch(6.0 + k, rows_at(k)) for k in range(3))).encode()
NAV = (nav3_header() + nav_record("G05 2024 02 03 04 00 00", NAV_GPS)).encode()
TRUTH = b"gps_week,tow_s,x_m,y_m,z_m\n2299,532800,4e6,3e5,4.9e6\n2299,532801,4e6,3e5,4.9e6\n"


@st.composite
def damaged(draw, original):
    data = bytearray(original)
    for _ in range(draw(st.integers(1, 6))):
        at = draw(st.integers(0, max(len(data) - 1, 0)))
        how = draw(st.sampled_from(("replace", "insert", "delete", "cut", "double")))
        some = draw(
            st.one_of(st.binary(min_size=1, max_size=6), st.sampled_from((b"\n", b">", b"-", b"9" * 20)))
        )
        if how == "replace":
            data[at : at + len(some)] = some
        elif how == "insert":
            data[at:at] = some
        elif how == "delete":
            del data[at : at + draw(st.integers(1, 200))]
        elif how == "cut":
            del data[at:]
        else:
            data[at:at] = data[at : at + 300]
    return bytes(data)


def try_reader(reader, content):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "sample"
        path.write_bytes(content)
        with contextlib.suppress(InputError):
            reader(path)


@settings(max_examples=300, deadline=2000)
@given(damaged(OBS))
def test_observations(content):
    try_reader(read_observations, content)


@settings(max_examples=300, deadline=2000)
@given(damaged(NAV))
def test_navigation(content):
    try_reader(read_navigation, content)


@settings(max_examples=200, deadline=2000)
@given(damaged(TRUTH))
def test_truth(content):
    try_reader(read_truth, content)
