"""What generated code runs on.

supervisor.py  base of the generated supervisor, a Gymnasium environment
robot.py       base of the generated robot controllers
actuation/     actuators that are more than a motor of the engine, and pushes
placement.py   where bodies stand when an episode begins; ways.py shortest ways around solid objects
channel.py     the path of messages, radio.py one that is not perfect; messages.py their formats
sensing/       sensors that are sampled once per tick, with their faults
lines.py       painted lines: places beside and along them, light
team.py        copies of a robot in one world, share.py what each sees of the engine
streams.py     named random streams under one root seed; episode_options.py values that `reset` is given in place of draws
album.py       the last pictures
foreign.py     terms in Python
hindsight.py   rewards for other goals, for hindsight replay
spaces.py      action and observation spaces; actions.py actions in their forms; view.py a camera that sees the whole scene
load.py        generated text to a module whose tracebacks show its lines

Nothing here reads YAML or knows an engine beyond the port.
"""

from deepbots_cli.frames import quaternion
from deepbots_cli.runtime.actuation import Cartesian, Motor, Push, Thrust
from deepbots_cli.runtime.foreign import foreign
from deepbots_cli.runtime.lines import Follower
from deepbots_cli.runtime.load import load_module
from deepbots_cli.runtime.messages import MALFORMED
from deepbots_cli.runtime.placement import Arrangement
from deepbots_cli.runtime.robot import RobotController
from deepbots_cli.runtime.supervisor import Supervisor, clipped, unbounded
from deepbots_cli.runtime.team import assemble
from deepbots_cli.runtime.ways import Ways

__all__ = [
    "MALFORMED",
    "Arrangement",
    "Cartesian",
    "Follower",
    "Motor",
    "Push",
    "RobotController",
    "Supervisor",
    "Thrust",
    "Ways",
    "assemble",
    "clipped",
    "foreign",
    "load_module",
    "quaternion",
    "unbounded",
]
