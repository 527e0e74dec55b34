"""Property tests are the same on every run, and judge no time; PERFBOUND_EXPLORE=1 finds new cases."""

import os

from hypothesis import HealthCheck, settings

TIMELESS = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("repeatable", TIMELESS, derandomize=True)
settings.register_profile("explore", TIMELESS, max_examples=2000)
settings.load_profile("explore" if os.environ.get("PERFBOUND_EXPLORE") else "repeatable")
