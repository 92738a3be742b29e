"""Settings for all tests: properties are the same examples in every run, and no deadline judges a busy machine."""

from hypothesis import settings

settings.register_profile("rm501", deadline=None, derandomize=True)
settings.load_profile("rm501")
