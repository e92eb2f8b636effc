"""Webots' module `controller`, in the process of a controller."""

from deepbots_cli.webots.ranging import LidarPoint, RadarTarget
from deepbots_cli.webots.remote.client import CLASSES
from deepbots_cli.webots.tree import ContactPoint
from deepbots_cli.webots.unimplemented import MISSING_CLASSES

globals().update(CLASSES)

__all__ = ["ContactPoint", "LidarPoint", "RadarTarget", *CLASSES]


def __getattr__(name: str) -> object:
    if name in MISSING_CLASSES:
        raise ImportError(f"controller.{name} is not implemented")
    raise AttributeError(f"module 'controller' has no attribute '{name}'")
