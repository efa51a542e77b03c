"""Truth in, the same observations and updates out that a real receiver and filter would give; and faults."""
