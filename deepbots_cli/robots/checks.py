"""What must hold for the robot as a whole: one tree of links, and inertia that a rigid body can have."""

from __future__ import annotations

from collections.abc import Mapping

from deepbots_cli.diagnostics import Label
from deepbots_cli.robots.inertia import is_plausible
from deepbots_cli.robots.model import Joint, Link, RobotModel
from deepbots_cli.robots.report import Report, known_names, quoted
from deepbots_cli.robots.xml import Element

Elements = Mapping[str, Element]


def references(joints: Mapping[str, Joint], links: Elements, elements: Elements, report: Report) -> bool:
    """Whether every joint joins two known links; every mimic must follow a known joint other than itself."""
    sound = True
    for name, joint in joints.items():
        element = elements[name]
        for tag, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in links:
                sound = False
                headline = f"joint {quoted(name)} has the unknown link {quoted(link)} as its {tag}"
                report.error(element.all(tag)[0], headline, attribute="link", help=known_names(link, links, "links"))
        if joint.mimic and joint.mimic.joint not in joints:
            headline = f"joint {quoted(name)} follows the unknown joint {quoted(joint.mimic.joint)}"
            help = known_names(joint.mimic.joint, joints, "joints")
            report.error(element.all("mimic")[0], headline, attribute="joint", help=help)
    above = {name: joint.mimic.joint for name, joint in joints.items() if joint.mimic}
    for cycle in _cycles(above):
        headline = "these joints follow each other in a circle: " + ", ".join(map(quoted, cycle[:5]))
        report.error(elements[cycle[0]].all("mimic")[0], headline, attribute="joint")
    return sound


def tree(joints: Mapping[str, Joint], links: Elements, elements: Elements, report: Report) -> str | None:
    """The one root link; None where the links do not form one tree, which is then reported."""
    joint_above: dict[str, str] = {}
    sound = True
    for name, joint in joints.items():
        first = joint_above.setdefault(joint.child, name)
        if first != name:
            sound = False
            also = (Label(elements[first].span, f"{quoted(first)} already holds it"),)
            headline = f"link {quoted(joint.child)} has two parents, {quoted(joints[first].parent)} and {quoted(joint.parent)}"
            report.error(elements[name].all("child")[0], headline, attribute="link", also=also)
    parent = {child: joints[name].parent for child, name in joint_above.items()}
    for cycle in _cycles(parent):
        sound = False
        headline = "these links hang on each other in a circle: " + ", ".join(map(quoted, cycle[:5]))
        report.error(elements[joint_above[cycle[0]]], headline, help="remove the joint that closes the circle")
    roots = [name for name in links if name not in parent]
    for name in roots[1:]:
        sound = False
        also = (Label(links[roots[0]].value_span("name"), "the other root"),)
        headline = f"link {quoted(name)} is a second root: no joint has it as its child"
        report.error(links[name], headline, attribute="name", help="join it to another link, or remove it", also=also)
    return roots[0] if sound and roots else None


def _cycles(above: Mapping[str, str]) -> list[list[str]]:
    """The circles in a graph where each name has at most one name above it."""
    found = []
    visited: set[str] = set()
    for start in above:
        path: dict[str, None] = {}
        name = start
        while name in above and name not in visited:
            visited.add(name)
            path[name] = None
            name = above[name]
        if name in path:
            names = list(path)
            found.append(names[names.index(name) :])
    return found


def inertia(model: RobotModel, elements: Elements, report: Report) -> None:
    """DB305 and DB306: links whose inertia is missing or impossible.

    A link that a fixed joint holds, or the root, may be a mere frame. It is one for certain without any shape, as `world` and `tool0`
    are; the others share one warning.
    """
    moving = {joint.child for joint in model.joints if joint.type != "fixed"}
    missing = [link for link in model.links if link.inertial is None and (link.name in moving or link.visuals or link.collisions)]
    _warn(
        report,
        "DB305",
        elements,
        missing,
        moving,
        "no inertial",
        "add an <inertial>; without one a link weighs nothing, which is right for a mere frame",
    )
    massless = [link for link in model.links if link.inertial and link.inertial.mass == 0]
    _warn(report, "DB306", elements, massless, moving, "mass 0", "give it a mass; an engine may treat such a link as immovable")
    for link in model.links:
        if link.inertial and link.inertial.mass > 0 and not is_plausible(link.inertial):
            headline = f"no rigid body can have the inertia of link {quoted(link.name)}"
            help = "each principal moment must be above 0 and at most the sum of the other two"
            report.warn("DB306", _inertia_element(elements[link.name]), headline, help=help)


def _inertia_element(link: Element) -> Element:
    return link.all("inertial")[0].all("inertia")[0]


def _warn(report: Report, code: str, elements: Elements, links: list[Link], moving: set[str], has: str, help: str) -> None:
    """One warning for each link that moves, and one for all the others together."""
    for link in links:
        if link.name in moving:
            report.warn(code, elements[link.name], f"link {quoted(link.name)} moves and has {has}", attribute="name", help=help)
    still = [link.name for link in links if link.name not in moving]
    if len(still) == 1:
        report.warn(code, elements[still[0]], f"link {quoted(still[0])} has {has}", attribute="name", help=help)
    elif still:
        shown = ", ".join(still[:20]) + (f" and {len(still) - 20} more" if len(still) > 20 else "")
        headline = f"{len(still)} links on fixed joints or at the root have {has}"
        report.warn(code, elements[still[0]], headline, attribute="name", help=help, notes=(f"they are: {shown}",))
