"""Property tests are the same on every run, and time is not theirs to judge; PERFBOUND_EXPLORE=1 finds new cases."""

import os

from hypothesis import settings

settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.register_profile("explore", max_examples=2000, deadline=None)
settings.load_profile("explore" if os.environ.get("PERFBOUND_EXPLORE") else "repeatable")
