"""What may be printed: a compiled scenario from elsewhere is checked before a line of Python is made of it.

The compiler checks what users write. A run directory may come from anyone, though, and its compiled
scenario is printed and run when the policy is evaluated. So every word that would stand in the code
outside of quotes must be an identifier of the language or an entry of a table.

expressions.py  nodes: operations, functions, draws, facts       scopes.py   names in expressions
figures.py      counts, figures, what an episode varies          sensing.py  sensors
actuation.py    actuators, disturbances                          places.py   where bodies begin
world.py        terrain, lines, colours                          policy.py   what is seen, the goal
scripts.py      hand-written policies
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from deepbots_cli.canonical import CanonicalError
from deepbots_cli.compiler.emit.guard.actuation import require_actuators, require_disturbances
from deepbots_cli.compiler.emit.guard.expressions import require_known_nodes
from deepbots_cli.compiler.emit.guard.figures import require_copies, require_counts, require_figures, require_routes, require_variations
from deepbots_cli.compiler.emit.guard.places import require_places
from deepbots_cli.compiler.emit.guard.policy import require_view
from deepbots_cli.compiler.emit.guard.scopes import require_known_names, require_order
from deepbots_cli.compiler.emit.guard.scripts import require_scripts
from deepbots_cli.compiler.emit.guard.sensing import require_sensors
from deepbots_cli.compiler.emit.guard.world import require_world
from deepbots_cli.compiler.emit.text import action_variables
from deepbots_cli.ir import Choices, CompiledScenario

_NAME = re.compile(r"[a-z_][a-z0-9_]*", re.ASCII)
_PYTHON = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*", re.ASCII)


def check_printable(scenario: CompiledScenario) -> None:
    """Refuse what the compiler would never have written.

    Raises:
        CanonicalError: A name is no identifier or defined nowhere, an operation, draw, fact or sensor is not in its
            table, or a figure that the code is made with is out of all bounds.
    """
    for name in _defined_names(scenario):
        if not _NAME.fullmatch(name):
            raise CanonicalError(f"{name[:40]!r} is no name that a scenario may define")
    variables = [variable for part in scenario.action for variable in action_variables(part)]
    if len(set(variables)) < len(variables):
        raise CanonicalError("two variables of the action share a name")
    for foreign in scenario.foreign:
        if not _PYTHON.fullmatch(str(foreign)):
            raise CanonicalError(f"{str(foreign)[:40]!r} is no function of a package")
    require_known_nodes(scenario)
    require_figures(scenario)
    require_routes(scenario)
    require_copies(scenario)
    require_view(scenario)
    require_counts(scenario)
    require_variations(scenario)
    require_world(scenario)
    require_sensors(scenario)
    require_actuators(scenario)
    require_places(scenario)
    require_scripts(scenario)
    require_disturbances(scenario)
    require_known_names(scenario)
    require_order(scenario.endings)


def _defined_names(scenario: CompiledScenario) -> Iterator[str]:
    for robot in scenario.robots:
        yield robot.name
        for entries in (robot.sensors, robot.actuators, robot.receive, robot.emit, robot.apply):
            yield from (entry.name for entry in entries)
    for named in (
        scenario.parameters,
        scenario.signals,
        scenario.reward,
        scenario.endings,
        scenario.action,
        scenario.disturbances,
        scenario.scripts,
    ):
        yield from (entry.name for entry in named)
    for part in scenario.action:
        if isinstance(part, Choices):
            yield from part.variables
            yield from (option.name for option in part.options)
