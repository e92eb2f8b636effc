"""Ground, walls, objects and robots, built in a client from the world model."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from deepbots_cli import frames
from deepbots_cli.engines import solids
from deepbots_cli.engines.pybullet import ground, loadable
from deepbots_cli.engines.pybullet.body import Body
from deepbots_cli.engines.pybullet.figures import contact_figures
from deepbots_cli.engines.pybullet.library import BASE, UNREACHABLE
from deepbots_cli.engines.pybullet.library import pybullet as p
from deepbots_cli.engines.pybullet.pool import Pool
from deepbots_cli.engines.quiet import hushed
from deepbots_cli.errors import EngineError
from deepbots_cli.port import STILL
from deepbots_cli.program.world import GROUND
from deepbots_cli.robots.model import Mesh, RobotModel
from deepbots_cli.robots.writer import write

if TYPE_CHECKING:
    from deepbots_cli.program.world import ObjectBody, WorldModel

APART = 1000.0  # m between bodies that are parked
OVERLAP_SHARE = 0.08  # that PyBullet by itself takes away in a physics step
CONTACT_DISTANCE = 1e-4
"""Surfaces further apart than this (m) are no contact for the solver.

PyBullet keeps a point of contact until its surfaces are 2 % of the size of a link apart, so a wheel that rolls takes along
points that carry nothing, and the solver iterates over all of them. With this limit a step of CartPole costs 0.68 of what it
did, and its heights differ by 1e-6 m. At 2e-5 m and below, wheels lose the ground between two steps and sink by 0.3 mm. On
terrain there is no such limit: with it, two trainings of PitEscape took 1.25 and 1.65 times as many steps. The cause was not
measured; a ball that rolls over an edge of a triangle may be further away than this for a step.
"""


def connected(world: WorldModel) -> int:
    """A client with the world's gravity and timestep, and nothing in it."""
    client: int = p.connect(p.DIRECT)
    if client < 0:
        raise EngineError("PyBullet holds no further world in this process; close some environments")
    p.setGravity(*world.gravity, client)
    p.setPhysicsEngineParameter(
        fixedTimeStep=world.timestep / world.substeps, deterministicOverlappingPairs=1, enableFileCaching=0, physicsClientId=client
    )
    if any(figure > 0.0 for figure in _restitutions(world)):
        # Overlap is given back as speed, and more of it with every step of an impact: of a bounce of 0.8 at steps of 1 ms,
        # 0.82 to 0.88 was left. Given back within 0.2 s, 0.80 to 0.81 is. Worlds without bounces stay as they are.
        p.setPhysicsEngineParameter(contactERP=min(OVERLAP_SHARE, world.timestep / world.substeps / 0.2), physicsClientId=client)
    return client


def _restitutions(world: WorldModel) -> Iterator[float]:
    """Of everything there is, as far as it states one."""
    if world.ground is not None:
        yield world.ground.restitution
    for thing in world.objects:
        yield thing.restitution
    for robot in world.robots:
        yield from (link.friction.restitution or 0.0 for link in robot.model.links)


def bodies(client: int, world: WorldModel) -> Iterator[Pool]:
    """Everything there is, in the order of the world model."""
    for pool in _loaded(client, world):
        if world.terrain is None:
            for body in pool:
                _limit_contacts(client, body)
        yield pool


def _limit_contacts(client: int, body: Body) -> None:
    """Let links that do not bounce have contacts within `CONTACT_DISTANCE` only."""
    for link in body.model.links:
        if not link.friction.restitution:
            p.changeDynamics(body.number, body.links[link.name], contactProcessingThreshold=CONTACT_DISTANCE, physicsClientId=client)


def _loaded(client: int, world: WorldModel) -> Iterator[Pool]:
    floor = ground.body(client, world)
    if floor is not None:
        _make_contact(client, floor)
        yield Pool(GROUND, [(GROUND, floor)], pooled=False)
    parked = 0
    with tempfile.TemporaryDirectory(prefix="deepbots-") as folder:
        file = Path(folder, "body.urdf")
        for thing in (*(solids.walls(world.arena) if world.arena else ()), *world.objects):
            forms = [(name, _object(client, form, file)) for name, form in solids.forms(thing).items()]
            for _, body in forms if thing.pooled else ():
                parked += 1
                body.home = ((-parked * APART, 0.0, -APART), frames.UPRIGHT)
            yield Pool(thing.name, forms, thing.pooled)
        for robot in world.robots:
            model = loadable.movable(robot.name, robot.model, robot.fixed_base)
            body = _load(client, robot.name, model, robot.fixed_base, file)
            body.home = body.of_centre(*frames.frame(robot.pose))
            yield Pool(robot.name, [(robot.name, body)], pooled=False)


def join_islands(client: int, pools: Iterable[Pool]) -> None:
    """Tie all that moves to one another with gears that exert nothing, so that the solver sees one group.

    It solves bodies whose boxes overlap together, iterates until such a group is done, and forgets overlaps
    at a moment that depends on the whole past. Of 150 episodes of three carts after a reset 34 differed from
    a fresh world's; tied together, none. 20 idle balls then cost 50 us a step; a robot by itself nothing.
    All hang on the first, which is one that is always there if there is any, since an absent one ties nothing.
    """
    tied = sorted((pool for pool in pools), key=lambda pool: pool.pooled)
    anchors = [(body.number, body.anchor) for pool in tied for body in pool if body.anchor is not None]
    for number, link in anchors[1:]:
        gear = p.createConstraint(*anchors[0], number, link, p.JOINT_GEAR, (0, 1, 0), STILL, STILL, physicsClientId=client)
        p.changeConstraint(gear, maxForce=0.0, physicsClientId=client)


def _object(client: int, thing: ObjectBody, file: Path) -> Body:
    known = not isinstance(thing.shape, Mesh)
    body = _load(client, thing.name, solids.as_robot(thing), not solids.moves(thing), file, inertia_known=known)
    body.home = body.of_centre(*frames.frame(thing.pose))
    return body


def _load(client: int, name: str, model: RobotModel, fixed: bool, file: Path, inertia_known: bool = True) -> Body:
    file.write_text(write(loadable.dressed(model)), encoding="utf-8")
    flags = p.URDF_USE_IMPLICIT_CYLINDER | (p.URDF_USE_INERTIA_FROM_FILE if inertia_known else 0)
    with hushed() as said:
        try:
            number = p.loadURDF(str(file), useFixedBase=int(fixed), flags=flags, physicsClientId=client)
        except p.error as error:
            raise EngineError(f"PyBullet cannot load '{name}': {said() or error}") from error
    body = Body(name, number, model, fixed, client)
    _make_contact(client, body)
    for setting in (
        {"linearDamping": 0.0},
        {"angularDamping": 0.0},
        {"maxJointVelocity": UNREACHABLE},
        {"activationState": p.ACTIVATION_STATE_DISABLE_SLEEPING},
    ):
        p.changeDynamics(number, BASE, **setting, physicsClientId=client)
    return body


def _make_contact(client: int, body: Body) -> None:
    """Set friction and restitution, one property per call: two in one went to the root link.

    A link that bounces makes contact at distance 0. The solver otherwise brakes it before it touches: of a bounce of 0.8
    between 0.06 and 0.82 was left, at 1 ms a step.
    """
    for link in body.model.links:
        figures = contact_figures(link.friction)
        if figures["restitution"] > 0.0:
            figures["contactProcessingThreshold"] = 0.0
        for what, value in figures.items():
            p.changeDynamics(body.number, body.links[link.name], **{what: value}, physicsClientId=client)
