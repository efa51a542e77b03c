"""The static BRUX log, read once."""

import pytest

from pntegrity.formats.rinex_nav import read_navigation
from pntegrity.formats.rinex_obs import read_observations


@pytest.fixture(scope="session")
def brux_table(shared):
    return read_observations(shared / "brux-static-2019014/BRUX00BEL_S_20190140615_15M_01S_MO.rnx.gz")


@pytest.fixture(scope="session")
def brux_nav(shared):
    return read_navigation(shared / "brux-static-2019014/BRDC00WRD_R_20190140000_01D_MN.rnx.gz")
