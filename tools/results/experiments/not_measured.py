"""Shipped scenarios without an experiment, and why."""

_RIVALS = "its agents compete, so no success or return is one of all agents; its page has the results of each"
REASONS: dict[str, str] = {"sumo": _RIVALS, "tag": _RIVALS}
