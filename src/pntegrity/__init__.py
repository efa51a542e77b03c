"""Integrity monitoring for every estimator that navigates."""

__version__ = "0.1.0"
