"""From epochs to updates. One estimator a module."""
