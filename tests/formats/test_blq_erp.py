"""Ocean loading (BLQ) and Earth rotation (ERP) files."""

import numpy as np
import pytest

from pntegrity.errors import InputError
from pntegrity.formats.blq import read_blq
from pntegrity.formats.erp import read_erp
from pntegrity.physics.time import SECOND_NS, civil_to_ns, from_iso

AMPLITUDES = np.arange(33).reshape(3, 11) / 1000.0
PHASES = np.arange(33).reshape(3, 11) - 16.0


def blq(station="ESBC", amplitude=AMPLITUDES):
    return (
        "$$ Ocean loading displacement\n$$ COLUMN ORDER:  M2  S2  N2  K2  K1  O1  P1  Q1  MF  MM SSA\n$$\n"
        "$$ END HEADER\n$$\n+cmc\n   M2    -1.2661E-03 -1.4298E-03   -1.3724E-03  8.2077E-04\n-cmc\n"
        f"  {station}\n$$ FES2004 ID: 2015\n$$ {station},   RADI TANG  lon/lat:  1.0 2.0 0.0\n"
        + "".join("  " + " ".join(f"{v:.5f}".lstrip("0") for v in row) + "\n" for row in amplitude)
        + "".join("".join(f"{v:7.1f}" for v in row) + "\n" for row in PHASES)
        + "$$ END TABLE\n"
    )


ERP = """VERSION 2
SOMEBODY'S SOLUTION FOR DAY 087, 2019                    02-APR-19 00:53
-----------------------------------------------------------------------
  MJD         X-P      Y-P   UT1UTC    LOD   S-X   S-Y
              E-6"     E-6"    E-7S E-7S/D   E-6"  E-6"
58570.00    46000   379000 -1160940   7148     6     6
58571.00    48000   381000 -1167995   6826     6     6
"""
DAY = civil_to_ns(2019, 3, 28) + 18 * SECOND_NS


@pytest.mark.parametrize("name", ["ESBC", "esbc", "ESBC00DNK", " esbc "])
def test_ocean_loading_of_a_station(save, name):
    loading, notes = read_blq(save(blq()), name)
    assert (loading.station, notes) == ("ESBC", ())
    np.testing.assert_allclose(loading.amplitude_m, AMPLITUDES, atol=1e-9)
    np.testing.assert_allclose(loading.phase_deg, PHASES, atol=1e-9)
    assert not loading.amplitude_m.flags.writeable


def test_a_station_that_is_not_there(save):
    loading, notes = read_blq(save(blq(), "a.blq"), "ONSA")
    assert loading is None
    assert notes == ("a.blq holds no ocean loading for ONSA",)
    assert read_blq(save(blq()), "")[0] is None


def test_the_station_asked_for_among_several(save):
    loading, _ = read_blq(save(blq("ONSA", AMPLITUDES + 0.5) + blq("ESBC")), "ESBC")
    np.testing.assert_allclose(loading.amplitude_m, AMPLITUDES, atol=1e-9)


def test_bad_ocean_loading_raises(save, obs3, tmp_path):
    text = blq()
    with pytest.raises(InputError, match="no station's ocean loading"):
        read_blq(save(obs3), "ESBC")
    with pytest.raises(InputError, match="six rows of eleven") as info:
        read_blq(save(text[:-200]), "ESBC")
    assert info.value.line == 9
    with pytest.raises(InputError, match="columns are"):
        read_blq(save(text.replace("M2  S2", "S2  M2")), "ESBC")
    with pytest.raises(InputError, match="no such file"):
        read_blq(tmp_path / "nothing", "ESBC")


def test_the_pole_is_linear_and_its_times_are_utc(save):
    pole = read_erp(save(ERP, "a.erp"))
    assert pole.t_ns.tolist() == [DAY, DAY + 86_400 * SECOND_NS]
    assert pole.sources == ("a.erp (2019-03-28 to 2019-03-29)",)
    xp, yp = pole.at(
        [DAY - 1, DAY, DAY + 43_200 * SECOND_NS, DAY + 86_400 * SECOND_NS, DAY + 86_401 * SECOND_NS]
    )
    np.testing.assert_allclose(xp, [np.nan, 0.046, 0.047, 0.048, np.nan], atol=1e-12)
    np.testing.assert_allclose(yp, [np.nan, 0.379, 0.380, 0.381, np.nan], atol=1e-12)


def test_files_are_joined_and_the_later_counts(save):
    more = ERP.replace("58570.00    46000", "58572.00    50000").replace("48000", "48500")
    pole = read_erp([save(ERP, "a.erp"), save(more, "b.erp")])
    np.testing.assert_allclose(pole.xp_arcsec, [0.046, 0.0485, 0.050], atol=1e-12)


def test_a_damaged_row_is_left_out_and_told(save):
    pole = read_erp(save(ERP.replace("48000", "48x00"), "a.erp"))
    assert len(pole.t_ns) == 1
    assert pole.notes == ("a.erp line 7 dropped, it cannot be read",)


def test_bad_pole_files_raise(save, obs3, tmp_path):
    with pytest.raises(InputError, match="no ERP file"):
        read_erp(save(obs3))
    with pytest.raises(InputError, match="holds no pole"):
        read_erp(save(ERP[: ERP.index("58570")]))
    with pytest.raises(InputError, match="no such file"):
        read_erp(tmp_path / "nothing")
    with pytest.raises(InputError, match="no Earth rotation file given"):
        read_erp([])


def test_shared_files(shared):
    cpt = shared / "cpt-van-2019087"
    loading, _ = read_blq(cpt / "ocnload.blq.gz", "guam")
    np.testing.assert_allclose(loading.amplitude_m[:, 0], [0.01029, 0.00489, 0.00029])
    np.testing.assert_allclose(loading.phase_deg[:, -1], [-177.4, -167.0, 0.6])
    pole = read_erp(cpt / "COD20464.ERP.gz")
    assert len(pole.t_ns) == 7
    xp, yp = pole.at(from_iso("2019-03-28T00:00:18"))
    assert (float(xp), float(yp)) == pytest.approx((0.046270, 0.379165))
