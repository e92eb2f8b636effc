"""The section `ros`: the topics of sensors, readings of the world and actuators, checked against the messages
of ROS 2."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING

from deepbots_cli.compiler.namespace import Namespace
from deepbots_cli.document import Document
from deepbots_cli.document.nodes import entries_at
from deepbots_cli.errors import MissingExtraError
from deepbots_cli.program import Program
from deepbots_cli.scenario.fields import choices_help

if TYPE_CHECKING:
    from deepbots_robot.topics import Field, Topic


def topics(namespace: Namespace, program: Program) -> dict[str, Topic]:
    """Return the topics that the scenario gives, by sensor, reading and actuator; topics that do not fit have
    findings. Those of one agent among several leave out the names that belong to others.

    Raises:
        MissingExtraError: The scenario has a section `ros`, and deepbots-robot, which has the messages, is
            not installed.
    """
    values, spec = namespace.values, namespace.scenario
    if not spec.ros:
        return {}
    try:
        from deepbots_cli.program.topics import command_fields, mapping, reading_fields, sensor_fields
        from deepbots_robot.topics import Topic, conflicts, part_of
    except ModuleNotFoundError as error:
        raise MissingExtraError("robot", "the section `ros`") from error
    sensors = {field.name: field for field in (*reading_fields(program), *sensor_fields(program))}
    fields = {**{field.name: field for field in command_fields(program)}, **sensors}
    topics_by_field: dict[str, tuple[Field, Topic]] = {}
    for name, topic_spec in spec.ros.items():
        field = fields.get(name)
        if field is None and namespace.document.agent is not None:
            continue  # `report_topics_of_no_agent` knows the names of all agents
        if field is None:
            values.report_unknown(
                values.key_span(("ros", name)), "sensor, reading or actuator", name, list(fields)
            )
            continue
        topic = Topic(topic_spec.topic, topic_spec.type, topic_spec.part)
        try:
            part_of(field, topic)
        except ValueError as error:
            help = (
                "choose another type, or another `part`; `deepbots inspect SCENARIO --ros` prints types"
                " that fit"
            )
            values.add(
                "DB321", ("ros", name, "type" if topic_spec.part is None else "part"), str(error), help
            )
        else:
            topics_by_field[name] = (field, topic)
    first = mapping(replace(program, ros={}))
    all_topics = {
        name: (field, first[name]) for name, field in fields.items() if name in first and name not in spec.ros
    } | topics_by_field
    problems = conflicts(all_topics)
    measured = {topic.name for name, (_, topic) in all_topics.items() if name in sensors}
    commanded = {topic.name for name, (_, topic) in all_topics.items() if name not in sensors}
    for name, (_, given_topic) in topics_by_field.items():
        if given_topic.name in measured & commanded:
            headline = f"the topic {given_topic.name} carries sensors and commands"
            values.add_at_key("DB321", ("ros", name), headline, "use topics of their own for commands")
        elif name in problems:
            values.add_at_key("DB321", ("ros", name), problems[name], "use another topic")
    return {name: topic for name, (_, topic) in topics_by_field.items()}


def report_topics_of_no_agent(document: Document, programs: Iterable[Program]) -> None:
    """Report topics of sensors, readings and actuators that none of several agents has."""
    entries = entries_at(document.root, "ros")
    if not entries:
        return
    from deepbots_cli.program.topics import command_fields, reading_fields, sensor_fields

    names = list(
        dict.fromkeys(
            field.name
            for program in programs
            for field in (*command_fields(program), *reading_fields(program), *sensor_fields(program))
        )
    )
    for name in entries.keys() - set(names):
        headline = f"there is no sensor, reading or actuator `{name}`"
        document.findings.add("DB201", entries[name].key.span, headline, choices_help(name, names))
