"""A first scenario for a robot file: what kind of robot it is, and a task that suits it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path, PurePosixPath

from deepbots_cli.cli import robot_file
from deepbots_cli.cli.copying import Files
from deepbots_cli.cli.starters import flying, jointed, rolling
from deepbots_cli.cli.starters.draft import Draft
from deepbots_cli.cli.starters.parts import Robot
from deepbots_cli.cli.starters.survey import Survey
from deepbots_cli.cli.starters.templates import title
from deepbots_cli.document import shipped
from deepbots_cli.document.files import Refused, project_root, resolve
from deepbots_cli.errors import UsageError
from deepbots_cli.robots.model import RobotModel


def files(robot: str, name: str, folder: Path) -> Files:
    """The scenario `NAME.yaml` for `folder`, about a robot file: a path, a shipped name, or package://...

    Raises:
        UsageError: There is no such file, a scenario of that folder may not read it, or nothing of it can be driven.
        ScenarioError: It cannot be read as a robot; says why.
    """
    file, _ = robot_file.opened(robot)
    text = scenario(file.model, _reference(robot, folder), title(name))
    return {PurePosixPath(f"{name}.yaml"): text.encode()}


def _reference(robot: str, folder: Path) -> str:
    """What a scenario in `folder` calls a robot file."""
    if robot.startswith("package://") or shipped.robot_path(robot) is not None:
        return robot
    path = os.path.relpath(Path(robot).resolve(), folder.resolve()).replace(os.sep, "/")
    found = resolve(path, folder.resolve(), [project_root(folder), *shipped.data_roots()])
    if isinstance(found, Refused):
        raise UsageError(f"a scenario in {folder.resolve()} may not read {robot}, which {found.headline.partition('` ')[2]}; copy it there")
    return path


def scenario(model: RobotModel, reference: str, name: str) -> str:
    """The text of a scenario called `name`, which refers to the robot file by `reference`.

    Raises:
        UsageError: Nothing of the robot can be driven, or a joint moves nothing that has mass, with which no simulation begins.
    """
    survey = Survey(model)
    if survey.weightless:
        joint = survey.weightless[0]
        raise UsageError(f"joint '{joint.name}' of {reference} moves nothing that has mass; give link '{joint.child}' an inertial with one")
    if not survey.driven and not survey.rotors:
        raise UsageError(f"{reference} has no joint with a motor and no rotor, so there is nothing that a policy could do with it")
    robot = Robot(survey, reference, fixed=is_fixed(survey))
    draft = _draft(survey, robot)
    draft.remarks[:0] = _remarks(survey, robot)
    return draft.text(name)


def is_fixed(survey: Survey) -> bool:
    """Whether it is bolted down: its root is no body, or all of it is one limb that reaches out of its foot."""
    if survey.wheels or survey.rotors:
        return False
    if survey.model.root == "world" or not any(survey.model.link(name).inertial for name in survey.trunk):
        return True
    if len(survey.limbs) != 1:
        return False
    first = survey.limbs[0].moving
    return len(first) == 1 or first[0].type == "prismatic" or survey.limbs[0].reach > _width(survey)


def _width(survey: Survey) -> float:
    """In m, the longest level side of the foot: a limb that stays within is a weight in a ball, and no arm."""
    boxes = [survey.extents[name] for name in survey.trunk if name in survey.extents]
    return max((high[axis] - low[axis] for low, high in boxes for axis in (0, 1)), default=0.0)


def _draft(survey: Survey, robot: Robot) -> Draft:
    if survey.rotors:
        return flying.hover(survey, robot)
    if survey.balances or (survey.inverted and (survey.wheels or robot.fixed)):
        return rolling.balance(survey, robot)
    if survey.wheels:
        return rolling.drive(survey, robot)
    if robot.fixed:
        arm = jointed.reach(survey, robot) if len(survey.limbs) == 1 and len(survey.limbs[0].moving) > 1 else None
        return arm or jointed.posture(survey, robot)
    legged = len(survey.limbs) > 1 and all(len(limb.moving) > 1 for limb in survey.limbs)
    sliding = any(joint.type == "prismatic" for joint in survey.driven)
    return jointed.walk(survey, robot) if legged and not sliding else jointed.roam(survey, robot)


def _remarks(survey: Survey, robot: Robot) -> list[str]:
    """What was found in the robot file, for the head of the scenario."""
    model = survey.model
    moving = len(model.moving_joints)
    parts = [f"{moving} of {len(model.joints)} joints move"]
    parts += [f"{len(survey.wheels)} of them carry wheels"] if survey.wheels else []
    parts += [f"{len(survey.steering)} steer"] if survey.steering else []
    parts += [f"{len(survey.rotors)} rotors"] if survey.rotors else []
    parts += [f"{len(survey.limbs)} limb{'s' if len(survey.limbs) > 1 else ''}"] if survey.limbs and not survey.wheels else []
    parts += [f"{len(survey.idle)} without a motor"] if survey.idle else []
    base = "taken to be fixed to the ground" if robot.fixed else "free"
    followers = [joint.name for joint in model.moving_joints if joint.mimic]
    return [
        f"What was found in {robot.reference}: {', '.join(parts)};",
        f"{survey.mass:.3g} kg, {survey.size:.3g} m long at most; its base is {base}. Figures below were chosen from these: change them.",
        *([f"<mimic> is not simulated: {_few(followers)} moved like any other joint here."] if followers else []),
    ]


def _few(names: Sequence[str]) -> str:
    shown = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
    return f"{shown} {'is' if len(names) == 1 else 'are'}"
