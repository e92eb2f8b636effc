"""What generated code runs on.

supervisor.py  base of the generated supervisor, a Gymnasium environment
robot.py       base of the generated robot controllers
actuation/     actuators that are more than a motor of the engine, and pushes
placement.py   where bodies stand when an episode begins; ways.py shortest ways around solid objects
formulas.py    functions that generated code calls; memory.py those that remember
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
from deepbots_cli.runtime.channel import Channel
from deepbots_cli.runtime.foreign import foreign
from deepbots_cli.runtime.formulas import (
    bearing,
    clamp,
    clip,
    distance,
    ground_distance,
    local,
    pitch,
    roll,
    scale,
    scale_each,
    scale_freely,
    tilt,
    total,
    wrap_angle,
    yaw,
)
from deepbots_cli.runtime.lines import Follower
from deepbots_cli.runtime.load import load_module
from deepbots_cli.runtime.memory import (
    Accumulate,
    Delta,
    Duration,
    Hold,
    Integral,
    Previous,
    Rising,
    RunningMax,
    RunningMin,
    Smooth,
)
from deepbots_cli.runtime.placement import Arrangement
from deepbots_cli.runtime.radio import Radio
from deepbots_cli.runtime.robot import RobotController
from deepbots_cli.runtime.supervisor import Supervisor
from deepbots_cli.runtime.team import assemble
from deepbots_cli.runtime.ways import Ways

__all__ = [
    "Accumulate",
    "Arrangement",
    "Cartesian",
    "Channel",
    "Delta",
    "Duration",
    "Follower",
    "Hold",
    "Integral",
    "Motor",
    "Previous",
    "Push",
    "Radio",
    "Rising",
    "RobotController",
    "RunningMax",
    "RunningMin",
    "Smooth",
    "Supervisor",
    "Thrust",
    "Ways",
    "assemble",
    "bearing",
    "clamp",
    "clip",
    "distance",
    "foreign",
    "ground_distance",
    "load_module",
    "local",
    "pitch",
    "quaternion",
    "roll",
    "scale",
    "scale_each",
    "scale_freely",
    "tilt",
    "total",
    "wrap_angle",
    "yaw",
]
