"""Prints the supervisor class: its bindings, the methods of resets and steps, the paper's methods and
hand-written policies."""

from __future__ import annotations

from collections.abc import Sequence
from typing import get_args

from deepbots_cli.codegen.names import (
    Constants,
    block,
    class_name,
    docstring,
    fill_template,
    quoted,
    quoted_tuple,
    tuple_code,
)
from deepbots_cli.codegen.printer import Printer
from deepbots_cli.codegen.reset import begin_method, bind_pushes, needs_arrangement, push_methods
from deepbots_cli.codegen.robot import controller_names
from deepbots_cli.codegen.step import (
    advance_methods,
    bind_python_functions,
    choice_tables,
    observe_method,
    start_method,
)
from deepbots_cli.codegen.workspace import SupervisorPrinter
from deepbots_cli.expressions.lower import fold_operation
from deepbots_cli.expressions.scalar import Const, Op, Scalar
from deepbots_cli.expressions.text import BATCH
from deepbots_cli.program import Program, generated
from deepbots_cli.program.robots import Direction
from deepbots_cli.program.task import ActionRange, Choices, Script, ScriptedChoice, ScriptedRange
from deepbots_cli.words import sentence_list

_CLASS = '''
class {name}Supervisor(Supervisor):
    {doc}

    {tables}
    def bind(self, engine: Any) -> None:
        {binding}

    {methods}
    def get_observations(self) -> Any:
        {seen}
        return {observation}

    def get_reward(self) -> float:
        {summed}
        return self.reward

    def is_done(self) -> tuple[bool, bool]:
        {ended}
        return self.terminated, self.truncated

    def get_info(self) -> dict[str, Any]:
        """How the episode ended, if it has, and the terms of the last reward."""
        terms = {{{terms}}}
        return {{{info}}}

    {asked}
'''


_BATCH_CLASS = """
class {name}Batch(BatchSupervisor):
    {doc}

    {tables}
    {state}
    def bind(self, engine: Any) -> None:
        {binding}

    {methods}
"""


def print_batch_supervisor(
    scenario: Program, constants: Constants, scripts: Sequence[Script] = ()
) -> list[str]:
    """Return the lines of the class for a batch: only the steps and these scripts are printed; episodes begin
    in the single worlds."""
    supervisor = SupervisorPrinter(scenario, constants, BATCH, scripts)
    observing = observe_method(supervisor)
    acting = advance_methods(supervisor)
    methods = [*acting, *observing, *(line for script in scripts for line in _script(supervisor, script))]
    for name, lines in supervisor.per_world.items():
        methods += ["@staticmethod", *block(f"def {name}(self: Any) -> None:", lines)]
    tables = choice_tables(supervisor)
    terms = tuple(term.name for term in supervisor.agent.reward)
    return fill_template(
        _BATCH_CLASS,
        name=class_name(scenario.name),
        doc=docstring(scenario.summary or scenario.name),
        tables=[*tables, ""] if tables else [],
        state=[
            *([f"STATE = {quoted_tuple(tuple(supervisor.state))}"] if supervisor.state else []),
            f"TERMS = {quoted_tuple(terms)}",
            "",
        ],
        binding=[*_bind_robots(supervisor), *supervisor.bind_lines()],
        methods=methods,
    )


def print_supervisor(scenario: Program, constants: Constants) -> list[str]:
    """Return the lines of the class."""
    supervisor = SupervisorPrinter(scenario, constants)
    # Printed before `begin_method`, which initializes everything that these methods read.
    observing = observe_method(supervisor)
    acting = advance_methods(supervisor)
    pushing = push_methods(supervisor)
    queries = [*_allowed(supervisor), *_compute_reward(supervisor), *_between_steps(supervisor)]
    methods = [*begin_method(supervisor), *pushing, *start_method(supervisor), *acting, *observing]
    tables = choice_tables(supervisor)
    terms = ", ".join(
        f"{quoted(term.name)}: self.{generated.term(term.name)}" for term in supervisor.agent.reward
    )
    is_scaled = not supervisor.agent.images and all(n.clip or n.is_truth for n in supervisor.agent.numbers)
    kind = ", float32 in [-1, 1]" if is_scaled else ""
    info = '"is_success": self.is_success, "ended_by": self.ended_by, "endings": self.endings'
    return fill_template(
        _CLASS,
        name=class_name(scenario.name),
        doc=docstring(scenario.summary or scenario.name),
        tables=[*tables, ""] if tables else [],
        binding=_bind(supervisor),
        methods=methods,
        seen=docstring(f"What the policy sees{kind}: {_observation_text(supervisor)}."),
        observation=_observation(supervisor),
        summed=docstring(f"The sum of {sentence_list([term.name for term in supervisor.agent.reward])}."),
        ended=docstring(f"Whether {', and whether '.join(_ends(scenario))}."),
        terms=terms,
        info=info
        + (', "agent_endings": dict(self.agent_endings)' if supervisor.agents_alone else "")
        + (', "action_mask": self.action_mask()' if supervisor.forbids_options else "")
        + ', "reward_terms": terms',
        asked=queries,
    )


