"""A first scenario for a robot file: the task that suits its build."""

from __future__ import annotations

from collections.abc import Callable

from deepbots_cli.cli.starters.build import Build
from deepbots_cli.cli.starters.draft import Draft
from deepbots_cli.cli.starters.tasks import balance, drive, hover, posture, reach, roam, walk
from deepbots_cli.cli.starters.text import aligned, templates
from deepbots_cli.errors import UsageError
from deepbots_cli.robots.model import RobotModel


def scenario(model: RobotModel, urdf: str, name: str) -> str:
    """Return the text of a scenario called `name` about a robot file.

    Raises:
        UsageError: No joint of the robot can be driven, or a joint carries no mass, so that it cannot be
            simulated.
    """
    build = Build(model)
    if build.weightless:
        joint = build.weightless[0]
        raise UsageError(
            f"joint '{joint.name}' of {urdf} moves no mass; add an <inertial> with a mass to link"
            f" '{joint.child}'"
        )
    if not build.driven and not build.rotors:
        raise UsageError(
            f"{urdf} has neither a joint that a motor can drive nor a rotor, so a policy could not control it"
        )
    draft = Draft(build, urdf)
    template, values = next(
        (task.__name__, values) for task in _suited(build) if (values := task(draft)) is not None
    )
    text = (
        templates()
        .get_template(f"{template}.yaml")
        .render(name=name, robot=draft, build=build, found=_found(draft), **{"place": draft.raised, **values})
    )
    return "".join(f"{aligned(line)}\n" for line in text.splitlines())


def _suited(build: Build) -> list[Callable[[Draft], dict[str, object] | None]]:
    """Return the tasks that suit a robot, best first; a task may turn out to be impossible."""
    if build.rotors:
        return [hover]
    if build.balances or (build.poles and (build.wheels or build.is_fixed)):
        return [balance]
    if build.wheels:
        return [drive]
    if build.is_fixed:
        return [reach, posture]
    legged = len(build.limbs) > 1 and all(len(limb.joints) > 1 for limb in build.limbs)
    return [walk] if legged and not any(joint.type == "prismatic" for joint in build.driven) else [roam]


def _found(draft: Draft) -> list[str]:
    """Return the parts that were found in the robot file, for the head of the scenario."""
    build = draft.build
    model = draft.build.model
    counts = [
        (len(build.wheels), "of them carries a wheel", "of them carry wheels"),
        (len(build.steering), "steers", "steer"),
        (len(build.rotors), "rotor", "rotors"),
        (0 if build.wheels else len(build.limbs), "limb", "limbs"),
        (len(build.idle), "without a motor", "without a motor"),
        (len(model.followers), "follows another joint", "follow another joint"),
    ]
    moving = len(model.moving_joints)
    parts = [
        f"{moving} of {len(model.joints)} joints {'moves' if moving == 1 else 'move'}",
        *(f"{count} {singular if count == 1 else plural}" for count, singular, plural in counts if count),
    ]
    base = "taken to be fixed to the ground" if draft.is_fixed else "free"
    lines = [
        f"What was found in {draft.urdf}: {', '.join(parts)};",
        f"{build.model.mass:.3g} kg, {build.size:.3g} m long at most; its base is {base}. The values below"
        " were chosen from these: change them.",
        *(
            f"`{link}` has no collision shape: other bodies and rays pass through it. Add a <collision> to"
            " its link."
            for link in build.intangible
        ),
    ]
    return [" ".join(line.split()) for line in lines]  # the name of a file may hold line breaks
