"""An exported policy on a robot: numpy and onnxruntime, without deepbots_cli and without torch.

    import deepbots_robot

    bundle = deepbots_robot.load("cartpole-bundle")  # checks it, and replays its recorded steps
    policy = bundle.start()
    commands = policy.step({"cart.pole_angle": [0.01], ...})

model.py      bundle.json as records, and their JSON Schema
onnx_file.py  the check that a graph consists of known operators alone
bundle.py     loading a bundle with all checks; the policy as an object to call
signature.py  signatures of bundles: who exported one, and that nothing in it was changed
topics.py     the parts of ROS 2 messages that carry fields, with units and counts; default topics of a robot
ros.py        fields as messages of ROS 2 and back, as types of Cyclone DDS
link.py       the interface of a link, the descriptions of its ends, messages of ZeroMQ and WebSocket
dds.py        the link over ROS 2, and the other programs in its domain
zeromq.py     the link over ZeroMQ
websocket.py  the link over WebSocket
server.py     the loop that acts: checks of messages, steps, limits of commands, the safe posture
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
    """Import a public name when it is first used, because `topics` also checks scenarios, without numpy."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"deepbots_robot.{_MODULES[name]}"), name)
