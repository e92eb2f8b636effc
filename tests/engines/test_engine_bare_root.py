"""A free robot whose root link is a mere frame moves as the body that hangs on it does."""

from contextlib import closing

import pytest

from deepbots_cli import engines
from deepbots_cli.errors import EngineError
from deepbots_cli.frames import IDENTITY_ROTATION
from deepbots_cli.program.world import RobotBody, WorldModel
from deepbots_cli.robots.model import Box, Geometry, Inertial, Joint, Link, Pose, RobotModel

TENSOR = {"ixx": 0.02, "iyy": 0.05, "izz": 0.06}
SHAPE = (Geometry(Box((0.4, 0.3, 0.2))),)
HELD = Joint("mount", "fixed", "frame", "hull", Pose((0.1, 0.0, 0.3)))


def robot(bare: bool) -> RobotModel:
    """A box on a fixed joint; the mass is at the box, or, which means the same, in the root's own
    inertial."""
    known = Inertial(2.0, **TENSOR)
    hull = Link("hull", known if bare else None, SHAPE, SHAPE)
    frame = Link("frame", None if bare else Inertial(2.0, Pose((0.1, 0.0, 0.3)), **TENSOR))
    return RobotModel("robot", (frame, hull), (HELD,), "frame")


def tumble(engine_name: str, model: RobotModel) -> list[float]:
    world = WorldModel(0.01, 40, robots=(RobotBody("robot", model),))
    with closing(engines.create(engine_name, world)) as engine:
        read, found = engine.pose("robot"), []
        engine.place("robot", (0.0, 0.0, 0.5), IDENTITY_ROTATION, (1.0, 0.0, 2.0), (1.0, 2.0, 3.0))
        for _ in range(40):
            engine.step(40)
            found += [number for part in read() for number in part]
        return found


def test_a_root_without_mass_moves_with_what_is_fixed_to_it(engine_name: str) -> None:
    assert tumble(engine_name, robot(bare=True)) == pytest.approx(
        tumble(engine_name, robot(bare=False)), abs=3e-4
    )  # of first order in the physics step


def test_a_free_robot_without_any_mass_is_refused(engine_name: str) -> None:
    massless = RobotModel("robot", (Link("frame"), Link("hull")), (HELD,), "frame")
    with pytest.raises(EngineError, match="has no mass"):
        engines.create(engine_name, WorldModel(0.01, 1, robots=(RobotBody("robot", massless),)))
