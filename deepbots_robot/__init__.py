"""An exported policy on a robot: numpy and onnxruntime, without deepbots_cli and without torch.

    import deepbots_robot

    bundle = deepbots_robot.load("cartpole-bundle")      # checks it, and replays its recorded steps
    policy = bundle.start()
    commands = policy.step({"cart.pole_angle": [0.01], ...})

model.py      bundle.json as records; schema.py writes their JSON Schema
onnx_file.py  whether a graph consists of known operators alone
bundle.py     loading a bundle with all checks; the policy as an object to call
topics.py     which part of a ROS 2 message carries a field, with units and counts; the first topics of a
              robot
idl.py        the ROS 2 messages as types of Cyclone DDS
ros.py        fields as messages of ROS and back
about.py      what the two ends of a link say about themselves, and what of it does not fit
link.py       what a link between robot and policy is
discovery.py  the other programs in a domain of ROS 2
dds.py        the link over ROS 2
ros1.py       the link over ROS 1
messages.py   the messages of ZeroMQ and WebSocket
zeromq.py     the link over ZeroMQ
websocket.py  the link over WebSocket
intake.py     checks of what a robot sends
server.py     the loop that acts: steps, limits of commands, the safe posture
log.py        the MCAP log of a server
serving.py    a bundle, a link and a server together, until a signal
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from deepbots_robot.bundle import Bundle, Policy, load
    from deepbots_robot.model import BundleError, BundleInfo, InputError

__all__ = ["Bundle", "BundleError", "BundleInfo", "InputError", "Policy", "load"]

_MODULES = {
    "Bundle": "bundle",
    "Policy": "bundle",
    "load": "bundle",
    "BundleError": "model",
    "BundleInfo": "model",
    "InputError": "model",
}


def __getattr__(name: str) -> Any:
    """The public names, imported when they are asked for: `topics` also checks scenarios, without numpy."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"deepbots_robot.{_MODULES[name]}"), name)
