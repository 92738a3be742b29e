"""Benchmarks: `python -m benchmarks.NAME` for one, `python -m benchmarks` for all at their short settings."""
