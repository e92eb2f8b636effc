"""The sensors of a robot (their kinds, frames on links, rays, cameras and errors), and the section `ros`: the
topics of sensors, readings of the world and actuators, checked against the messages of ROS 2."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from itertools import pairwise, product
from typing import TYPE_CHECKING, Any

from deepbots_cli.compiler.namespace import Namespace, NamespaceReader
from deepbots_cli.compiler.robots import ResolvedRobot, joint_dimension, joint_interval
from deepbots_cli.document import Document
from deepbots_cli.document.nodes import NodePath, entries_at
from deepbots_cli.errors import MissingExtraError
from deepbots_cli.expressions.dimensions import LENGTH, NUMBER, TIME, Dimension
from deepbots_cli.expressions.intervals import EVERYTHING, Interval
from deepbots_cli.expressions.types import Components, Kind, Known, Symbol, ValueType
from deepbots_cli.program import Program
from deepbots_cli.program.resets import OfSensor
from deepbots_cli.program.robots import (
    MAX_SENSED_RAYS,
    MIN_RESOLUTION,
    CalibrationTable,
    CameraIntrinsics,
    NoiseModel,
    RayConfig,
    Sensor,
)
from deepbots_cli.program.task import MAX_OBSERVED_BYTES
from deepbots_cli.robots.model import Pose, Vector
from deepbots_cli.scenario.base import kind_parameters
from deepbots_cli.scenario.fields import choices_help
from deepbots_cli.scenario.sensors import (
    BASES,
    Camera,
    ContactSensor,
    GridScan,
    HeightScan,
    JointSensor,
    LinkSensor,
    RayScan,
    RaySensor,
    ReactionSensor,
    Touch,
)
from deepbots_cli.scenario.sensors import CalibrationTable as TableSpec
from deepbots_cli.scenario.sensors import Sensor as SensorSpec
from deepbots_cli.scenario.world import SensorFrame

if TYPE_CHECKING:
    from deepbots_robot.topics import Field, Topic


_LINKS = frozenset({Kind.LINK})
_CONTACT_KINDS = frozenset(
    {Kind.GROUND, Kind.ROBOT, Kind.OBJECT, Kind.OBJECTS, Kind.LINK, Kind.LINKS, Kind.WALL, Kind.WALLS}
)


class SensorsCompiler(NamespaceReader):
    """The sensors of one robot. Sensors with findings are missing, and their names have no type."""

    def __init__(self, robot: ResolvedRobot, namespace: Namespace) -> None:
        super().__init__(namespace)
        self._robot = robot
        self.symbols: dict[str, Symbol] = {}
        self._sensors: dict[str, Sensor] = {}
        for name, spec in robot.spec.sensors.items():
            self.symbols[name] = Symbol(name, None)
            self._add(name, spec)
        self._check_size()

    def compiled(self, timestep: float) -> tuple[Sensor, ...]:
        """Return the sensors in a world whose timestep is `timestep` s, which their periods are multiples
        of."""
        specs = self._robot.spec.sensors
        return tuple(
            replace(sensor, faults=_with_period(sensor.faults, self._namespace, specs[name], timestep))
            for name, sensor in self._sensors.items()
        )

    def _check_size(self) -> None:
        """Report DB005 for more than a robot can send in every timestep."""
        rays = sum(len(sensor.beams.rays) for sensor in self._sensors.values() if sensor.beams)
        values = sum(
            math.prod(symbol.type.picture)
            for symbol in self.symbols.values()
            if symbol.type and symbol.type.picture
        )
        for count, limit, noun in (
            (rays, MAX_SENSED_RAYS, "rays"),
            (values, MAX_OBSERVED_BYTES, "bytes of pictures"),
        ):
            if count > limit:
                self._values.add_at_key(
                    "DB005",
                    (*self._robot.spec.path, "sensors"),
                    f"the sensors of `{self._robot.name}` have {count:,} {noun}; the limit is {limit:,}",
                    "use fewer rays or smaller pictures: the robot reads all its sensors in every timestep",
                )

    def _add(self, name: str, spec: SensorSpec) -> None:
        reading = self._read(name, spec)
        if reading is None:
            return
        sensor, typed = reading
        slides = (
            isinstance(spec, JointSensor)
            and joint_dimension(self._robot.model.joint(sensor.subjects[0])) == LENGTH
        )
        parameters = self._fields.parameters(
            spec, kind_parameters(type(spec), *BASES), typed.dimension, slides=slides
        )
        if parameters is None:
            return
        faults, typed = _noise_model(self._namespace, spec, typed)
        if isinstance(spec, HeightScan) or (isinstance(spec, RaySensor) and spec.lookup is None):
            sensor = self._with_ray_reach(sensor, spec, faults)
        unit = "" if typed.boolean or typed.picture else str(typed.dimension)
        self._sensors[name] = replace(sensor, unit=unit, faults=faults, parameters=parameters)
        self.symbols[name] = Symbol(name, typed._replace(known=Known.STEP))

    def _read(self, name: str, spec: SensorSpec) -> tuple[Sensor, ValueType] | None:
        """Return a sensor without errors, and the type of its readings; None after a finding."""
        typed = ValueType(
            spec.dimension, spec.components or None, boolean=spec.boolean, interval=spec.interval
        )
        subjects: tuple[str, ...] = ()
        more: dict[str, Any] = {}
        match spec:
            case JointSensor():
                joints = self._robot.joints_of(spec, self._values)
                subjects = tuple(joint.name for joint in joints)
                if joints:
                    typed = typed._replace(
                        dimension=spec.dimension_of(joints[0]),
                        components=None if spec.joints is None else subjects,
                    ).with_intervals(spec.interval_of(joint_interval(joint)) for joint in joints)
            case ContactSensor():
                subjects = self._robot.links_of(spec, self._values)
                typed = typed._replace(components=None if spec.links is None else subjects)
                if isinstance(spec, Touch) and spec.against is not None:
                    more["against"] = self._against(spec)
            case LinkSensor():
                subjects = self._carrier_of(spec)
                measured = self._measured(spec, typed)
                if measured is None:
                    return None
                more, typed = measured
        if not subjects:
            return None
        sensor = Sensor(
            name,
            spec.type,
            subjects,
            typed.components or (),
            "",
            reader=spec.reader,
            world_function=spec.world_function,
            **more,
        )
        return sensor, typed._replace(known=Known.STEP)

    def _measured(self, spec: LinkSensor, typed: ValueType) -> tuple[dict[str, Any], ValueType] | None:
        """Return the fields that only a sensor on a link has, and the type of its readings; None after a
        finding."""
        namespace = self._namespace
        more: dict[str, Any] = {"mount": _frame(namespace, spec.pose)}
        match spec:
            case RayScan():
                scan = _scan(namespace, spec)
                if scan is None:
                    return None
                more["beams"], components, dimension, interval = scan
                typed = typed._replace(dimension=dimension, components=components or None, interval=interval)
            case Camera():
                optics = _intrinsics(namespace, spec)
                if optics is None:
                    return None
                more["optics"] = optics
                typed = ValueType(picture=optics.shape)
        return more, typed

    def _carrier_of(self, spec: LinkSensor) -> tuple[str, ...]:
        """Return the link on which a sensor is mounted; none after a finding."""
        links = self._robot.links_of(spec, self._values)
        if isinstance(spec, ReactionSensor) and self._robot.model.root in links:
            self._values.add(
                "DB105",
                (*spec.path, "link"),
                f"no joint carries `{spec.link}`, the root link of `{self._robot.name}`",
                "name a link that a joint carries",
            )
            return ()
        return links

    def _with_ray_reach(self, sensor: Sensor, spec: RayScan, faults: NoiseModel | None) -> Sensor:
        """Return the sensor with rays to the end of its range; the rays of a height scan begin at the
        beginning of the range."""
        if "range" not in spec.model_fields_set and not self._values.is_invalid("range"):
            headline = f"the range of `{sensor.name}` is missing"
            self._values.add_at_key(
                "DB102", spec.path, headline, "add a range, as in `range: 0 .. 1 m`, or a `lookup`"
            )
        reach = max(faults.high) if faults and faults.high else 0.0
        if faults and faults.high and reach <= 0.0:
            span = self._values.span((*spec.path, "range"))
            headline = f"a range that ends at {reach:g} m"
            self._values.add("DB105", span, headline, "end the range above 0 m: distances are positive")
        behind = 0.0
        if isinstance(spec, HeightScan) and faults and faults.low:
            behind = max(0.0, -min(faults.low))
        beams = replace(sensor.beams, reach=reach + behind, behind=behind) if sensor.beams else None
        return replace(sensor, beams=beams)

    def _against(self, spec: Touch) -> tuple[str, ...]:
        """Return the full names of the parts that a touch sensor feels."""
        names = spec.against or ()
        links: list[str] = []
        for index, name in enumerate([names] if isinstance(names, str) else names):
            subject = self._namespace.subject(name, _LINKS)
            if subject is not None and subject.kind in _CONTACT_KINDS:
                links += subject.members or subject.pieces or (subject.name,)
            elif subject is None or subject.kind is not Kind.BROKEN:
                steps = ("against",) if isinstance(names, str) else ("against", index)
                self._values.report_unknown(
                    self._values.span((*spec.path, *steps)), "body or link", name, [*self._felt(), "ground"]
                )
        return tuple(dict.fromkeys(links))

    def _felt(self) -> list[str]:
        """Return every body and link that a touch sensor may feel."""
        subjects = {name: self._namespace.subject(name, _LINKS) for name in self._namespace.subjects()}
        return [
            name
            for name, subject in subjects.items()
            if subject is not None and subject.kind in _CONTACT_KINDS
        ]


# Frames, cameras and rays


def _frame(namespace: Namespace, spec: SensorFrame) -> Pose:
    """Return a frame on a link; values with findings are 0."""

    def triple(vector_key: str, parts: Components) -> Vector:
        if getattr(spec, vector_key) is not None:
            return namespace.fields.triple(spec, vector_key) or (0.0, 0.0, 0.0)
        x, y, z = (
            namespace.fields.fixed(spec, part) or 0.0 if part in spec.model_fields_set else 0.0
            for part in parts
        )
        return (x, y, z)

    return Pose(triple("xyz", ("x", "y", "z")), triple("rpy", ("roll", "pitch", "yaw")))


def _intrinsics(namespace: Namespace, spec: Camera) -> CameraIntrinsics | None:
    """Return the intrinsics of a camera; None after a finding."""
    values = namespace.values
    size = namespace.fields.pair(spec, "resolution")
    fov = namespace.fields.fixed(spec, "fov")
    near, far = 0.0, 10.0
    if spec.range is not None:
        if spec.channels != "depth":
            values.add_at_key(
                "DB203",
                (*spec.path, "range"),
                "`range` applies to depth cameras only",
                "write `channels: depth`, or remove `range`",
            )
        ends = namespace.fields.ends(spec, "range", description="the range of a camera", dimension=LENGTH)
        if ends is None:
            return None
        (near,), (far,) = ends.low, ends.high
    if fov is not None and fov >= math.pi:
        _report_angle_of_view(namespace, spec, "fov", fov, "write less than 180 deg")
        return None
    return (
        CameraIntrinsics(int(size[0]), int(size[1]), fov, spec.channels, near, far) if size and fov else None
    )


def _report_angle_of_view(namespace: Namespace, spec: LinkSensor, key: str, angle: float, help: str) -> None:
    namespace.values.add(
        "DB105",
        namespace.values.span((*spec.path, key)),
        f"the angle of view is {math.degrees(angle):g} deg",
        help,
    )


def _scan(namespace: Namespace, spec: RayScan) -> tuple[RayConfig, Components, Dimension, Interval] | None:
    """Return the rays, with components, dimension and interval of their readings; None after a finding.
    Without a lookup, their reach is 0."""
    rays = _rays(namespace, spec)
    align = spec.align if isinstance(spec, GridScan) else "link"
    align = align or ("yaw" if isinstance(spec, HeightScan) else "link")
    if not isinstance(spec, RaySensor):
        if rays is None:
            return None
        beams = RayConfig(tuple(rays.values()), 0.0, upright=align == "yaw")
        return beams, _components(rays), spec.dimension, spec.interval
    table = _lookup(namespace, spec.lookup) if spec.lookup is not None else None
    if rays is None or (spec.lookup is not None and table is None):
        return None
    beams = RayConfig(tuple(rays.values()), 0.0, spec.measure, upright=align == "yaw")
    components = _components(rays) if spec.measure == "each" else ()
    if table is None:
        return beams, components, spec.dimension, spec.interval
    lookup, dimension = table
    interval = Interval(min(lookup.value), max(lookup.value))
    return replace(beams, reach=lookup.distance[-1], lookup=lookup), components, dimension, interval


def _components(rays: dict[str, Pose]) -> Components:
    """Return the names of the rays; none for a single one without a name."""
    return () if "" in rays else tuple(rays)


def _rays(namespace: Namespace, spec: RayScan) -> dict[str, Pose] | None:
    """Return the frames of rays by their names, "" for a single ray without a name; None after a finding."""
    values = namespace.values
    if isinstance(spec, GridScan) and spec.grid is not None:
        return _grid(namespace, spec)
    if isinstance(spec.rays, dict):
        if spec.angle_range is not None:
            help = "remove it, or write a number of rays, as in `rays: 5`, to spread them over the range"
            values.add_at_key(
                "DB101",
                (*spec.path, "angle_range"),
                "`angle_range` does not apply to rays with names",
                help,
            )
        return {name: _turned_down(_frame(namespace, ray), spec) for name, ray in spec.rays.items()}
    count = spec.rays or 1
    if spec.angle_range is None:
        if count > 1 and not values.is_invalid("angle_range"):
            help = (
                "add `angle_range: 90 .. -90 deg`, or give each ray by name, as in `rays:"
                " {left: {yaw: 30 deg}}`"
            )
            values.add("DB102", (*spec.path, "rays"), f"the directions of the {count} rays are missing", help)
        if count > 1:
            return None
        return {"" if spec.rays is None else "r0": _turned_down(Pose(), spec)}
    ends = namespace.fields.ends(spec, "angle_range", description="`angle_range`", falling=True)
    if ends is None:
        return None
    (first,), (last,) = ends.low, ends.high
    turns = [first + (last - first) * (index / (count - 1) if count > 1 else 0.5) for index in range(count)]
    return {f"r{index}": Pose(rpy=(0.0, 0.0, turn)) for index, turn in enumerate(turns)}


def _grid(namespace: Namespace, spec: GridScan) -> dict[str, Pose] | None:
    """Return the frames of parallel rays by their names; None after a finding."""
    values = namespace.values
    for key in ("rays", "angle_range"):
        if key in spec.model_fields_set:
            values.add_at_key(
                "DB101",
                (*spec.path, key),
                f"`{key}` does not apply to a grid of rays",
                "remove it, or the `grid`: a sensor has rays by name, a fan of rays, or a grid",
            )
            return None
    size = namespace.fields.pair(spec, "grid")
    spacing = namespace.fields.fixed(spec, "spacing")
    if size is None or spacing is None:
        return None
    columns, rows = (int(number) for number in size)
    poses: dict[str, Pose] = {}
    for column, row in product(range(columns), range(rows)):
        first, second = spacing * (column - (columns - 1) / 2), spacing * (row - (rows - 1) / 2)
        xyz = (first, second, 0.0) if isinstance(spec, HeightScan) else (0.0, first, second)
        poses[f"r{column}_{row}"] = _turned_down(Pose(xyz), spec)
    return poses


def _turned_down(pose: Pose, spec: RayScan) -> Pose:
    """Return the frame of a ray, whose x axis points down where the sensor is a height scan."""
    return replace(pose, rpy=(0.0, math.pi / 2, 0.0)) if isinstance(spec, HeightScan) else pose


def _lookup(namespace: Namespace, spec: TableSpec) -> tuple[CalibrationTable, Dimension] | None:
    """Return a lookup table, and the dimension of its readings; None after a finding."""
    values = namespace.values
    columns: dict[str, tuple[float, ...]] = {}
    dimension = NUMBER
    for key in ("distance", "value", *(["noise"] if spec.noise is not None else [])):
        text = values.field(spec, key)
        typed = (
            namespace.fields.typed(text, dimension=NUMBER) if key == "noise" else namespace.fields.typed(text)
        )
        numbers = values.fixed(typed, text, f"`{key}`") if typed else None
        if typed and numbers:
            columns[key] = tuple(map(float, numbers))
            dimension = typed.type.dimension if key == "value" else dimension
    if len(columns) < (2 if spec.noise is None else 3):
        return None
    findings_before = len(values.findings)
    distance = columns["distance"]
    for key, column in columns.items():
        if len(column) != len(distance):
            headline = f"`{key}` has {len(column)} numbers, but `distance` has {len(distance)}"
            values.add("DB106", (*spec.path, key), headline, "write one number for each distance")
    falling = [(a, b) for a, b in pairwise(distance) if b <= a]
    distances = values.span((*spec.path, "distance"))
    noises = columns.get("noise", ())
    if falling:
        before, after = falling[0]
        headline = f"the distances must increase: {after:g} m follows {before:g} m"
        values.add("DB105", distances, headline, "sort the distances, and their values with them")
    elif distance[0] < 0.0 or distance[-1] <= 0.0:
        headline = f"the distance {min(distance[0], distance[-1]):g} m is not allowed"
        values.add(
            "DB105", distances, headline, "write distances of at least 0; the last one must be greater than 0"
        )
    elif noises and min(noises) < 0.0:
        values.add("DB105", (*spec.path, "noise"), f"the noise is {min(noises):g}", "write 0 or more")
    return (
        (CalibrationTable(distance, columns["value"], noises), dimension)
        if len(values.findings) == findings_before
        else None
    )


# Errors

MAX_TICKS = 100_000
"""The longest period and latency in timesteps. Older readings are useless to a policy, and every reading of
this time is kept in memory."""


def _noise_model(
    namespace: Namespace, spec: SensorSpec, typed: ValueType
) -> tuple[NoiseModel | None, ValueType]:
    """Return the errors of a sensor, period apart, and the type of its readings with them; None for a perfect
    sensor."""
    variations_before = len(namespace.fields.variations)
    latency = _latency(namespace, spec)
    if typed.boolean or typed.picture:
        readings = "takes pictures" if typed.picture else "reads true or false"
        keys = ["noise", "bias", "drift", "resolution", "range"]
        if typed.picture:  # has a range of distances, and a resolution
            keys = [key for key in keys if key not in ("range", "resolution")]
        for key in keys:
            if key in spec.model_fields_set:
                namespace.values.add_at_key(
                    "DB403", (*spec.path, key), f"a sensor that {readings} has no `{key}`", "remove it"
                )
        model = NoiseModel(latency=latency)
    else:
        noise, relative_noise = _error(namespace, spec, "noise", typed)
        bias, relative_bias = _error(namespace, spec, "bias", typed)
        drift, _ = _error(namespace, spec, "drift", typed)
        resolution = _resolution(namespace, spec, typed)
        low, high = _range(namespace, spec, typed)
        model = NoiseModel(
            1, latency, noise, relative_noise, bias, relative_bias, drift, low, high, resolution
        )
        wanders = noise or relative_noise or bias or relative_bias or drift
        reach = list(map(Interval, low, high)) or (
            [EVERYTHING] if wanders else list(typed.intervals) or [typed.interval]
        )
        if resolution:
            half = max(resolution) / 2
            reach = [
                Interval(interval.low - half, interval.high + half) if interval.is_finite else interval
                for interval in reach
            ]
        typed = typed.with_intervals(reach)
    return None if model == NoiseModel() and len(
        namespace.fields.variations
    ) == variations_before else model, typed


def _latency(namespace: Namespace, spec: SensorSpec) -> float:
    if "latency" not in spec.model_fields_set:
        return 0.0
    return namespace.fields.scalar_or_randomized(spec, "latency", "sensor", _owner(spec.path, "latency"), 0.0)


def _error(
    namespace: Namespace, spec: SensorSpec, key: str, typed: ValueType
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return a value per component, absolute or relative: one written with `%` is relative to the reading."""
    if key not in spec.model_fields_set:
        return (), ()
    relative = key != "drift" and "%" in namespace.values.field(spec, key).text
    if relative:
        dimension = NUMBER
    elif key == "drift":
        dimension = typed.dimension / TIME
    else:
        dimension = typed.dimension
    owner = _owner(spec.path, f"relative_{key}" if relative else key)
    variations_before = len(namespace.fields.variations)
    error = (
        namespace.fields.vector_or_randomized(
            spec, key, "sensor", owner, dimension=dimension, per_component=typed.components or ("",)
        )
        or ()
    )
    if not any(error) and variations_before == len(namespace.fields.variations):
        error = ()
    return ((), error) if relative else (error, ())


