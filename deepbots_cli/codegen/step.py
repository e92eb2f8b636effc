"""Prints the method of a step, and the computation in each timestep of it.

A step of the agent decodes its action, sends one message to each robot, and goes on for `action_repeat` ticks
or until the episode ends. `_observe` computes all values from the world and the messages, in the order of the
language: signals and the goal once, then terminations, truncation, rewards (which see the endings), then the
observation. Failure beats success; terminated beats truncated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from deepbots_cli.codegen.names import block, indent, quoted, targets_code, tuple_code, with_comment
from deepbots_cli.codegen.printer import Printer, outer_states
from deepbots_cli.codegen.reset import print_draws_of_message, print_redraws, std_attribute
from deepbots_cli.codegen.robot import observes_each_timestep
from deepbots_cli.codegen.workspace import SupervisorPrinter, zeros
from deepbots_cli.expressions.functions import Code, number_code
from deepbots_cli.expressions.scalar import Const, Name, names_in
from deepbots_cli.program import ENDED, EPISODE_RETURN, PREVIOUS_REWARD, TERMINATED, generated, qualified_name
from deepbots_cli.program.robots import Link, Robot, Route
from deepbots_cli.program.task import Observation, Option
from deepbots_cli.program.values import Expression, Noise

_SUMMANDS = 100


def start_method(supervisor: SupervisorPrinter) -> list[str]:
    """Return the method that runs right after a reset."""
    lines = ['"""Observe the start of an episode."""', *supervisor.readers.start_lines()]
    lines += _zeroed([*_terms(supervisor), *_rewards_of_agents(supervisor)])
    if supervisor.repeats_actions:
        lines += _zeroed([supervisor.previous_reward_of(agent) for agent in _previous(supervisor)])
    lines += [f"{supervisor.ended_of(agent)} = False" for agent in supervisor.agents_alone]
    lines += _zeroed([supervisor.return_of(agent) for agent in supervisor.agents_that_use(EPISODE_RETURN)])
    lines.append(
        f"self._observe({', '.join(zeros(components) for _, components in supervisor.action_names_read)})"
    )
    return block("def _start(self) -> None:", [*lines, *_start_memories_of_messages(supervisor)])


def advance_methods(supervisor: SupervisorPrinter) -> list[str]:
    """Return the method of a step, and the method of a timestep if a step has several."""
    printer = supervisor.printer()
    _print_acting(supervisor, printer)
    result = "Iterator[None]" if supervisor.is_of_copy else "None"
    acting = [supervisor.local(name) for name, _ in supervisor.action_names_read]
    if not supervisor.repeats_actions:
        _print_tick(supervisor, printer)
        doc = '"""Act, simulate one timestep, and observe."""'
        return block(f"def _advance(self, action: Any) -> {result}:", printer.method_lines([doc]))
    repeat = supervisor.scenario.action_repeat
    if supervisor.uses("previous_reward"):
        printer.line("self.previous_reward = self.reward")
    printer.lines += [
        f"{supervisor.previous_reward_of(agent)} = {supervisor.reward_of(agent)}"
        for agent in _previous(supervisor)
    ]
    printer.lines += _zeroed(["self.reward", *_terms(supervisor), *_rewards_of_agents(supervisor)])
    printer.line(f"for _ in {'range' if printer.on_floats else 'self.ticks'}({repeat}):")
    printer.line(f"    {'yield from ' if supervisor.is_of_copy else ''}self._tick({', '.join(acting)})")
    printer.lines += (
        ["    if self.terminated or self.truncated:", "        break"] if printer.on_floats else []
    )
    ticking = supervisor.printer()
    ticking.add_in_place("self.timestep_count", "1")
    _print_tick(supervisor, ticking)
    arguments = ", ".join(["self", *_parameters(supervisor)])
    doc = f'"""Repeat an action for {repeat} timesteps. The reward is their sum."""'
    return [
        *block(f"def _advance(self, action: Any) -> {result}:", printer.method_lines([doc])),
        *block(
            f"def _tick({arguments}) -> {result}:",
            ticking.method_lines(['"""Simulate one timestep, and observe."""']),
        ),
    ]


def observe_method(supervisor: SupervisorPrinter) -> list[str]:
    """Return the method that computes everything, once per timestep and right after a reset."""
    printer = supervisor.printer()
    for robot in supervisor.scenario.robots:
        _print_receiving(supervisor, printer, robot)
    for link in supervisor.scenario.links:
        heard = [supervisor.local(f"{link.receiver}.{value.name}") for value in link.values]
        printer.line(f"{targets_code(heard)} = self.{generated.link(link.sender, link.receiver)}.newest()")
    printer.insert_readers_here()
    for entry in supervisor.scenario.signals:
        printer.assign(
            supervisor.local(entry.name),
            printer.vector_or_number(entry.components, entry.scalars),
            entry.text,
        )
        _print_noise(
            supervisor,
            printer,
            supervisor.local(entry.name),
            entry.components,
            f"augment.{entry.name}",
            entry.noise,
        )
    _print_goal(supervisor, printer)
    _print_endings(supervisor, printer)
    _print_rewards(supervisor, printer)
    _print_observation(supervisor, printer)
    _print_masks(supervisor, printer)
    printer.lines += supervisor.storing_statements()
    arguments = ", ".join(["self", *_parameters(supervisor)])
    doc = '"""Receive, and compute signals, endings, the reward and the observation."""'
    return block(f"def _observe({arguments}) -> None:", printer.method_lines([doc]))


def _parameters(supervisor: SupervisorPrinter) -> list[str]:
    return [
        f"{supervisor.local(name)}: {'Any' if components else 'float'}"
        for name, components in supervisor.action_names_read
    ]


def _zeroed(targets: list[str]) -> list[str]:
    """Return statements that set these to 0, as many in one as fit."""
    lines: list[str] = []
    for target in targets:
        if lines and len(lines[-1]) + len(target) < 90:
            lines[-1] = f"{lines[-1].removesuffix('0.0')}{target} = 0.0"
        else:
            lines.append(f"{target} = 0.0")
    return lines


def _terms(supervisor: SupervisorPrinter) -> list[str]:
    return [f"self.{generated.term(term.name)}" for term in supervisor.agent.reward]


def _previous(supervisor: SupervisorPrinter) -> list[str]:
    """Return those among several agents that use the reward of the step before."""
    return supervisor.agents_that_use(PREVIOUS_REWARD)


def _rewards_of_agents(supervisor: SupervisorPrinter) -> list[str]:
    """Return the attributes with the rewards of those among several agents whose rewards are read."""
    agents = supervisor.agents_that_use(PREVIOUS_REWARD, EPISODE_RETURN)
    return [supervisor.reward_of(agent) for agent in agents]


# Acting


def choice_tables(supervisor: SupervisorPrinter) -> list[str]:
    """Return the values that each option sets, as one dictionary per choice; and the one-hot vector of the
    choice where it is read."""
    lines = []
    hot = ("1.0", "0.0") if supervisor.ranges else ("True", "False")
    for part in supervisor.choices:
        rows = [[repr(value) for value in option.values] for option in part.options]
        names = ", ".join(option.name for option in part.options)
        lines.append(
            f"CHOICES_{part.name} = {_table([row[0] if len(row) == 1 else tuple_code(row) for row in rows])}"
            f"  # {names}"
        )
        if supervisor.agent_action_read:
            size = range(len(part.options))
            lines.append(
                f"TAKEN_{part.name} ="
                f" {_table([tuple_code([hot[index != column] for column in size]) for index in size])}"
            )
    return lines


def _table(rows: list[str]) -> str:
    return f"{{{', '.join(f'{index}: {row}' for index, row in enumerate(rows))}}}"


def _print_acting(supervisor: SupervisorPrinter, printer: Printer) -> None:
    """Print the statements that run once per step: the action, and the messages that carry it."""
    _print_decoding(supervisor, printer)
    if printer.on_floats:
        print_redraws(supervisor, printer)
    else:
        _print_redrawing(supervisor, printer)
    printer.add_in_place("self.step_count", "1")
    if supervisor.has_history:
        printer.line("self.next_frame()")
    printer.lines += [
        f"{local} = {supervisor.attribute(generated.last(local))}" for local in supervisor.sent_names()
    ]
    printer.insert_readers_here()
    for robot in supervisor.scenario.robots:
        channel = f"self.{generated.channel(robot.name, 'to_robot')}"
        values = [printer.vector_or_number(entry.components, entry.scalars) for entry in robot.received]
        _print_draws_of_message(supervisor, printer, channel, robot.to_route)
        printer.line(f"{channel}.send({tuple_code(values) if values else '()'})")
        if not _delivers_in_ticks(supervisor, robot):
            _print_delivering(supervisor, printer, robot)


def _print_decoding(supervisor: SupervisorPrinter, printer: Printer) -> None:
    """Print statements that set the action variables from `action`, which has `choices` and `ranges` if there
    are both."""
    choices = ranges = "action"
    if supervisor.choices and supervisor.ranges:
        choices, ranges = supervisor.names("chosen part"), supervisor.names("ranged part")
        printer.line(f'{choices}, {ranges} = action["choices"], action["ranges"]')
    picks = (
        [choices]
        if len(supervisor.choices) == 1
        else [supervisor.names(f"{part.name} pick") for part in supervisor.choices]
    )
    if len(picks) > 1:
        # The action of a batch has a row for each world and a column for each choice.
        printer.line(f"{', '.join(picks)} = {choices}{'' if printer.on_floats else '.T'}")
    looked_up = "{}[{}]" if printer.on_floats else "pick({}, {})"
    variables = {
        part.name: f"*{looked_up.format(f'self.TAKEN_{part.name}', pick)}"
        for part, pick in zip(supervisor.choices, picks, strict=True)
    }
    for part, pick in zip(supervisor.choices, picks, strict=True):
        printer.line(
            f"{', '.join(map(supervisor.local, part.variables))} ="
            f" {looked_up.format(f'self.CHOICES_{part.name}', pick)}"
        )
    names = {interval.name: supervisor.local(interval.name) for interval in supervisor.ranges}
    vectors = [interval.name for interval in supervisor.ranges if interval.components]
    if len(vectors) == len(supervisor.ranges) == 1:
        (name,) = vectors
        printer.line(f"{names[name]} = self.ranges({ranges})")
        variables[name] = f"*{names[name]}"
    elif vectors:
        values = supervisor.names("values of ranges")
        index = 0
        printer.line(f"{values} = self.ranges({ranges})")
        for interval in supervisor.ranges:
            end = index + max(1, len(interval.components))
            printer.line(
                f"{names[interval.name]} = {values}[{f'{index}:{end}' if interval.components else index}]"
            )
            variables[interval.name] = f"*{values}[{index}:{end}]"
            index = end
    elif supervisor.ranges:
        printer.line(f"{targets_code(list(names.values()))} = self.ranges({ranges})")
        variables |= names
    if supervisor.agent_action_read:
        parts = [variables[part.name] for part in supervisor.agent.action]
        previous = parts[0][1:] if len(parts) == 1 and parts[0][0] == "*" else tuple_code(parts)
        printer.line(f"{supervisor.local('previous_action')} = {previous}")
    for interval in supervisor.ranges:
        half, middle = (interval.high - interval.low) / 2, (interval.high + interval.low) / 2
        name = supervisor.local(interval.name)
        if (half, middle) != (1.0, 0.0):
            item = "a" if interval.components else name
            code = f"{middle!r} + {half!r} * {item}" if middle else f"{half!r} * {item}"
            range_comment = (
                f"{interval.low:g} .. {interval.high:g} {interval.unit if interval.unit != '1' else ''}"
            )
            printer.lines += with_comment(
                f"{name} = {f'[{code} for a in {name}]' if interval.components else code}", range_comment
            )
    for agent in supervisor.agents_alone:
        _print_rest(supervisor, printer, agent)


def _print_rest(supervisor: SupervisorPrinter, printer: Printer, agent: str) -> None:
    """Print the action of an agent whose episode has ended: the values that are nearest to 0."""
    first, last = (supervisor.scenario.members[agent].choices, supervisor.scenario.members[agent].ranges)
    resting: dict[str, str] = {}
    for part in supervisor.choices[slice(*first)]:
        still = next((option for option in part.options if not any(option.values)), part.options[0])
        resting |= {name: repr(value) for name, value in zip(part.variables, still.values, strict=True)}
    names = set(supervisor.agent.range_names[slice(*last)])
    for interval in supervisor.ranges:
        if not names.isdisjoint(interval.names):
            resting[interval.name] = repr(min(max(0.0, interval.low), interval.high))
    components = dict(supervisor.variables)
    ended = supervisor.ended_of(agent)
    if printer.on_floats:
        printer.line(f"if {ended}:")
        for name, value in resting.items():
            many = len(components[name])
            printer.line(f"    {supervisor.local(name)} = {f'({value},) * {many}' if many else value}")
        return
    for name, value in resting.items():
        local = supervisor.local(name)
        code = f"[np.where({ended}, {value}, a) for a in {local}]"
        printer.line(f"{local} = {code if components[name] else f'np.where({ended}, {value}, {local})'}")


def _print_redrawing(supervisor: SupervisorPrinter, printer: Printer) -> None:
    """Print for a batch the draws that are due in single worlds, and the update of the columns that
    changed."""
    single = supervisor.of_one_world()
    drawing = single.printer()
    if not (changes := print_redraws(single, drawing)):
        return
    supervisor.per_world["_redraw"] = drawing.method_lines(
        ['"""Draw the values that are due in one world."""']
    )
    periods = [due for due, _ in changes]
    due = periods[0] if len(periods) == 1 else f"minimum({', '.join(periods)})"
    condition = (
        f"{supervisor.tick} * {supervisor.scenario.world.timestep!r} >= {due}" if all(periods) else "True"
    )
    attributes = [attribute.removeprefix("self.") for change in changes for attribute in change if attribute]
    for name in attributes:
        supervisor.attribute(name)
    printer.line(f"self.redraw({', '.join([condition, 'self._redraw', *map(quoted, attributes)])})")


def _print_draws_of_message(
    supervisor: SupervisorPrinter, printer: Printer, channel: str, route: Route
) -> None:
    if printer.on_floats:
        print_draws_of_message(printer, channel, route)
        return
    drawing = supervisor.of_one_world().printer()
    print_draws_of_message(drawing, channel, route)
    for line in drawing.lines:
        name = f"_draw_{line.partition(' = ')[0].removeprefix('self.').replace('.', '_')}"
        supervisor.per_world[name] = ['"""Draw a value for the next message of a single world."""', line]
        printer.line(f"self.redraw(True, self.{name})")


# Messages


def _delivers_in_ticks(supervisor: SupervisorPrinter, robot: Robot) -> bool:
    """Return whether a message to this robot may arrive in another timestep than the one that follows its
    sending."""
    late = supervisor.scenario.timing == "delayed" and supervisor.repeats_actions
    return supervisor.scenario.format != "none" and (late or not robot.to_route.perfect)


def _print_delivering(supervisor: SupervisorPrinter, printer: Printer, robot: Robot) -> None:
    controller = f"self.{generated.robot(robot.name)}"
    channel = f"self.{generated.channel(robot.name, 'to_robot')}"
    if supervisor.scenario.is_direct(robot, "to_robot"):
        printer.line(f"{controller}.use_message_data({channel}.receive())")
    else:
        printer.line(f"for message in {channel}.receive():")
        printer.line(f"    {controller}.use_message_data(message)")


def _print_receiving(supervisor: SupervisorPrinter, printer: Printer, robot: Robot) -> None:
    """Print statements that put the message of one robot into local variables; the first of an episode
    arrives at once."""
    controller = f"self.{generated.robot(robot.name)}"
    channel = f"self.{generated.channel(robot.name, 'from_robot')}"
    targets = [supervisor.local(f"{robot.name}.{entry.name}") for entry in robot.emitted]
    drawing = supervisor.printer()
    _print_draws_of_message(supervisor, drawing, channel, robot.from_route)
    if drawing.lines and supervisor.scenario.format != "none":
        printer.lines += (
            [f"if {supervisor.tick}:", *indent(drawing.lines)] if printer.on_floats else drawing.lines
        )
    links = [link for link in supervisor.scenario.links if link.sender == robot.name]
    message = f"{controller}.create_message()"
    if links:
        local = supervisor.names.identifier(f"message of {robot.name}", robot.name, "message")
        printer.line(f"{local} = {message}")
        message = local
    printer.line(f"{channel}.send({message})")
    for link in links:
        _print_telling(supervisor, printer, link, message)
    receive = "receive" if supervisor.scenario.is_direct(robot, "from_robot") else "newest"
    printer.line(f"{targets_code(targets)} = {channel}.{receive}()" if targets else f"{channel}.{receive}()")


def _print_telling(supervisor: SupervisorPrinter, printer: Printer, link: Link, message: str) -> None:
    """Print the statements that send values of a message to another robot; the first of an episode arrives at
    once."""
    path = f"self.{generated.link(link.sender, link.receiver)}"
    drawing = supervisor.printer()
    _print_draws_of_message(supervisor, drawing, path, link.route)
    if drawing.lines:
        printer.lines += (
            [f"if {supervisor.tick}:", *indent(drawing.lines)] if printer.on_floats else drawing.lines
        )
    sender = next(robot for robot in supervisor.scenario.robots if robot.name == link.sender)
    names = [entry.name for entry in sender.emitted]
    printer.line(f"{path}.send({tuple_code([f'{message}[{names.index(name)}]' for name in link.sources])})")


def _print_tick(supervisor: SupervisorPrinter, printer: Printer) -> None:
    for robot in supervisor.scenario.robots:
        if _delivers_in_ticks(supervisor, robot):
            _print_delivering(supervisor, printer, robot)
    if supervisor.is_of_copy:
        printer.line("yield  # the timestep is simulated when every copy has acted")
    else:
        printer.line(f"self.physics({supervisor.scenario.world.substeps})")
    printer.lines += [
        f"self.{generated.robot(robot.name)}.observe()"
        for robot in supervisor.scenario.robots
        if observes_each_timestep(supervisor.scenario, robot)
    ]
    printer.line(
        f"self._observe({', '.join(supervisor.local(name) for name, _ in supervisor.action_names_read)})"
    )


def _start_memories_of_messages(supervisor: SupervisorPrinter) -> list[str]:
    """Start the memories of values that messages to robots contain; they start with an action of 0."""
    if not any(outer_states(value) for value in supervisor.sent):
        return []
    printer = supervisor.printer()
    used = {
        leaf.name for value in supervisor.sent for state in outer_states(value) for leaf in names_in(state)
    }
    printer.lines += [
        f"{supervisor.local(name)} = {zeros(components)}"
        for name, components in supervisor.variables
        if name in used
    ]
    printer.lines += [f"{local} = self.{generated.last(local)}" for local in supervisor.sent_names()]
    printer.insert_readers_here()
    sending = supervisor.printer()
    for robot in supervisor.scenario.robots:
        for entry in robot.received:
            sending.vector_or_number(entry.components, entry.scalars)
    printer.update_memories(supervisor.sent, sending)
    return printer.method_lines()


# Goal and noise


def _print_goal(supervisor: SupervisorPrinter, printer: Printer) -> None:
    """Set `achieved`, `desired` and `goal_reached`: both as the policy sees them, so that a reward can be
    recomputed."""
    goal = supervisor.agent.goal
    if goal is None:
        return
    achieved, desired = supervisor.local("achieved"), supervisor.local("desired")
    achieved_text = printer.vector(goal.achieved.scalars)
    if goal.achieved.noise is not None:
        printer.assign(achieved, achieved_text if goal.components else printer.value(goal.achieved.scalar))
        _print_noise(supervisor, printer, achieved, goal.components, "goal.achieved", goal.achieved.noise)
        achieved_text = achieved if goal.components else f"({achieved},)"
    targets = (achieved, desired) if goal.components else (f"({achieved},)", f"({desired},)")
    printer.line(
        f"{', '.join(targets)} = self.set_goal_observation({achieved_text}, {printer.vector(goal.targets)})"
    )
    printer.assign(supervisor.local("goal_reached"), printer.value(goal.reached))


def _print_noise(
    supervisor: SupervisorPrinter,
    printer: Printer,
    local: str,
    components: Sequence[str],
    stream: str,
    noise: Noise | None,
) -> None:
    """Add noise to the local variable of a value; nothing where the scenario gives it none."""
    if noise is None:
        return
    # one number or one per component: constants, or draws of the episode
    fixed = all(isinstance(value, Const) for value in noise.std.scalars)
    std = (
        printer.vector_or_number(noise.std.scalars[1:], noise.std.scalars)
        if fixed
        else std_attribute(supervisor, stream)
    )
    noise_name = printer.names.identifier(f"noise {stream}", "noise", local)
    count = max(1, len(components))
    normals = "self.streams.normals" if printer.on_floats else "self.normals"
    printer.line(f"{noise_name if components else f'({noise_name},)'} = {normals}({quoted(stream)}, {count})")
    if not components:
        added = f"{f'{std} * {local}' if noise.relative else std} * {noise_name}"
        printer.line(f"{local} += {added}" if printer.on_floats else f"{local} = {local} + {added}")
        return
    many = len(noise.std.scalars) > 1
    relative = " * a" if noise.relative else ""
    scale = f"c{relative}" if many else f"{std}{relative}"
    columns = ", ".join([local, noise_name, *([std] if many else [])])
    printer.line(f"{local} = [a + {scale} * b for a, b{', c' if many else ''} in zip({columns})]")


# Endings


def _print_endings(supervisor: SupervisorPrinter, printer: Printer) -> None:
    """Print the conditions in order of dependency; `ended_by` is the first in file order, failures before
    successes."""
    endings = supervisor.scenario.endings
    for ending in _after_what_they_use(endings):
        code = (
            printer.value(ending.scalar)
            if ending.foreign is None
            else f"{function_attribute(supervisor, 'ending', ending.name)}(self)"
        )
        printer.assign(supervisor.local(ending.name), code, ending.text)
    alone = {name for member in supervisor.scenario.members.values() for name in member.alone}
    endings = tuple(ending for ending in endings if ending.name not in alone)
    failures = [ending for ending in endings if ending.name in supervisor.scenario.failures]
    successes = supervisor.scenario.successes
    for agent in supervisor.agents_alone:
        _print_ending_alone(supervisor, printer, agent)
    word = "if"
    if endings:
        ending_line = f"self._terminate({_held(supervisor, printer, failures, successes)})"
        any_holds = " or ".join(supervisor.local(ending.name) for ending in endings)
        printer.lines += [f"if {any_holds}:", f"    {ending_line}"] if printer.on_floats else [ending_line]
        word = "elif"
    if supervisor.agents_alone and len(supervisor.agents_alone) == len(supervisor.scenario.members):
        ended = [Code(supervisor.ended_of(agent)) for agent in supervisor.agents_alone]
        all_ended = printer.operation("and", ended).text
        printer.lines += (
            [f"{word} {all_ended}:", "    self._end_with_agents()"]
            if printer.on_floats
            else [f"self._end_with_agents({all_ended})"]
        )
        word = "elif"
    limit = _tick_limit(supervisor)
    if limit is None:
        return
    reached = f"{supervisor.tick} >= {limit[0]}"
    name = quoted(limit[1])
    goal = supervisor.local("goal_reached") if supervisor.agent.goal is not None and not successes else ""
    goal = "True" if limit[1] in supervisor.agent.success else goal
    if printer.on_floats:
        printer.lines += [f"{word} {reached}:", f"    self._truncate({name})"]
        printer.lines += [f"    self.is_success = {goal}"] if goal else []
    else:
        printer.line(f"self._truncate({name}, {reached}{f', {goal}' if goal else ''})")


def _print_ending_alone(supervisor: SupervisorPrinter, printer: Printer, agent: str) -> None:
    """Print the end of the episode of one of several agents, while the others go on."""
    member = supervisor.scenario.members[agent]
    ended = supervisor.ended_of(agent)
    acts = supervisor.acts(agent)
    printer.line(f"{acts} = {printer.operation('not', [Code(ended)]).text}")
    # `alone` is a set of texts, whose order differs between processes.
    holds = printer.operation("or", [Code(supervisor.local(name)) for name in sorted(member.alone)])
    failures = [ending for ending in member.program.endings if ending.name in member.program.failures]
    endings_code = _held(supervisor, printer, failures, member.program.successes)
    if printer.on_floats:
        now = printer.operation("and", [Code(acts), holds]).text
        printer.lines += [f"if {now}:", f"    {ended} = self._end_agent({quoted(agent)}, {endings_code})"]
    else:
        printer.line(f"{ended} = self._end_agent({quoted(agent)}, {ended}, {holds.text}, {endings_code})")


def _held(
    supervisor: SupervisorPrinter,
    printer: Printer,
    failures: Sequence[Expression],
    successes: Sequence[Expression],
) -> str:
    """Return the code of which endings hold, and whether this is a success."""
    entries = ", ".join(
        f"{quoted(ending.name)}: {supervisor.local(ending.name)}" for ending in [*failures, *successes]
    )
    success = f", success={_success(supervisor, printer, failures, successes)}" if successes else ""
    return f"{{{entries}}}{success}"


def _success(
    supervisor: SupervisorPrinter,
    printer: Printer,
    failures: Sequence[Expression],
    successes: Sequence[Expression],
) -> str:
    """Return the code of whether a success holds, and no failure."""
    reached = printer.operation("or", [Code(supervisor.local(ending.name)) for ending in successes])
    refused = [printer.operation("not", [Code(supervisor.local(ending.name))]) for ending in failures]
    return printer.operation("and", [reached, *refused]).text


def _tick_limit(supervisor: SupervisorPrinter) -> tuple[int, str] | None:
    """Return the number of timesteps at which an episode is cut short, and the name of that limit; a step is
    cut short only by an ending."""
    scenario = supervisor.scenario
    ticks = scenario.truncation.timesteps(scenario.world.timestep, scenario.action_repeat)
    of_members = (member.program.agent.success for member in scenario.members.values())
    successes = {*scenario.agent.success}.union(*of_members)
    # Of equal limits, the name is that of a success, else `max_steps`.
    first = min(ticks, key=lambda name: (ticks[name], name not in successes), default=None)
    return None if first is None else (ticks[first], first)


def _after_what_they_use(endings: tuple[Expression, ...]) -> list[Expression]:
    """Return the endings in order of dependency: they may name each other, and the compiler has refused
    circles."""
    by_name = {ending.name: ending for ending in endings}
    order: dict[str, Expression] = {}

    def add(ending: Expression) -> None:
        for leaf in names_in(ending.scalar):
            if leaf.name in by_name and leaf.name not in order:
                add(by_name[leaf.name])
        order[ending.name] = ending

    for ending in endings:
        if ending.name not in order:
            add(ending)
    return list(order.values())


def bind_python_functions(supervisor: SupervisorPrinter) -> list[str]:
    """Return statements that import the functions of Python that the scenario names."""
    items = [("reward term", term.name, term.foreign, False) for term in supervisor.agent.reward]
    items += [("ending", ending.name, ending.foreign, True) for ending in supervisor.scenario.endings]
    lines = []
    for noun, name, function, truth in items:
        if function is not None:
            arguments = ", ".join(map(quoted, (noun, name, function.module, function.function)))
            attribute = function_attribute(supervisor, noun, name)
            lines.append(f"{attribute} = python_function({arguments}, {truth})")
    return lines


def function_attribute(supervisor: SupervisorPrinter, noun: str, name: str) -> str:
    """Return the attribute with the function of an ending or a reward term."""
    return f"self.{supervisor.names(f'function of {noun}', name)}"


# Rewards


def _print_rewards(supervisor: SupervisorPrinter, printer: Printer) -> None:
    """Print the terms and their sum, except right after a reset, where their memories begin."""
    terms = supervisor.agent.reward
    for flag in ("terminated", "truncated"):
        if supervisor.uses(flag):
            printer.line(f"{supervisor.local(flag)} = self.{flag}")
    if supervisor.uses("ended"):
        printer.line(
            f"{supervisor.local('ended')} ="
            f" {printer.operation('or', [Code('self.terminated'), Code('self.truncated')]).text}"
        )
    _print_ends_of_agents(supervisor, printer)
    for term in terms:
        printer.update_memories([term.scalar])
    names = [
        supervisor.names(f"{term.name} term")
        if supervisor.repeats_actions
        else f"self.{generated.term(term.name)}"
        for term in terms
    ]
    lines: list[str] = []
    acting = {
        term: supervisor.acts(agent)
        for agent in supervisor.agents_alone
        for term in supervisor.scenario.members[agent].terms.values()
    }
    for name, term in zip(names, terms, strict=True):
        if term.foreign is not None:
            code = Code(f"{function_attribute(supervisor, 'reward term', term.name)}(self)")
        elif term.name in acting:
            code = printer.code(term.scalar)
        else:
            code = Code(printer.value(term.scalar))
        if term.name in acting:
            code = printer.operation("where", [Code(acting[term.name]), code, Code("0.0")])
        lines += with_comment(f"{name} = {code.text}", term.text)
    lines += _sum_lines("reward", names, "" if supervisor.repeats_actions else "self.reward")
    summing = supervisor.printer()
    if supervisor.repeats_actions:
        for name, term in zip(names, terms, strict=True):
            summing.add_in_place(f"self.{generated.term(term.name)}", name)
        summing.add_in_place("self.reward", "reward")
    summing.lines += (
        ["if not -1e300 < reward < 1e300:", "    self._not_finite()"]
        if printer.on_floats
        else ["self.require_finite(reward)"]
    )
    if supervisor.uses("episode_return"):
        summing.add_in_place("self.episode_return", "reward")
    _print_rewards_of_agents(
        supervisor, summing, dict(zip([term.name for term in terms], names, strict=True))
    )
    lines += summing.lines
    printer.lines += (
        ["if self.step_count:  # there is no reward at the reset", *indent(lines)]
        if printer.on_floats
        else lines
    )


def _print_ends_of_agents(supervisor: SupervisorPrinter, printer: Printer) -> None:
    """Print `terminated` and `ended` of those agents whose episode may end while others go on."""
    flags = {TERMINATED: ["self.terminated"], ENDED: ["self.terminated", "self.truncated"]}
    for agent in supervisor.agents_alone:
        for word, of_all in flags.items():
            name = qualified_name(agent, word)
            if supervisor.uses(name):
                ends = [Code(flag) for flag in (*of_all, supervisor.ended_of(agent))]
                printer.line(f"{supervisor.local(name)} = {printer.operation('or', ends).text}")


def _sum_lines(local: str, names: Sequence[str], attribute: str = "") -> list[str]:
    """Return statements that assign a sum to a local, and at last to an attribute too."""
    # Python's compiler goes down one level per `+`, so a long sum is taken up in parts; the order is the
    # same.
    parts = [" + ".join(names[i : i + _SUMMANDS]) for i in range(0, len(names), _SUMMANDS)]
    lines = []
    for index, part in enumerate(parts):
        targets = [attribute, local] if attribute and index == len(parts) - 1 else [local]
        so_far = [local] if index else []
        lines.append(" = ".join([*targets, " + ".join([*so_far, part])]))
    return lines


def _print_rewards_of_agents(
    supervisor: SupervisorPrinter, printer: Printer, names: Mapping[str, str]
) -> None:
    """Print the rewards and the returns of those among several agents whose expressions read them. `names`
    has the code of each term."""
    returned = supervisor.agents_that_use(EPISODE_RETURN)
    for agent in supervisor.agents_that_use(PREVIOUS_REWARD, EPISODE_RETURN):
        term_codes = [names[term] for term in supervisor.scenario.members[agent].terms.values()]
        local = supervisor.names.identifier(f"new reward of {agent}", agent, "reward")
        reward = supervisor.reward_of(agent)
        printer.lines += _sum_lines(local, term_codes, "" if supervisor.repeats_actions else reward)
        if supervisor.repeats_actions:
            printer.add_in_place(reward, local)
        if agent in returned:
            printer.add_in_place(supervisor.return_of(agent), local)


# Observation


def _print_observation(supervisor: SupervisorPrinter, printer: Printer) -> None:
    numbers = []
    for entry in supervisor.agent.observation:
        if entry in supervisor.agent.images:
            continue
        numbers.append(_observed(supervisor, printer, entry))
    if numbers:
        printer.line(f"self.set_observation({', '.join(numbers)})")
    for pictured in supervisor.agent.images:
        printer.line(
            f"self.frame_stacks[{quoted(pictured.key)}].frames[self.newest] ="
            f" {printer.value(pictured.value.scalar)}"
        )


def _observed(supervisor: SupervisorPrinter, printer: Printer, entry: Observation) -> str:
    """Return the code of one or several numbers, as the policy sees them."""
    components = entry.value.components
    # the reward of this step is known here; everywhere else the name means that of the step before
    last_rewards = supervisor.last_rewards()
    name = next((value.name for value in entry.value.scalars if isinstance(value, Name)), "")
    is_reward = name in last_rewards and entry.value.scalars == (Name(name),)
    code = last_rewards[name] if is_reward else printer.vector_or_number(components, entry.value.scalars)
    star = "*" if components else ""
    if entry.numbers[0].is_truth:
        as_it_is = components or code.replace("_", "").isalnum() or not printer.on_floats
        return f"{star}{code}" if as_it_is else f"bool({code})"
    if entry.name == "previous_action" and entry.noise is None and {*entry.low, *entry.high} == {-1.0, 1.0}:
        return f"{star}{code}"  # within the range as it is
    if entry.noise is not None:
        local = printer.names.identifier(f"seen {entry.name}", "seen", entry.name)
        printer.assign(local, code)
        _print_noise(supervisor, printer, local, components, f"observation.{entry.name}", entry.noise)
        code = local
    if len({*entry.low}) == len({*entry.high}) == 1:
        function = "scale" if entry.clip else "scale_freely"
        ends = f"{number_code(entry.low[0]).text}, {number_code(entry.high[0]).text}"
        if not components:
            return f"{function}({code}, {ends})"
        return f"*scale_each({code}, {ends})" if entry.clip else f"*[scale_freely(a, {ends}) for a in {code}]"
    low, high = (printer.context.constants.vector(ends) for ends in (entry.low, entry.high))
    return (
        f"*[{'scale' if entry.clip else 'scale_freely'}(a, b, c) for a, b, c in zip({code}, {low}, {high})]"
    )


# Masks


def _print_masks(supervisor: SupervisorPrinter, printer: Printer) -> None:
    """Print the options that the agent may choose next; at least one option of each choice must be allowed. A
    batch checks this itself."""
    if not supervisor.forbids_options:
        return
    repeat = supervisor.scenario.action_repeat
    chooses = "not self.terminated and not self.truncated" + (
        f" and self.timestep_count % {repeat} == 0" if supervisor.repeats_actions else ""
    )
    for part in supervisor.choices:
        if any(option.forbidden is not None for option in part.options):
            allowed = f"self.{generated.allowed(part.name)}"
            ended = _ended_of_choice(supervisor, part.name)
            options = [_allowed(printer, option, ended) for option in part.options]
            if not printer.on_floats:
                printer.line(f"self.allow({', '.join([quoted(part.name), *options])})")
                continue
            printer.line(f"{allowed} = {tuple_code(options)}")
            if all(option.forbidden is not None for option in part.options):
                printer.line(f"if not any({allowed}) and {chooses}:")
                printer.line(f"    self._nothing_allowed({quoted(part.name)})")


def _ended_of_choice(supervisor: SupervisorPrinter, choice: str) -> str:
    """Return the attribute that is true if the episode of the agent of a choice has ended while others go on;
    empty without such an end."""
    for agent in supervisor.agents_alone:
        agent_choices = supervisor.choices[slice(*supervisor.scenario.members[agent].choices)]
        if any(part.name == choice for part in agent_choices):
            return supervisor.ended_of(agent)
    return ""


def _allowed(printer: Printer, option: Option, ended: str) -> str:
    if option.forbidden is None:
        return "True"
    allowed = printer.operation("not", [printer.code(option.forbidden.scalar)])
    return (printer.operation("or", [allowed, Code(ended)]) if ended else allowed).text
