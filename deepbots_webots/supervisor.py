"""The classes Robot, Supervisor and Keyboard of the module `controller`."""

from __future__ import annotations

import sys
from itertools import islice
from typing import Any

from deepbots_cli.diagnostics.nearest import did_you_mean
from deepbots_webots.devices import device_object
from deepbots_webots.nodes import text, texts, walk
from deepbots_webots.scene import DEVICES
from deepbots_webots.sensors import Sampled, missing_attribute, returns
from deepbots_webots.simulation import Simulation
from deepbots_webots.tree import Node

_ACTIVE: list[Simulation] = []
"""The simulation that runs in this process; the module `controller` belongs to it."""


def activate(simulation: Simulation) -> None:
    """Let the module `controller` act on a simulation."""
    _ACTIVE[:] = [simulation]


def deactivate() -> None:
    _ACTIVE.clear()


def _active() -> Simulation:
    if not _ACTIVE:
        raise RuntimeError("no simulation runs; start the world with: deepbots webots WORLD.wbt --allow-code")
    return _ACTIVE[0]


class Robot:
    """The robot whose controller this is."""

    MODE_SIMULATION, MODE_CROSS_COMPILATION, MODE_REMOTE_CONTROL = 0, 1, 2

    def __init__(self) -> None:
        simulation = _active()
        if simulation.current is None:
            raise RuntimeError("only a controller can create a Robot")
        # The prefix keeps these names apart from those of controllers, whose classes derive from this one.
        self._webots_simulation, self._webots_robot = simulation, simulation.current
        self.keyboard = Keyboard()

    def __getattr__(self, name: str) -> Any:
        if name.startswith("get") and name[3:] in _DEVICE_CLASSES:  # such as `getGyro`
            return self.getDevice
        raise missing_attribute(type(self), name)

    def step(self, timeStep: int | float | None = None) -> int:
        """Advance the simulation by `timeStep` ms, or by one basic time step; returns -1 at its end."""
        period = self._webots_simulation.basic_step if timeStep is None else int(timeStep)
        return self._webots_simulation.wait(self._webots_robot, period)

    getBasicTimeStep = returns("_webots_simulation.basic_step", float)

    def getTime(self) -> float:
        """Return the simulated time, s."""
        return self._webots_simulation.time / 1000

    getName = returns("_webots_robot.name")
    getControllerName = returns("_webots_robot.controller")
    getSupervisor = returns("_webots_robot.is_supervisor")
    getMode = returns("MODE_SIMULATION")
    getKeyboard = returns("keyboard")

    def getModel(self) -> str:
        return text(self._webots_robot.node, "model")

    getSynchronization = staticmethod(lambda: True)

    def getControllerArguments(self) -> str:
        return " ".join(texts(self._webots_robot.node, "controllerArgs"))

    def getCustomData(self) -> str:
        return self._webots_simulation.custom_data[self._webots_robot.node]

    def setCustomData(self, customData: str) -> None:
        self._webots_simulation.custom_data[self._webots_robot.node] = str(customData)

    getData, setData = getCustomData, setCustomData

    getProjectPath = returns("_webots_simulation.scene.files.project", str)
    getWorldPath = returns("_webots_simulation.world_path")

    def getDevice(self, name: str) -> Any:
        """Return a device, or None with a warning if there is none of this name."""
        spec = self._webots_robot.devices.get(name)
        if spec is not None:
            return device_object(self._webots_simulation, spec)
        hint = did_you_mean(name, self._webots_robot.devices)
        print(f'Warning: "{name}" device not found{hint}', file=sys.stderr)
        return None

    getNumberOfDevices = returns("_webots_robot.devices", len)

    def getDeviceByIndex(self, index: int) -> Any:
        return device_object(self._webots_simulation, list(self._webots_robot.devices.values())[index])


class AnsiCodes:
    """Codes that change how a terminal shows text."""

    RESET, BOLD, UNDERLINE, CLEAR_SCREEN = "\033[0m", "\033[1m", "\033[4m", "\033[2J"
    # fmt: off
    (
        BLACK_FOREGROUND, RED_FOREGROUND, GREEN_FOREGROUND, YELLOW_FOREGROUND, BLUE_FOREGROUND,
        MAGENTA_FOREGROUND, CYAN_FOREGROUND, WHITE_FOREGROUND,
    ) = (f"\033[{number}m" for number in range(30, 38))
    (
        BLACK_BACKGROUND, RED_BACKGROUND, GREEN_BACKGROUND, YELLOW_BACKGROUND, BLUE_BACKGROUND,
        MAGENTA_BACKGROUND, CYAN_BACKGROUND, WHITE_BACKGROUND,
    ) = (f"\033[{number}m" for number in range(40, 48))
    # fmt: on


