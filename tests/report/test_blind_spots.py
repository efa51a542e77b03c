from dataclasses import replace

import pytest

from pntegrity.monitors.aime import Aime
from pntegrity.monitors.separation import Separation
from pntegrity.monitors.sraime import Sraime
from pntegrity.monitors.srctm import Srctm
from pntegrity.report.blind_spots import blind_spots
from pntegrity.sensors.noise import PPP, PPP_RTK, PPP_RTK_PUBLISHED, NoiseModel

MONITORS = (Aime(), Srctm(), Sraime())


def told(**changes) -> str:
    model = replace(PPP, **changes.pop("noise", {}))
    return " ".join(blind_spots("ppp", model, **{"monitors": MONITORS} | changes))


def test_figures_are_those_of_the_model():
    noise = {"ambiguity_m": 2e-3, "code_white_m": 0.2, "code_bias_m": 0.0, "glonass_code_bias_m": 0.0}
    text = told(noise=noise)
    assert "sigma 1.5 cm in 60 s, 4.9 cm in 10 min, 0.12 m in 1 h" in text
    assert "0.60 m at the zenith and 1.20 m at 30°" in text
    assert "GLONASS" not in text
    assert "code bias, 12.0 m" in told(noise=noise | {"glonass_code_bias_m": 4.0})
    assert "code bias, 0.90 m" in told(noise=noise | {"code_bias_m": 0.3})
    assert "2.3 cm in 60 s" in told(noise={"isb_m": 0.001})


@pytest.mark.parametrize(
    ("changes", "blind"),
    [
        ({}, "SRCTM and SRAIME compare"),
        ({"motion": "static"}, ""),
        ({"monitors": (Aime(),)}, ""),
        ({"monitors": (Aime(), Sraime())}, "SRAIME compare"),
    ],
)
def test_position_tests_are_blind_where_every_epoch_forgets_the_position(changes, blind):
    text = told(**changes)
    assert blind in text
    assert ("forgets the position" in text) is bool(blind)


def test_other_estimators_have_their_own():
    (alone,) = blind_spots("spp", NoiseModel())
    assert "stands alone" in alone
    code = " ".join(blind_spots("spp_kf", NoiseModel()))
    assert "up to about 3 m" in code
    assert "7.5 mm in 1 s and 5.8 cm in 60 s" in code
    assert "ambiguity" not in code
    assert "0.08 m / sin(elevation) over 6 s" in code
    by_power = " ".join(blind_spots("spp_kf", replace(NoiseModel(), elevation_power=2.0)))
    assert "0.08 m / sin(elevation)^2 over 6 s" in by_power
    assert len(blind_spots("spp_kf", replace(NoiseModel(), code_bias_m=0.0, code_multipath_m=0.0))) == 1


def test_products_hide_what_their_bias_states_expect():
    text = " ".join(blind_spots("ppp_rtk", PPP_RTK))
    assert "of the stated size over 30 min" in text
    assert "Ambiguities walk" in text
    assert "taken for white" in " ".join(blind_spots("ppp_rtk", PPP_RTK_PUBLISHED))
    assert "atmosphere product" not in told()


@pytest.mark.parametrize("estimator", ["spp", "spp_kf", "ppp", "ppp_rtk"])
def test_what_separation_does_not_see_is_said_where_it_runs(estimator):
    assert any(s.startswith("SEPARATION") for s in blind_spots(estimator, PPP_RTK, "white", (Separation(),)))
    assert not any(s.startswith("SEPARATION") for s in blind_spots(estimator, PPP_RTK))
    (observed,) = (
        s
        for s in blind_spots(estimator, PPP_RTK, "white", (Separation(levels="observed"),))
        if s.startswith("SEPARATION")
    )
    assert "does not alarm" in observed
