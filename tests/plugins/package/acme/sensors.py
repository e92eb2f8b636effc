"""A kind of sensor; it imports nothing of the runtime, since `deepbots lint` imports it."""

from typing import Annotated, Literal

from deepbots_cli.expressions.dimensions import NUMBER
from deepbots_cli.scenario.fields import Scalar
from deepbots_cli.scenario.quantities import Quantity
from deepbots_cli.scenario.sensors import JointSensor


class Tachometer(JointSensor):
    """Counts the pulses of a disc on a joint, in pulses per second."""

    dimension = NUMBER
    sliding = NUMBER
    reader = "acme.runtime:tachometer"

    type: Literal["tachometer"]
    spacing: Annotated[Scalar, Quantity("angle or length", minimum=0, exclusive=True)] = "1 deg"
    """The way between two pulses."""
    direction: Literal["both", "forward"] = "both"
    """Whether it tells forward from backward."""
