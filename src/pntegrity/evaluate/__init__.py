"""Alarms against truth: false alarms, power, delay, whiteness, calibration; by Monte Carlo and without."""
