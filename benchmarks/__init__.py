"""What each stage costs, beside other tools on the same file; run by ``pytest benchmarks``."""
