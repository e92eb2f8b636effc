"""The sensors of a robot: their kinds, frames on links, rays, cameras and errors."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

from deepbots_cli.compiler.namespace import Namespace, ParameterScope
from deepbots_cli.compiler.robots import RobotScene, hull, joint_dimension, joints_of, links_of
from deepbots_cli.compiler.values import Values, figure, figures, read_parameters
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.dimensions import ANGLE, LENGTH, NUMBER, TIME, Dimension
from deepbots_cli.expressions.intervals import EVERYTHING, Interval
from deepbots_cli.expressions.types import PLANE, SPACE, Components, Context, Kind, NoNames, Stage, Symbol, Type
from deepbots_cli.expressions.unification import ANY_SHAPE
from deepbots_cli.program.robots import MAX_SENSED_RAYS, MIN_RESOLUTION, CalibrationTable, CameraIntrinsics, NoiseModel, RayConfig, Sensor
from deepbots_cli.program.task import MAX_OBSERVED_BYTES
from deepbots_cli.robots.model import Pose, Vector
from deepbots_cli.scenario.sensors import Camera, ContactSensor, JointSensor, LinkSensor, RayScan, RaySensor, Touch, parameters
from deepbots_cli.scenario.sensors import Sensor as SensorSpec
from deepbots_cli.scenario.world import SensorFrame

_TURNS: Components = ("roll", "pitch", "yaw")


def mount(values: Values, path: Path, spec: SensorFrame) -> Pose:
    """The frame that stands at `path`; what has a finding is 0."""
    return Pose(_triple(values, path, spec, "xyz", SPACE), _triple(values, path, spec, "rpy", _TURNS))


def _triple(values: Values, path: Path, spec: SensorFrame, whole: str, parts: Components) -> Vector:
    """Three figures, given at once or by their names."""
    dimension = LENGTH if whole == "xyz" else ANGLE
    if getattr(spec, whole) is not None:
        found = values.numbers((*path, whole), getattr(spec, whole), dimension, SPACE) or (0.0, 0.0, 0.0)
    else:
        found = tuple(_one(values, path, spec, part, whole == "xyz") for part in parts)
    x, y, z = found
    return (x, y, z)


def _one(values: Values, path: Path, spec: SensorFrame, part: str, length: bool) -> float:
    if part not in spec.model_fields_set:
        return 0.0
    return values.number((*path, part), getattr(spec, part), LENGTH if length else ANGLE) or 0.0


def optics(values: Values, path: Path, spec: Camera) -> CameraIntrinsics | None:
    """The optics of the camera that stands at `path`; None after a finding."""
    size = values.numbers((*path, "resolution"), spec.resolution, NUMBER, PLANE)
    fov = values.number((*path, "fov"), spec.fov, ANGLE)
    near, far = 0.0, 10.0
    if spec.range is not None:
        if spec.channels != "depth":
            help = "only pictures of depths have one: `channels: depth`"
            values.findings.add("DB203", values.key_span((*path, "range")), "the range of a camera that measures no distances", help=help)
        ends = values.ends(values.text((*path, "range"), spec.range), "the range of a camera", NoNames(), dimension=LENGTH)
        if ends is None:
            return None
        (near,), (far,) = ends.low, ends.high
    if fov is not None and fov >= math.pi:
        values.findings.add(
            "DB105", values.span((*path, "fov")), f"an angle of view of {math.degrees(fov):g} deg", help="give less than 180 deg"
        )
        return None
    return CameraIntrinsics(int(size[0]), int(size[1]), fov, spec.channels, near, far) if size and fov else None


MAX_TICKS = 100_000
"""The longest period and latency; a reading that old tells nothing, and each is kept."""
_OF_NUMBERS = ("noise", "bias", "drift", "quantise", "range")


@dataclass(frozen=True)
class FaultReader:
    """Reads the faults of one sensor, which stands at `path`."""

    namespace: Namespace
    robot: str
    sensor: str
    path: Path

    def read(self, spec: SensorSpec, known: Type) -> tuple[NoiseModel | None, Interval]:
        """Its faults, period apart, and the interval of its readings; None where there are none."""
        drawn = len(self.namespace.variations)
        if known.boolean or known.picture:
            faults = self._of_no_numbers(spec, known)
            return self._unless_none(faults, drawn), known.interval
        noise, relative_noise = self._figures(spec, "noise", known)
        bias, relative_bias = self._figures(spec, "bias", known)
        drift, _ = self._figures(spec, "drift", known, known.dimension / TIME)
        quantise = self._steps(spec, known)
        low, high = self._range(spec, known)
        faults = NoiseModel(1, self._latency(spec), noise, relative_noise, bias, relative_bias, drift, low, high, quantise)
        wanders = noise or relative_noise or bias or relative_bias or drift
        reach = EVERYTHING if wanders else known.interval
        if low:
            reach = Interval(min(low), max(high))
        if quantise and math.isfinite(reach.low) and math.isfinite(reach.high):
            half = max(quantise) / 2
            reach = Interval(reach.low - half, reach.high + half)
        return self._unless_none(faults, drawn), reach

    def _unless_none(self, faults: NoiseModel, drawn: int) -> NoiseModel | None:
        """None for a perfect sensor, of which no figure has been drawn since there were `drawn` of them."""
        return None if faults == NoiseModel() and len(self.namespace.variations) == drawn else faults

    def _of_no_numbers(self, spec: SensorSpec, known: Type) -> NoiseModel:
        tells, keys = ("takes pictures", _OF_NUMBERS[:-1]) if known.picture else ("tells true or false", _OF_NUMBERS)
        for key in keys:
            if key in spec.model_fields_set:
                headline = f"`{key}` of a sensor that {tells}"
                self.namespace.values.findings.add("DB403", self.namespace.values.key_span((*self.path, key)), headline, help="take it out")
        return NoiseModel(latency=self._latency(spec))

    def _latency(self, spec: SensorSpec) -> float:
        if "latency" not in spec.model_fields_set:
            return 0.0
        return figure(self.namespace, (*self.path, "latency"), spec.latency, TIME, self._scope, "sensor", self._of("latency")) or 0.0

    def _figures(
        self, spec: SensorSpec, key: str, known: Type, dimension: Dimension | None = None
    ) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """A figure for each component, absolute or relative: written with `%` it is a share of the value."""
        if key not in spec.model_fields_set:
            return (), ()
        place, given = (*self.path, key), getattr(spec, key)
        relative = dimension is None and "%" in self.namespace.values.text(place, given).text
        wanted = NUMBER if relative else dimension or known.dimension
        what = self._of(f"relative_{key}" if relative else key)
        drawn = len(self.namespace.variations)
        found = figures(self.namespace, place, given, wanted, self._scope, "sensor", what, spread=known.components or ("",)) or ()
        if not any(found) and drawn == len(self.namespace.variations):
            found = ()
        return ((), found) if relative else (found, ())

    def _steps(self, spec: SensorSpec, known: Type) -> tuple[float, ...]:
        if "quantise" not in spec.model_fields_set:
            return ()
        given = self.namespace.values.numbers((*self.path, "quantise"), spec.quantise, known.dimension, known.components, self._fixed)
        if given and any(0.0 < step < MIN_RESOLUTION for step in given):
            values, headline = self.namespace.values, f"a step of {min(given):g} between two readings"
            values.findings.add(
                "DB105", values.span((*self.path, "quantise")), headline, help=f"give at least {MIN_RESOLUTION:g}, or take it out"
            )
        return given if given and all(given) else ()

    def _range(self, spec: SensorSpec, known: Type) -> tuple[tuple[float, ...], tuple[float, ...]]:
        if spec.range is None:
            return (), ()
        values = self.namespace.values
        text = values.text((*self.path, "range"), spec.range)
        ends = values.ends(text, "the range of a sensor", self._fixed, dimension=known.dimension, components=known.components)
        return (ends.low, ends.high) if ends else ((), ())

    def _of(self, figure: str) -> tuple[str, str, str]:
        return self.robot, self.sensor, figure

    @property
    def _scope(self) -> ParameterScope:
        return ParameterScope(self.namespace, Context.FIELD)

    @property
    def _fixed(self) -> ParameterScope:
        return ParameterScope(self.namespace, Context.FIXED)


def period(faults: NoiseModel | None, values: Values, path: Path, given: object, tick: float) -> NoiseModel | None:
    """The faults with the period that stands at `path`, in ticks; DB308 for one that is no whole number of them."""
    seconds = None if given is None else values.number((*path, "period"), given, TIME)
    if seconds is None or values.is_lost("world.timestep"):
        return faults
    ticks = round(seconds / tick)
    if ticks < 1 or abs(seconds - ticks * tick) > 1e-9 * seconds:
        headline = f"a period of {seconds:g} s, which is no multiple of the timestep of {tick:g} s"
        values.findings.add("DB308", values.span((*path, "period")), headline, help="a sensor is read in whole timesteps")
    elif ticks > MAX_TICKS:
        values.findings.add("DB105", values.span((*path, "period")), f"a period of {ticks:_} timesteps", help="give a shorter one")
    return replace(faults or NoiseModel(), period=ticks) if ticks > 1 else faults


@dataclass(frozen=True)
class ReadBeams:
    """What was read: the rays, their names (none for a single figure), and the readings that they give."""

    beams: RayConfig
    components: Components
    dimension: Dimension
    interval: Interval


@dataclass(frozen=True)
class BeamReader:
    """Reads what is about rays in the sensor that stands at `path`; without a lookup, its range says how far they reach."""

    values: Values
    path: Path

    def read(self, spec: RayScan) -> ReadBeams | None:
        """None after a finding."""
        rays = self._rays(spec)
        if not isinstance(spec, RaySensor):
            return None if rays is None else ReadBeams(RayConfig(tuple(rays.values()), 0.0), _named(rays), spec.dimension, spec.interval)
        table = self._lookup(spec) if spec.lookup is not None else None
        if rays is None or (spec.lookup is not None and table is None):
            return None
        components = _named(rays) if spec.measure == "each" else ()
        beams = RayConfig(tuple(rays.values()), 0.0, spec.measure)
        if table is not None:
            lookup, dimension = table
            reach = Interval(min(lookup.value), max(lookup.value))
            return ReadBeams(replace(beams, reach=lookup.distance[-1], lookup=lookup), components, dimension, reach)
        return ReadBeams(beams, components, spec.dimension, spec.interval)

    # Rays

    def _rays(self, spec: RayScan) -> dict[str, Pose] | None:
        place = (*self.path, "rays")
        if isinstance(spec.rays, dict):
            if spec.fan is not None:
                headline = "a fan, where the rays are given by name"
                self.values.findings.add(
                    "DB101", self.values.key_span((*self.path, "fan")), headline, help="give their number under `rays`"
                )
            return {name: mount(self.values, (*place, name), ray) for name, ray in spec.rays.items()}
        count = spec.rays or 1
        if spec.fan is None:
            if count > 1:
                headline = f"{count} rays without their directions"
                self.values.findings.add("DB102", self.values.span(place), headline, help="add `fan: 90 .. -90 deg`, or give them by name")
                return None
            return {"": Pose()} if spec.rays is None else {"r0": Pose()}
        return self._fan(spec.fan, count)

    def _fan(self, given: str, count: int) -> dict[str, Pose] | None:
        """Rays at equal angles from the first to the last; a single one looks along the middle."""
        text = self.values.text((*self.path, "fan"), given)
        ends = self.values.ends(text, "the fan", NoNames(), dimension=ANGLE, falling=True)
        if ends is None:
            return None
        (first,), (last,) = ends.low, ends.high
        turns = [first + (last - first) * (index / (count - 1) if count > 1 else 0.5) for index in range(count)]
        return {f"r{index}": Pose(rpy=(0.0, 0.0, turn)) for index, turn in enumerate(turns)}

    # Lookup tables

    def _lookup(self, spec: RaySensor) -> tuple[CalibrationTable, Dimension] | None:
        assert spec.lookup is not None
        distance = self._column("distance", spec.lookup.distance, LENGTH)
        value = self._column("value", spec.lookup.value, None)
        noise = self._column("noise", spec.lookup.noise, NUMBER) if spec.lookup.noise is not None else ((), NUMBER)
        if distance is None or value is None or noise is None:
            return None
        columns = {"value": value[0], **({"noise": noise[0]} if spec.lookup.noise is not None else {})}
        sound = self._is_table(distance[0], columns)
        return (CalibrationTable(distance[0], value[0], noise[0]), value[1]) if sound else None

    def _column(self, key: str, given: object, dimension: Dimension | None) -> tuple[tuple[float, ...], Dimension] | None:
        path = (*self.path, "lookup", key)
        text = self.values.text(path, given)
        typed = self.values.quantity(text, f"`{key}`", NoNames(), dimension, ANY_SHAPE)
        figures = self.values.fixed(typed, text, f"`{key}`") if typed else None
        return (tuple(map(float, figures)), typed.type.dimension) if typed and figures else None

    def _is_table(self, distance: tuple[float, ...], columns: dict[str, tuple[float, ...]]) -> bool:
        place = (*self.path, "lookup")
        sound = True
        for key, column in columns.items():
            if len(column) != len(distance):
                headline = f"`{key}` has {len(column)} figures, `distance` {len(distance)}"
                self.values.findings.add("DB106", self.values.span((*place, key)), headline, help="give one for each distance")
                sound = False
        fault = _fault(distance, columns.get("noise", ()))
        if fault is not None:
            key, headline, help = fault
            self.values.findings.add("DB105", self.values.span((*place, key)), headline, help=help)
        return sound and fault is None


def _fault(distance: tuple[float, ...], noise: tuple[float, ...]) -> tuple[str, str, str] | None:
    """Where a table cannot be meant: the column, and what is wrong with it."""
    falling = [b for a, b in pairwise(distance) if b <= a]
    if falling:
        return "distance", f"the distances do not rise at {falling[0]:g} m", "give the nearest first"
    if distance[0] < 0.0 or distance[-1] <= 0.0:
        return "distance", f"a distance of {min(distance[0], distance[-1]):g} m", "distances are 0 or more, the last more than 0"
    if noise and min(noise) < 0.0:
        return "noise", f"a noise of {min(noise):g}", "give 0 or more"
    return None


def _named(rays: dict[str, Pose]) -> Components:
    """The names of the rays; none for a single one without a name."""
    return () if "" in rays else tuple(rays)


_LINKS = frozenset({Kind.LINK})
_FELT = frozenset({Kind.GROUND, Kind.ROBOT, Kind.OBJECT, Kind.OBJECTS, Kind.LINK, Kind.LINKS, Kind.WALL, Kind.WALLS})


class Sensing:
    """What the sensors of one robot are. Those with findings are missing, and their names have no type."""

    def __init__(self, scene: RobotScene, namespace: Namespace) -> None:
        self._scene = scene
        self._namespace = namespace
        self._values = namespace.values
        self.path: Path = ("robots", scene.name, "sensors")
        self.symbols: dict[str, Symbol] = {}
        self._sensors: dict[str, Sensor] = {}
        for name, spec in scene.spec.sensors.items():
            self.symbols[name] = Symbol(name, None)
            self._add(name, spec)
        self._check_size()

    def finished(self, tick: float) -> tuple[Sensor, ...]:
        """The sensors in a world whose timestep is `tick` s, which their periods are multiples of."""
        specs = self._scene.spec.sensors
        return tuple(
            replace(sensor, faults=period(sensor.faults, self._values, (*self.path, name), specs[name].period, tick))
            for name, sensor in self._sensors.items()
        )

    def _check_size(self) -> None:
        """DB005 for more than a robot can send in every tick."""
        rays = sum(len(sensor.beams.rays) for sensor in self._sensors.values() if sensor.beams)
        values = sum(math.prod(symbol.type.picture) for symbol in self.symbols.values() if symbol.type and symbol.type.picture)
        for count, most, what in ((rays, MAX_SENSED_RAYS, "rays"), (values, MAX_OBSERVED_BYTES, "bytes of pictures")):
            if count > most:
                headline = f"`{self._scene.name}` senses {count:_} {what}, more than {most:_}"
                self._values.findings.add("DB005", self._values.key_span(self.path), headline, help="every one is read in every timestep")

    def _add(self, name: str, spec: SensorSpec) -> None:
        place = (*self.path, name)
        match spec:
            case JointSensor():
                made = self._of_joints(name, spec, place)
            case ContactSensor():
                made = self._of_contacts(name, spec, place)
            case RayScan():
                made = self._of_rays(name, spec, place)
            case Camera():
                made = self._of_camera(name, spec, place)
            case LinkSensor():
                made = self._of_link(name, spec, place)
            case _:
                made = None
        if made is None:
            return
        sensor, known = made
        slides = isinstance(spec, JointSensor) and joint_dimension(self._scene.model.joint(sensor.subjects[0])) == LENGTH
        scope = ParameterScope(self._namespace, Context.FIXED)
        own = read_parameters(self._values, place, spec, parameters(type(spec)), known.dimension, scope, slides=slides)
        if own is None:
            return
        sensor = replace(sensor, parameters=own)
        reader = FaultReader(self._namespace, self._scene.name, name, place)
        faults, reach = reader.read(spec, known)
        if isinstance(spec, RaySensor) and spec.lookup is None:
            sensor = self._reaching(sensor, spec, faults, place)
        unitless = known.boolean or known.picture
        self._sensors[name] = replace(sensor, unit="" if unitless else str(known.dimension), faults=faults)
        self.symbols[name] = Symbol(name, known._replace(interval=reach, stage=Stage.STEP))

    def _of_joints(self, name: str, spec: JointSensor, place: Path) -> tuple[Sensor, Type] | None:
        joints = joints_of(self._values, self._scene.model, self._scene.groups, spec, place)
        if not joints:
            return None
        names = tuple(joint.name for joint in joints)
        components = names if spec.joints is not None else ()
        known = _type(spec.dimension_of(joints[0]), components, spec.interval_of(hull(joints)))._replace(boolean=spec.boolean)
        return _sensor(name, spec, names, components), known

    def _of_link(self, name: str, spec: LinkSensor, place: Path) -> tuple[Sensor, Type] | None:
        if not self._is_link(spec.link, place):
            return None
        frame = mount(self._values, (*place, "pose"), spec.pose)
        sensor = _sensor(name, spec, (spec.link,), spec.components)
        known = _type(spec.dimension, spec.components, spec.interval)._replace(boolean=spec.boolean)
        return replace(sensor, mount=frame), known

    def _of_contacts(self, name: str, spec: ContactSensor, place: Path) -> tuple[Sensor, Type] | None:
        links = links_of(self._values, self._scene.link_names, self._scene.groups, spec, place)
        against = self._against(spec, place) if isinstance(spec, Touch) and spec.against is not None else None
        if not links:
            return None
        components = links if spec.links is not None else ()
        known = _type(spec.dimension, components, spec.interval)._replace(boolean=spec.boolean)
        return replace(_sensor(name, spec, links, components), against=against), known

    def _of_rays(self, name: str, spec: RayScan, place: Path) -> tuple[Sensor, Type] | None:
        beams = BeamReader(self._values, place).read(spec)
        if not self._is_link(spec.link, place) or beams is None:
            return None
        frame = mount(self._values, (*place, "pose"), spec.pose)
        sensor = _sensor(name, spec, (spec.link,), beams.components)
        return replace(sensor, mount=frame, beams=beams.beams), _type(beams.dimension, beams.components, beams.interval)

    def _of_camera(self, name: str, spec: Camera, place: Path) -> tuple[Sensor, Type] | None:
        seen = optics(self._values, place, spec)
        if not self._is_link(spec.link, place) or seen is None:
            return None
        frame = mount(self._values, (*place, "pose"), spec.pose)
        return replace(_sensor(name, spec, (spec.link,), ()), mount=frame, optics=seen), Type(picture=seen.shape, stage=Stage.STEP)

    def _reaching(self, sensor: Sensor, spec: RaySensor, faults: NoiseModel | None, place: Path) -> Sensor:
        """The sensor with rays that go to the end of its range."""
        if "range" not in spec.model_fields_set:
            headline = f"how far `{sensor.name}` sees is not known"
            self._values.findings.add("DB102", self._values.key_span(place), headline, help="give its `range: 0 .. 1 m`, or a `lookup`")
        reach = max(faults.high) if faults and faults.high else 0.0
        if faults and faults.high and reach <= 0.0:
            headline = f"a range that ends at {reach:g} m"
            self._values.findings.add("DB105", self._values.span((*place, "range")), headline, help="distances are more than 0")
        return replace(sensor, beams=replace(sensor.beams, reach=reach) if sensor.beams else None)

    def _is_link(self, link: str, place: Path) -> bool:
        known = link in self._scene.link_names
        if not known:
            self._values.unknown(self._values.span((*place, "link")), "link", link, self._scene.link_names)
        return known

    def _against(self, spec: Touch, place: Path) -> tuple[str, ...]:
        """The full names of what a touch sensor feels."""
        given = spec.against or ()
        found: list[str] = []
        for index, name in enumerate([given] if isinstance(given, str) else given):
            subject = self._namespace.subject(name, _LINKS)
            if subject is not None and subject.kind in _FELT:
                found += subject.members or subject.pieces or (subject.name,)
            elif subject is None or subject.kind is not Kind.BROKEN:
                span = self._values.span((*place, "against") if isinstance(given, str) else (*place, "against", index))
                self._values.unknown(span, "body or link", name, [*self._felt(), "ground"])
        return tuple(dict.fromkeys(found))

    def _felt(self) -> list[str]:
        """Every body and link that a touch sensor may feel."""
        subjects = {name: self._namespace.subject(name, _LINKS) for name in self._namespace.subjects()}
        return [name for name, subject in subjects.items() if subject is not None and subject.kind in _FELT]


def _sensor(name: str, spec: SensorSpec, subjects: tuple[str, ...], components: Components) -> Sensor:
    return Sensor(name, spec.type, subjects, components, "", reader=spec.reader, fact=spec.fact)


def _type(dimension: Dimension, components: Components, interval: Interval) -> Type:
    return Type(dimension, components or None, interval=interval, stage=Stage.STEP)