def _resolution(namespace: Namespace, spec: SensorSpec, typed: ValueType) -> tuple[float, ...]:
    if "resolution" not in spec.model_fields_set:
        return ()
    steps = namespace.fields.numbers(
        spec, "resolution", dimension=typed.dimension, components=typed.components
    )
    if steps and any(0.0 < step < MIN_RESOLUTION for step in steps):
        values = namespace.values
        unit = "" if typed.dimension == NUMBER else f" {typed.dimension}"
        headline = f"`resolution` is {min(step for step in steps if step > 0.0):g}{unit}"
        values.add(
            "DB105",
            (*spec.path, "resolution"),
            headline,
            f"write at least `{MIN_RESOLUTION:g}{unit}`, or remove it",
        )
    return steps if steps and all(steps) else ()


def _range(
    namespace: Namespace, spec: SensorSpec, typed: ValueType
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    if spec.range is None:
        return (), ()
    ends = namespace.fields.ends(
        spec,
        "range",
        description="the range of a sensor",
        dimension=typed.dimension,
        components=typed.components,
    )
    return (ends.low, ends.high) if ends else ((), ())


def _owner(path: NodePath, field: str) -> OfSensor:
    return OfSensor(str(path[1]), str(path[3]), field)


def _with_period(
    faults: NoiseModel | None, namespace: Namespace, spec: SensorSpec, timestep: float
) -> NoiseModel | None:
    """Return the errors with the period of the sensor, in timesteps; DB308 for a period that is not a whole
    number of them."""
    seconds = namespace.fields.fixed(spec, "period")
    values = namespace.values
    if seconds is None or values.is_invalid("world.timestep"):
        return faults
    ticks = round(seconds / timestep)
    span = values.span((*spec.path, "period"))
    if values.check_whole_timesteps(seconds, timestep, span, "the period") and ticks > MAX_TICKS:
        values.add(
            "DB105", span, f"the period is {ticks:,} timesteps", f"write at most {MAX_TICKS:,} timesteps"
        )
    return replace(faults or NoiseModel(), period=ticks) if ticks > 1 else faults


# The section `ros`


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
            values.add(
                "DB321",
                ("ros", name, "type" if topic_spec.part is None else "part"),
                str(error),
                "choose another type, or another `part`; `deepbots inspect SCENARIO --ros` prints types"
                " that fit",
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
            values.add_at_key(
                "DB321",
                ("ros", name),
                f"the topic {given_topic.name} carries sensors and commands",
                "use topics of their own for commands",
            )
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
        document.findings.add(
            "DB201",
            entries[name].key.span,
            f"there is no sensor, reading or actuator `{name}`",
            choices_help(name, names),
        )
