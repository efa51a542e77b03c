"""The static BRUX log and the products of the ESBC log, read once."""

import pyrtklib as rtk
import pytest
from precise_files import Rtklib, antennas, unpacked

from pntegrity.formats.antex import read_antex
from pntegrity.formats.rinex_clk import read_clocks
from pntegrity.formats.rinex_nav import read_navigation
from pntegrity.formats.rinex_obs import read_observations
from pntegrity.formats.sp3 import read_orbits


@pytest.fixture(scope="session")
def brux_table(shared):
    return read_observations(shared / "brux-static-2019014/BRUX00BEL_S_20190140615_15M_01S_MO.rnx.gz")


@pytest.fixture(scope="session")
def brux_nav(shared):
    return read_navigation(shared / "brux-static-2019014/BRDC00WRD_R_20190140000_01D_MN.rnx.gz")


@pytest.fixture(scope="session")
def esbc(shared):
    folder = shared / "esbc-static-2020177"
    if not folder.is_dir():
        pytest.skip("esbc-static-2020177 not in the shared data")
    return folder


@pytest.fixture(scope="session")
def orbits(esbc):
    return read_orbits(sorted(esbc.glob("*SP3.gz")))


@pytest.fixture(scope="session")
def clocks(esbc):
    return read_clocks(sorted(esbc.glob("*CLK.gz")))


@pytest.fixture(scope="session")
def satellite_antennas(shared):
    return read_antex([shared / "antex/igs14_sats_only.atx.gz"])


@pytest.fixture(scope="session")
def rtklib(esbc, shared, tmp_path_factory):
    """RTKLIB with the products of the ESBC log."""
    folder, nav = tmp_path_factory.mktemp("rtklib"), rtk.nav_t()
    for k, path in enumerate(sorted(esbc.glob("*SP3.gz"))):
        rtk.readsp3(unpacked(path, folder, f"{k}.sp3"), nav, 0)
    assert rtk.readrnxc(unpacked(next(esbc.glob("*CLK.gz")), folder, "clocks.clk"), nav) > 0
    broadcast = unpacked(next(esbc.glob("*_MN.rnx.gz")), folder, "nav.rnx")
    assert rtk.readrnx(broadcast, 1, "", rtk.obs_t(), nav, rtk.sta_t()) == 1
    rtk.uniqnav(nav)
    antennas(nav, unpacked(shared / "antex/igs14_sats_only.atx.gz", folder, "antennas.atx"))
    return Rtklib(nav, folder)
