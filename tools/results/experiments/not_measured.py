"""Shipped scenarios without an experiment, and why."""

REASONS: dict[str, str] = {}
