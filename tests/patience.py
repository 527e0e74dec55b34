"""The one limit of every wait in a test.

Tests wait for events, never for a time; the limit ends a test that hangs. A busy machine is slow, not wrong, so the
limit is far above what any event takes on one.
"""

PATIENCE = 300.0
"""Seconds."""
