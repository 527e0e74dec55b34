"""The charts of a problem in a real browser: requirement, captions, importance, prediction, robustness of all rollouts."""

import pytest

from tests.end_to_end import browser as chromium

pytestmark = pytest.mark.browser if hasattr(pytest.mark, "never") else []
browser = chromium.browser
