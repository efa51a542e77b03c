"""Files -> records: one module a format."""
