"""A kind of actuator; it imports nothing of the runtime, since `deepbots lint` imports it."""

from typing import Annotated, Literal

from deepbots_cli.expressions.dimensions import NUMBER
from deepbots_cli.expressions.intervals import Interval
from deepbots_cli.scenario.actuators import JointActuator
from deepbots_cli.scenario.fields import Scalar
from deepbots_cli.scenario.quantities import Quantity


class Throttle(JointActuator):
    """A DC motor whose torque falls with its speed; its command is the share of the voltage, -1 to 1."""

    dimension = NUMBER
    sliding = NUMBER
    interval = Interval(-1.0, 1.0)
    drive = "acme.runtime:throttle"

    type: Literal["throttle"]
    stall_torque: Annotated[Scalar, Quantity("torque or force", minimum=0, exclusive=True)]
    """Torque or force at rest and full voltage."""
    idle_speed: Annotated[Scalar, Quantity("angular speed or speed", minimum=0, exclusive=True)]
    """Speed at full voltage without a load."""
