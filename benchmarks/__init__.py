"""What each stage costs, beside other tools on the same file. Not part of the tests: ``pytest
benchmarks``.
"""
