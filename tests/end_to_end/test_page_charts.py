"""The charts of a problem in a real browser: requirement, captions, importance, prediction, robustness of all rollouts."""

from dataclasses import replace
from pathlib import Path

import pytest
from playwright.sync_api import Browser

from perfbound.orchestrator.report.chart_data import ProblemCharts
from tests.end_to_end import browser as chromium
from tests.end_to_end import example_reports
from tests.end_to_end.pages import opened

pytestmark = pytest.mark.browser if hasattr(pytest.mark, "never") else []
browser = chromium.browser