def _bind_robots(supervisor: SupervisorPrinter) -> list[str]:
    lines = []
    class_names = controller_names(supervisor.scenario)
    for robot in supervisor.scenario.robots:
        name = robot.name
        lines.append(f"self.{generated.robot(name)} = self.robot({quoted(name)}, {class_names[name]})")
        for direction in get_args(Direction):
            method = "channel" if supervisor.scenario.is_direct(robot, direction) else "lossy_channel"
            lines.append(
                f"self.{generated.channel(robot.name, direction)} = self.{method}({quoted(robot.name)},"
                f" {quoted(direction)})"
            )
    for link in supervisor.scenario.links:
        ends = f"{quoted(link.sender)}, {quoted(link.receiver)}"
        lines.append(f"self.{generated.link(link.sender, link.receiver)} = self.link({ends})")
    return lines


def _bind(supervisor: SupervisorPrinter) -> list[str]:
    scenario = supervisor.scenario
    lines = _bind_robots(supervisor)
    arranged = needs_arrangement(scenario)
    lines += ["self.bodies = Arrangement(self.scenario, engine)"] if arranged else []
    if supervisor.readers.needs_paths:
        lines.append(f"self.ways = Ways(self.scenario, engine{', self.bodies' if arranged else ''})")
    return [
        *lines,
        *supervisor.bind_lines(),
        *bind_pushes(supervisor),
        *bind_python_functions(supervisor),
    ] or ["pass"]


# The paper's methods, which read the results of `_observe` and change nothing


def _observation_text(supervisor: SupervisorPrinter) -> str:
    histories = {entry.name: entry.history for entry in supervisor.agent.observation}
    text = sentence_list(
        [name if many == 1 else f"{name} ({many} in a row)" for name, many in histories.items()]
    )
    text += f"; {supervisor.agent.frame_stack} times in a row" if supervisor.agent.frame_stack > 1 else ""
    return text + ("; and what is achieved and desired" if supervisor.agent.goal is not None else "")


def _observation(supervisor: SupervisorPrinter) -> str:
    """Return the code of each part of an observation, under its key where there are several."""
    agent = supervisor.agent
    parts = {"observation": "self.seen()"} if agent.numbers or not agent.images else {}
    parts |= {
        pictured.key: f"self.frame_stacks[{quoted(pictured.key)}].seen(self.newest)"
        for pictured in agent.images
    }
    if agent.goal is not None:
        size = len(agent.goal.low)
        parts |= {"achieved_goal": f"self.goal[:{size}].copy()", "desired_goal": f"self.goal[{size}:].copy()"}
    if set(parts) == {"observation"}:
        return parts["observation"]
    return f"{{{', '.join(f'{quoted(key)}: {part}' for key, part in parts.items())}}}"


def _ends(scenario: Program) -> list[str]:
    ends = (
        [f"the task ended ({sentence_list([ending.name for ending in scenario.endings], 'or')})"]
        if scenario.endings
        else []
    )
    limits = scenario.truncation.limits
    return [*ends, f"a limit cut the episode short ({sentence_list(limits, 'or')})"]


def _allowed(supervisor: SupervisorPrinter) -> list[str]:
    """Return the method that returns the options that may be chosen next; nothing if no option is ever
    forbidden."""
    if not supervisor.forbids_options:
        return []
    rows = [
        f"self.{generated.allowed(part.name)}"
        if any(option.forbidden for option in part.options)
        else tuple_code(["True"] * len(part.options))
        for part in supervisor.choices
    ]
    doc = docstring(
        f"Which options of {sentence_list([part.name for part in supervisor.choices])} may be chosen next."
    )
    return block("def allowed(self) -> tuple[tuple[bool, ...], ...]:", [*doc, f"return {tuple_code(rows)}"])


