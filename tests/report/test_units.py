import pytest

from pntegrity.report.units import duration, length, together


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (60.0, "60.0 m"),
        (-39.94, "-39.9 m"),
        (1.063, "1.06 m"),
        (0.1, "0.10 m"),
        (0.0996, "0.10 m"),
        (0.0994, "9.9 cm"),
        (-0.012, "-1.2 cm"),
        (0.00996, "1.0 cm"),
        (0.0049, "4.9 mm"),
        (0.00067, "0.67 mm"),
        (1e-4, "0.10 mm"),
        (-6.7e-6, "-0.0067 mm"),
        (0.0, "0.0 mm"),
    ],
)
def test_no_length_loses_its_digits(value, text):
    assert length(value) == text


def test_a_rate_has_its_unit():
    assert length(0.2, "/s") == "0.20 m/s"
    assert length(0.02 / 30.0, "/s") == "0.67 mm/s"


def test_several_share_a_unit_where_they_can():
    assert together(1.063, 1.43) == "1.06 and 1.43 m"
    assert together(0.021, 0.034) == "2.1 and 3.4 cm"
    assert together(0.09, 0.26) == "9.0 cm and 0.26 m"


@pytest.mark.parametrize(
    ("s", "text"), [(1, "1 s"), (30, "30 s"), (150, "2.5 min"), (900, "15 min"), (3600, "1 h")]
)
def test_durations(s, text):
    assert duration(s) == text