_LATER_DEVICES = frozenset(["LinearMotor", "Microphone", "Radio", "RotationalMotor", "Skin", "VacuumGripper"])
"""Devices without a function such as `getGyro`, which releases before R2022 have."""
_DEVICE_CLASSES = DEVICES - _LATER_DEVICES | {"Motor"}


class Supervisor(Robot):
    """A robot that sees and changes the whole world."""

    SIMULATION_MODE_PAUSE, SIMULATION_MODE_REAL_TIME, SIMULATION_MODE_FAST = 0, 1, 2

    def __init__(self) -> None:
        super().__init__()
        robot = self._webots_robot
        if not robot.is_supervisor:
            print(
                f"Error: '{robot.name}' is not a supervisor; set its field supervisor TRUE", file=sys.stderr
            )

    def getRoot(self) -> Node:
        return Node(self._webots_simulation, self._webots_simulation.scene.root)

    def getSelf(self) -> Node:
        return Node(self._webots_simulation, self._webots_robot.written)

    def getFromDef(self, name: str) -> Node | None:
        """Return the node of a DEF name, or of a path of DEF names with dots between them."""
        match = self._webots_simulation.scene.root
        for def_name in name.split("."):
            # `walk` yields the node itself first, which is not a part of itself.
            inner = (node for node in walk([match]) if node is not match and not node.is_internal)
            named = next((node for node in inner if node.name == def_name), None)
            if named is None:
                return None
            match = named
        return Node(self._webots_simulation, match)

    def getFromId(self, id: int) -> Node | None:
        node = next(islice(walk(self._webots_simulation.scene.nodes), max(0, id - 1), None), None)
        return Node(self._webots_simulation, node) if node is not None and id > 0 else None

    def getFromDevice(self, device: Any) -> Node:
        return Node(self._webots_simulation, device._spec.node)

    def simulationReset(self) -> None:
        """Bring the world back to its start, at the end of the next step."""
        self._webots_simulation.reset_is_due = True

    def simulationResetPhysics(self) -> None:
        """Set all velocities to 0."""
        self._webots_simulation.physics.stop()

    def simulationQuit(self, status: int = 0) -> None:
        """End the simulation in the next step, with an exit code."""
        self._webots_simulation.quit_status = int(status)

    simulationGetMode = returns("SIMULATION_MODE_FAST")

    def setLabel(self, *_: Any) -> None:
        """Do nothing: there is no window."""

    simulationSetMode = setLabel


class Keyboard(Sampled):
    """The keyboard: the keys that a person holds on the page of `--view`."""

    END, HOME, LEFT, UP, RIGHT, DOWN = 312, 313, 314, 315, 316, 317
    PAGEUP, PAGEDOWN, NUMPAD_HOME = 366, 367, 375
    NUMPAD_LEFT, NUMPAD_UP, NUMPAD_RIGHT, NUMPAD_DOWN, NUMPAD_END = 376, 377, 378, 379, 382
    KEY, SHIFT, CONTROL, ALT = 0x0000FFFF, 0x00010000, 0x00020000, 0x00040000

    def __init__(self) -> None:
        self._simulation = _active()
        self._codes: list[int] = []

    def enable(self, samplingPeriod: int) -> None:
        """Read the keys once in each period, in ms; 0 disables."""
        self.disable()
        if samplingPeriod > 0:
            super().enable(samplingPeriod)
        if self._simulation.held_keys is None:
            self._simulation.warn_once(_NO_KEYS)

    def disable(self) -> None:
        self._codes = []
        super().disable()

    def sample(self) -> None:
        """Read the keys that are held now."""
        held = self._simulation.held_keys
        self._codes = [] if held is None else list(held())

    def getKey(self) -> int:
        """Return the code of the next key of those that were held at the last reading, -1 after the last."""
        return self._codes.pop(0) if self._codes else -1


_NO_KEYS = (
    "no key of the Keyboard is ever pressed: there is no window; with --view, you press keys on the page"
)
