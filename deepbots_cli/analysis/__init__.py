"""From a program to what is known of its values without a simulation.

`Analysis` follows names to their definitions as scalar trees, message fields to the sensors behind them, and
sensors to the facts that they measure. It says what a value depends on.

analysis.py    what a value is defined by and depends on; which values are the same quantity
ranges.py      the interval of a value, in any step and right after a reset; intervals as text
conditions.py  the comparisons in a condition, the thresholds that they set, endings that hide others
deployment.py  the readings of the world that a policy needs on a real robot
returns.py     what the terms of the reward pay in a step and at an end, and the return of an episode
changes.py     what differs between two scenarios
speeds.py      limits of speed, and the return that they allow
shown_units.py in which unit a quantity is shown: the one in which the file writes it
"""

from __future__ import annotations

from deepbots_cli.analysis.analysis import Analysis, possible_returns, unobserved_reads

__all__ = ["Analysis", "possible_returns", "unobserved_reads"]
