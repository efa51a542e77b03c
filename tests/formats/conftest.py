"""Fixtures of the format tests."""

import pytest
from conftest_samples import nav3, obs2, obs3

__all__ = ["nav3", "obs2", "obs3", "save"]


@pytest.fixture
def save(tmp_path):
    """Write bytes or text to a file and return its path."""

    def write(content, name="sample.rnx"):
        path = tmp_path / name
        path.write_bytes(content.encode("ascii") if isinstance(content, str) else content)
        return path

    return write
