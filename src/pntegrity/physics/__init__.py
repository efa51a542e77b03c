"""Orbits, clocks, atmosphere, frames, time and signals: thin calls into sidereon."""
