"""The runtime of generated code.

supervisor.py   base of the generated supervisors, a Gymnasium environment; ends of episodes; Python terms
copies.py       copies of a robot in one world, each with a supervisor; the engine of a batch of such worlds
agents.py       several agents in one world or a batch: the seat of each, and the environment of one
parallel.py     several agents as an environment of PettingZoo, and its window
spaces.py       spaces, observations and actions of policies; rewards for other goals
formulas.py     functions that generated code calls: pure ones, and ones with memory
messages.py     channels of messages, and their formats
streams.py      named random streams under one root seed, draws of an episode, values in place of draws
placement.py    the poses of bodies at the beginning of an episode
paths.py        shortest paths around solid objects; painted lines: places beside and along them, light
overview.py     a camera that sees the whole scene
actuation.py    base of the generated robot controllers; actuators beyond a motor of the engine, and pushes
sensing.py      sensors that are sampled once per tick, with their faults
readers.py      the measurement of each kind of sensor
batch.py        base of the generated supervisor of a batch; the batch as a vector environment
batch_parts.py  the parts of a batch: calls, channels, controllers, sensors
columns.py      the functions of a batch

Nothing here reads YAML, or depends on an engine beyond the port.
"""

from deepbots_cli.frames import quaternion
from deepbots_cli.runtime.actuation import Cartesian, Motor, Push, RobotController, Thrust
from deepbots_cli.runtime.copies import make_environment
from deepbots_cli.runtime.formulas import (
    Accumulate,
    Delta,
    Duration,
    Hold,
    Integral,
    LowPass,
    Previous,
    RisingEdge,
    RunningMax,
    RunningMin,
    bearing,
    clamp,
    clip,
    distance,
    ground_distance,
    pitch,
    roll,
    scale,
    scale_each,
    scale_freely,
    tilt,
    to_body_frame,
    total,
    wrap_angle,
    yaw,
)
from deepbots_cli.runtime.paths import Follower, Ways
from deepbots_cli.runtime.placement import Arrangement
from deepbots_cli.runtime.supervisor import Supervisor, python_function
