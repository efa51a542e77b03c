"""Tests of updates. One monitor a module; each sees records and kernels only."""
