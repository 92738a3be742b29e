"""Hypothesis without wall-clock deadlines and with the same cases in every run."""

from hypothesis import settings

settings.register_profile("rm501", deadline=None, derandomize=True)
settings.load_profile("rm501")
