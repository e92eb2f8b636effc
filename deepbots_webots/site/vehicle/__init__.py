"""Webots' module `vehicle`, for worlds that deepbots runs."""

from deepbots_webots.vehicle import Car, Driver

__all__ = ["Car", "Driver"]
