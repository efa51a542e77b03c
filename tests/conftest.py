"""Fixtures for all tests."""

from pathlib import Path

import pytest

SHARED = Path(__file__).resolve().parents[1] / "../shared/data"


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder with real data, beside the repository."""
    if not SHARED.is_dir():
        pytest.skip("shared data not here")
    return SHARED.resolve()
