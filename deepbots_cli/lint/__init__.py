"""Lint: rules about scenarios that compile and are probably not what their author means, fixes, and project
settings.

A static rule is a generator from a `RuleContext` to findings, a simulated rule one from a `Simulation`. No
rule uses another rule. The decorator `rule` gives a rule its code, and says whether it judges a simulation,
and which versions of a scenario: by default itself and with the settings of each case and each stage. Its
page is in `rule_pages`, by this code.

names.py         places left to the author, unused definitions, equality of          DB109, DB205, DB411,
                 measurements, angles that jump                                      DB506
robots.py        commands, actuators, wheels that slip, robots that topple           DB312, DB313, DB315,
                                                                                     DB317, DB319, DB322,
                                                                                     DB324, DB325
geometry.py      rays of sensors that meet nothing, mirror images of joints          DB615, DB618
world.py         objects out of scale, means of engines, how episodes begin          DB309, DB310, DB316,
                                                                                     DB323, DB507, DB809,
                                                                                     DB812
observations.py  what the policy sees                                                DB6
rewards.py       the size of the reward; incentives.py what it pays for              DB7, DB810
endings.py       when episodes end, goals that cannot be reached                     DB8
exploits.py      rewards that pay for something other than success                   DB712 to DB715, DB717

pages.py         the pages of findings, of which `rule_pages` contains the texts
run.py           runs the rules, with and without a simulation; drops what follows from other findings
context.py       the code of a rule, and what a rule is given: the scenario, its analysis, places in its text,
                 the report of its simulation
simulation.py    plan, process and report of a simulation; simulation_process.py, rollouts.py, watches.py and
                 search.py run in that process
fixes.py         applies fixes; settings.py which files are linted, and how
"""

from __future__ import annotations

from deepbots_cli.lint.exploits import EXPLOIT_RULES
from deepbots_cli.lint.run import (
    SIMULATED_RULES,
    STATIC_RULES,
    FoundExploits,
    SimulationFindings,
    all_findings,
    find_exploits,
    simulate,
    static_findings,
)
from deepbots_cli.lint.simulation import Limits

__all__ = [
    "EXPLOIT_RULES",
    "SIMULATED_RULES",
    "STATIC_RULES",
    "FoundExploits",
    "Limits",
    "SimulationFindings",
    "all_findings",
    "find_exploits",
    "simulate",
    "static_findings",
]