def _compute_reward(supervisor: SupervisorPrinter) -> list[str]:
    """Return the method that hindsight replay calls; nothing without a goal."""
    if supervisor.agent.goal is None:
        return []
    doc = docstring("The reward for other goals, as the policy sees them: arrays (n, k) or (k,).")
    return block(
        "def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any = None) -> Any:",
        [*doc, "return self.reward_for(achieved_goal, desired_goal)"],
    )


# Hand-written policies


def _between_steps(supervisor: SupervisorPrinter) -> list[str]:
    """Return methods that read the values of the last timestep. They are called between two steps, on request
    only."""
    lines = [line for script in supervisor.agent.scripts for line in _script(supervisor, script)]
    for test in supervisor.scenario.tests:
        questions: dict[generated.TestQuestion, tuple[tuple[Scalar, ...], str]] = {
            "holds": (test.scalars, "Whether each condition"),
            "compared": (test.compared, "The compared values of the conditions"),
        }
        for question, (scalars, note) in questions.items():
            printer = _printer_after(supervisor, scalars)
            printer.line(f"return {printer.tuple(scalars) if scalars else '()'}")
            head = f"def {generated.test(test.name, question)}(self) -> tuple[Any, ...]:"
            lines += block(head, printer.method_lines(docstring(f"{note} of the test {test.name}.")))
    return lines


def _printer_after(supervisor: SupervisorPrinter, scalars: tuple[Scalar, ...]) -> Printer:
    """Return a printer for these values after the last timestep: the reward of that timestep is known."""
    printer = Printer(supervisor, settable=supervisor.settable, renamed=supervisor.last_rewards())
    used = supervisor.names_read(scalars)
    local_names = [supervisor.local(name) for name in supervisor.stored_names() if name in used]
    printer.lines += [f"{local} = self.{generated.last(local)}" for local in local_names]
    printer.insert_readers_here()
    return printer


def _script(supervisor: SupervisorPrinter, script: Script) -> list[str]:
    """Return the method that computes the next action."""
    printer = _printer_after(supervisor, script.scalars)
    choices, ranges = [], []
    for part, decided in zip(supervisor.agent.action, script.parts, strict=True):
        if isinstance(part, Choices) and isinstance(decided, ScriptedChoice):
            choices.append(_print_pick(supervisor, printer, part, decided))
        elif isinstance(part, ActionRange) and isinstance(decided, ScriptedRange):
            ranges += [_normalized_code(printer, part, value) for value in decided.scalars]
    printer.line(
        f"return self.make_action({tuple_code(choices) if choices else '()'},"
        f" {tuple_code(ranges) if ranges else '()'})"
    )
    return block(
        f"def {generated.script(script.name)}(self) -> Any:",
        printer.method_lines(docstring(f"The next action of the script {script.name}.")),
    )


def _print_pick(supervisor: SupervisorPrinter, printer: Printer, part: Choices, pick: ScriptedChoice) -> str:
    """Print the choice of an option, and return the local with its number."""
    target = supervisor.names(f"{part.name} pick")
    names = [option.name for option in part.options]
    if supervisor.target is BATCH:
        numbers = [Const(names.index(option)) for option in pick.options]
        tree: Scalar = numbers[-1]
        # The first condition has precedence, so its `where` is the outermost.
        for condition, number in zip(reversed(pick.scalars), reversed(numbers[:-1]), strict=True):
            tree = Op("where", (condition, number, tree))
        printer.line(f"{target} = {printer.value(tree)}")
        return target
    for index, option in enumerate(pick.options):
        setting = f"{target} = {names.index(option)}  # {option}"
        if len(pick.options) == 1:
            printer.line(setting)
            break
        last = index == len(pick.scalars)
        head = "else:" if last else f"{'elif' if index else 'if'} {printer.value(pick.scalars[index])}:"
        printer.lines += [head, f"    {setting}"]
    return target


def _normalized_code(printer: Printer, part: ActionRange, value: Scalar) -> str:
    """Return the code of the number in [-1, 1] that represents the value; a constant is clamped here."""
    half, middle = (part.high - part.low) / 2, (part.high + part.low) / 2
    share = fold_operation("div", fold_operation("sub", value, Const(middle)), Const(half))
    if isinstance(share, Const):
        return repr(min(max(float(share.value), -1.0), 1.0))
    return f"clip({printer.value(share)})"
