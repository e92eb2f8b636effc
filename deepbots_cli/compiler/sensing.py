"""The sensors of a robot, read from the scenario: what they sit on, their rays, their type. `faults` says how they err."""

from __future__ import annotations

import math
from dataclasses import replace

from deepbots_cli.compiler.beams import BeamReader
from deepbots_cli.compiler.faults import FaultReader, period
from deepbots_cli.compiler.joints import hull, sensed_dimension
from deepbots_cli.compiler.matching import joints_of, links_of
from deepbots_cli.compiler.mounts import mount
from deepbots_cli.compiler.namespace import Namespace
from deepbots_cli.compiler.optics import optics
from deepbots_cli.compiler.robots import RobotScene
from deepbots_cli.compiler.sensors import SENSOR_KINDS, SensorKind
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.dimensions import Dimension
from deepbots_cli.expressions.intervals import EVERYTHING, Interval
from deepbots_cli.expressions.types import Components, Kind, Stage, Symbol, Type
from deepbots_cli.program.robots import MAX_SENSED_RAYS, NoiseModel, Sensor
from deepbots_cli.program.task import MAX_OBSERVED_BYTES
from deepbots_cli.scenario.sensors import Camera, ContactSensor, JointSensor, LinkSensor, RayScan, RaySensor, TouchSensor
from deepbots_cli.scenario.sensors import Sensor as SensorSpec

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
            self._add(name, spec, SENSOR_KINDS[spec.type])
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

    def _add(self, name: str, spec: SensorSpec, kind: SensorKind) -> None:
        place = (*self.path, name)
        match spec:
            case JointSensor():
                made = self._of_joints(name, spec, place)
            case ContactSensor():
                made = self._of_contacts(name, spec, kind, place)
            case RayScan():
                made = self._of_rays(name, spec, kind, place)
            case Camera():
                made = self._of_camera(name, spec, place)
            case LinkSensor():
                made = self._of_link(name, spec, kind, place)
            case _:
                made = None
        if made is None:
            return
        sensor, known = made
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
        interval = hull(joints) if spec.type == "joint_position" else EVERYTHING
        return _sensor(name, spec.type, names, components), _type(sensed_dimension(spec.type, joints[0]), components, interval)

    def _of_link(self, name: str, spec: LinkSensor, kind: SensorKind, place: Path) -> tuple[Sensor, Type] | None:
        if not self._is_link(spec.link, place):
            return None
        frame = mount(self._values, (*place, "pose"), spec.pose)
        sensor = _sensor(name, spec.type, (spec.link,), kind.components)
        return replace(sensor, mount=frame), _type(kind.dimension, kind.components, kind.interval)

    def _of_contacts(self, name: str, spec: ContactSensor, kind: SensorKind, place: Path) -> tuple[Sensor, Type] | None:
        links = links_of(self._values, self._scene.link_names, self._scene.groups, spec, place)
        against = self._against(spec, place) if isinstance(spec, TouchSensor) and spec.against is not None else None
        if not links:
            return None
        components = links if spec.links is not None else ()
        known = _type(kind.dimension, components, kind.interval)._replace(boolean=kind.truth)
        return replace(_sensor(name, spec.type, links, components), against=against), known

    def _of_rays(self, name: str, spec: RayScan, kind: SensorKind, place: Path) -> tuple[Sensor, Type] | None:
        beams = BeamReader(self._values, place).read(spec, kind)
        if not self._is_link(spec.link, place) or beams is None:
            return None
        frame = mount(self._values, (*place, "pose"), spec.pose)
        sensor = _sensor(name, spec.type, (spec.link,), beams.components)
        return replace(sensor, mount=frame, beams=beams.beams), _type(beams.dimension, beams.components, beams.interval)

    def _of_camera(self, name: str, spec: Camera, place: Path) -> tuple[Sensor, Type] | None:
        seen = optics(self._values, place, spec)
        if not self._is_link(spec.link, place) or seen is None:
            return None
        frame = mount(self._values, (*place, "pose"), spec.pose)
        return replace(_sensor(name, spec.type, (spec.link,), ()), mount=frame, optics=seen), Type(picture=seen.shape, stage=Stage.STEP)

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

    def _against(self, spec: TouchSensor, place: Path) -> tuple[str, ...]:
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


def _sensor(name: str, kind: str, subjects: tuple[str, ...], components: Components) -> Sensor:
    return Sensor(name, kind, subjects, components, "")


def _type(dimension: Dimension, components: Components, interval: Interval) -> Type:
    return Type(dimension, components or None, interval=interval, stage=Stage.STEP)
