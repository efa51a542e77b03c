"""Experiments as data: the papers' own, beside their published figures, and the embedded demo."""
