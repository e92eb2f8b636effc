"""What the tasks for robot files have in common: groups of joints, motors, and the lines that tell of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from deepbots_cli.cli.starters.draft import Draft, figure, fresh, listed, pose, settled, word
from deepbots_cli.cli.starters.limbs import Positions, neutral
from deepbots_cli.cli.starters.survey import Survey
from deepbots_cli.robots.model import Joint

GRAVITY = 9.81
_SUNK = 1e-3  # m
PARTS = ("groups", "poses", "sensors", "actuators", "emit", "apply")
_SAID = {
    "emit": "what the robot tells the supervisor",
    "apply": "what it does when it is told",
    "poses": "positions of joints by names",
}


@dataclass
class Robot:
    """The entry of a robot in the making, called `robot`: the lines of each of `PARTS`, those of `reset.set`, how its joints start."""

    survey: Survey
    reference: str
    fixed: bool = False
    parts: dict[str, list[str]] = field(default_factory=dict)
    sets: list[str] = field(default_factory=list)
    start: Positions = field(default_factory=dict)

    def add(self, part: str, *lines: str) -> None:
        self.parts.setdefault(part, []).extend(lines)

    def group(self, name: str, joints: Sequence[Joint]) -> str:
        """Name a group of joints so that no link or joint is called the same; the name that it got."""
        model = self.survey.model
        name = fresh(name, [*(link.name for link in model.links), *(joint.name for joint in model.joints)])
        self.add("groups", *listed(name, [joint.name for joint in joints]))
        return name

    def begin(self, group: str, at: str, positions: Mapping[str, float], joints: Sequence[Joint]) -> str:
        """Name positions of a group's joints, in which an episode begins; the name that they got."""
        at = fresh(at, [group])
        rounded = {joint.name: settled(joint, positions[joint.name]) for joint in joints}
        self.add("poses", *pose(at, rounded, joints))
        self.sets.append(f"robot.{group}: {at}")
        self.start |= rounded
        return at

    def motor(self, name: str, kind: str, group: str, joints: Sequence[Joint], command: str) -> None:
        """A motor on a group of joints, as strong as the file says; where it is silent, enough for its weight."""
        strong = "" if all(joint.limit.effort for joint in joints) else f", max_torque: {self.enough(joints)}"
        self.add("actuators", f"{name}: {{type: {kind}, joints: {group}{strong}}}")
        self.add("apply", f"{name}: {command}")

    def enough(self, joints: Sequence[Joint]) -> str:
        weight = max(self.survey.mass, 0.1) * GRAVITY
        if joints[0].type == "prismatic":
            return f"{figure(2.0 * weight)} N"
        radius = max((wheel.radius for wheel in self.survey.wheels), default=self.survey.size / 2)
        return f"{figure(weight * radius)} N*m"

    def hold(self, joints: Sequence[Joint]) -> None:
        """Motors that keep joints where they are at the start."""
        for name, kept in by_unit(joints):
            group = self.group(f"held_{name}", kept)
            at = self.begin(group, f"rest_{name}", {joint.name: neutral(joint) for joint in kept}, kept)
            self.motor(f"hold_{name}", "position_motor", group, kept, at)

    def into(self, draft: Draft, place: Mapping[str, str] | None = None) -> None:
        """Write the robot, and where it starts."""
        lines = ["robot:", f"  urdf: {word(self.reference)}"]
        if self.fixed:
            lines.append("  base: fixed    # bolted to the ground; delete the line to let it go")
        for part in PARTS:
            if part in self.parts:
                said = f"    # {_SAID[part]}" if part in _SAID else ""
                first, *others = self.parts[part]
                is_flow = first.startswith(("[", "{"))
                lines += [f"  {part}: {first}{said}"] if is_flow else [f"  {part}:{said}", *(f"    {line}" for line in (first, *others))]
            elif part == "emit":
                lines.append("  emit: []")
        draft.add("robots", *lines)
        place = {**self._raised(), **(place or {})}
        if place:
            draft.add("reset", "place:", f"  robot: {{{', '.join(f'{key}: {value}' for key, value in place.items())}}}")
        if self.sets:
            draft.add("reset", "set:", *(f"  {line}" for line in self.sets))

    @property
    def height(self) -> float:
        """In m, of its root as it starts: of one that is bolted down no more than it takes to keep the rest out of the ground."""
        standing = self.survey.height(self.start)
        return max(standing, 0.0) if self.fixed else standing

    def _raised(self) -> dict[str, str]:
        """Its height, where it would begin within the ground: a free one is put on the ground as it is with all joints at 0."""
        usual = 0.0 if self.fixed else self.survey.height({})
        return {"z": f"{figure(self.height)} m"} if self.height > usual + _SUNK else {}


def by_unit(joints: Sequence[Joint]) -> list[tuple[str, list[Joint]]]:
    """Joints that turn apart from those that slide, which never share a group."""
    hinges = [joint for joint in joints if joint.type != "prismatic"]
    slides = [joint for joint in joints if joint.type == "prismatic"]
    return [(name, some) for name, some in (("hinges", hinges), ("slides", slides)) if some]


def train(draft: Draft, algorithm: str, steps: int, hidden: int) -> None:
    """Figures to begin a training with."""
    shared = [f"algorithm: {algorithm}", f"total_timesteps: {steps:_}", "environments: 8", "learning_rate: 1e-3 -> 1e-4"]
    if algorithm == "TD3":
        shared += ["batch_size: 256", "gamma: 0.95", "action_noise: {type: normal, sigma: 0.2 -> 0.05}"]
        draft.add("train", *shared, f"policy: {{hidden: [{hidden}, {hidden}], activation: relu}}")
    else:
        shared += ["n_steps: 128", "batch_size: 256", "gamma: 0.98"]
        draft.add("train", *shared, f"policy: {{hidden: [{hidden}, {hidden}], activation: tanh}}")
