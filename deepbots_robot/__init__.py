"""An exported policy on a robot: numpy and onnxruntime, without deepbots_cli and without torch.

    import deepbots_robot

    bundle = deepbots_robot.load("cartpole-bundle")      # checks schema, graph and digests, and replays the recorded steps
    policy = bundle.start()
    commands = policy.step({"cart.pole_angle": [0.01], ...})

model.py      bundle.json as records; schema.py writes their JSON Schema
onnx_file.py  whether a graph consists of known operators alone
bundle.py     loading a bundle with all checks; the policy as an object to call
"""

from deepbots_robot.bundle import Bundle, Policy, load
from deepbots_robot.model import BundleError, BundleInfo, InputError

__all__ = ["Bundle", "BundleError", "BundleInfo", "InputError", "Policy", "load"]
