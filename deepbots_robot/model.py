"""The content of `bundle.json`: the fields of a policy, in SI units, in order.

`python -m deepbots_robot.model` writes the JSON Schema, `schemas/bundle-1.schema.json`, from these records.
"""

from __future__ import annotations

import inspect
import json
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import msgspec
from msgspec import Meta

from deepbots_robot import topics

FORMAT: Final = 1

MAX_FIELDS = 4096
MAX_NUMBERS = 4_000_000
"""Numbers in all inputs, memories and commands together: an image of 1024 x 1280 pixels in three colors."""
MAX_FILES = 4096
_MAX_PARTS, _MAX_PART = 20, 255
"""Folders of a path, and the bytes of a name that a file system takes."""


class BundleError(Exception):
    """The error for a bundle that cannot be used. The message names the file and its fault, in one
    sentence."""


class InputError(ValueError):
    """The error for values of `Policy.step` that do not fit the inputs of the bundle. The memory of the
    policy has not changed."""


# Values that occur in several records. A terminal obeys control characters, and Unicode has some that turn
# the order of a line around. In Python `$` is also the place before a line end.

_HIDDEN = r"\x7f-\x9f\u2028-\u202e\u2066-\u2069"
Name = Annotated[str, Meta(min_length=1, max_length=200, pattern=rf"^[^\x00-\x1f{_HIDDEN}]+$(?!\n)")]
LINE = rf"^[^\x00-\x1f{_HIDDEN}]*$(?!\n)"
Line = Annotated[str, Meta(max_length=2000, pattern=LINE)]
Text = Annotated[str, Meta(max_length=100_000, pattern=rf"^[^\x00-\x08\x0b-\x1f{_HIDDEN}]*$")]
Digest = Annotated[str, Meta(pattern=r"^[0-9a-f]{64}$(?!\n)", description="SHA-256 in hexadecimal.")]
Finite = Annotated[float, Meta(ge=-1e300, le=1e300)]
Positive = Annotated[float, Meta(gt=0, le=1e12)]
NotNegative = Annotated[float, Meta(ge=0, le=1e12)]
Shape = Annotated[tuple[Annotated[int, Meta(ge=1, le=MAX_NUMBERS)], ...], Meta(min_length=1, max_length=4)]
Names = Annotated[tuple[Name, ...], Meta(max_length=MAX_FIELDS)]
Numbers = Annotated[tuple[Finite, ...], Meta(max_length=MAX_FIELDS)]
Limits = Annotated[tuple[NotNegative | None, ...], Meta(max_length=MAX_FIELDS)]
Rate = Annotated[float, Meta(ge=0.01, le=10_000)]
Seconds = Annotated[float, Meta(ge=0, le=1e6)]
FileName = Annotated[str, Meta(min_length=1, max_length=500, pattern=rf"^[^\x00-\x1f{_HIDDEN}\\:]+$(?!\n)")]
Bounds = Annotated[tuple[Finite | None, ...], Meta(max_length=MAX_FIELDS)]
Triple = tuple[Finite, Finite, Finite]
DType = Literal["float64", "float32", "int64", "bool", "uint8"]


class Record(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A record without unknown keys."""


class Mount(Record, frozen=True):
    """The pose of a sensor in the frame of its link."""

    xyz: Triple
    rpy: Triple


class Input(Record, frozen=True):
    """A value that the policy reads in each step, as the sensor gives it.

    Attributes:
        name: The name of the tensor: `cart.pole_angle` for a sensor, `position(ball)` for a reading of the
            world, `target` for a goal.
        robot: The robot that has the sensor; null for others.
        source: `sensor`: the robot measures it. `supervisor`: a tracker or an estimator must supply it.
            `goal`: the operator sets it.
        supplied_by: What supplies a reading of the world, as the scenario says under `deploy`; null if it
            does not say.
        sensor: The kind of the sensor, such as `gyro`; the function of the language for a reading of the
            world; null for a goal. `age` is the time in s since the newest values of a robot or a sensor were
            measured.
        joints: The joints of a joint sensor, one for each component.
        link: The link on which the sensor is mounted.
        mount: The pose of the sensor in the frame of the link; null for the frame of the link itself.
        shape: `[n]`, or rows, columns and channels of an image.
        components: The names of the components in order; none for a single value and for an image.
        unit: The SI unit; empty for a plain number, a truth value and an image.
        frame: The frame of a vector: `world`, or the name of the link; null for others.
        range: The smallest and the largest value of each component, null where unknown; null for an image and
            a truth value.
        rate_hz: How often the training got a new value.
        latency_s: The time from the measurement to the delivery in the training.
        max_age_s: The age from which a value is too old to act on; null for a goal, which holds until it is
            changed.
    """

    name: Name
    robot: Name | None
    source: Literal["sensor", "supervisor", "goal"]
    supplied_by: Line | None
    sensor: Name | None
    joints: Names
    link: Name | None
    mount: Mount | None
    shape: Shape
    dtype: DType
    components: Names
    unit: Line
    frame: Name | None
    range: tuple[Bounds, Bounds] | None
    rate_hz: Annotated[float, Meta(ge=1e-6, le=1e6)]
    latency_s: Seconds
    max_age_s: Annotated[float, Meta(gt=0, le=1e6)] | None


class Memory(Record, frozen=True):
    """A tensor that the policy passes to itself: input `name`, output `name` with `_next`.

    Attributes:
        initial: The value at the start of an episode: one number for all, or one for each in C order.
    """

    name: Name
    shape: Shape
    dtype: DType
    initial: Numbers


class Output(Record, frozen=True):
    """The command of one actuator.

    Attributes:
        kind: What the command sets in each joint: `velocity`, `position` or `effort`. `thrust` of links along
            their z axes. `cartesian`: the position of the origin of a link, for which the robot computes the
            joints. Else the kind of a package.
        joints: The joints that the actuator drives; for `velocity`, `position` and `effort` one for each
            component.
        links: The links that the actuator pushes or moves.
        shape: `[n]`.
        range: The smallest and the largest command of each component; null where there is no limit. The graph
            clips to it.
        max_rate: The fastest change of the command of each component, in its unit per s; null where there is
            no limit.
        max_effort: The largest torque or force in each joint (N m or N); null where there is no limit.
        stiffness: Of a position controller, in N m/rad or N/m; null for that of the robot.
        damping: Of a position controller, in N m s/rad or N s/m; null for that of the robot.
        attitude: Roll, pitch and yaw (rad) that a `cartesian` command keeps; null for any.
        safe: The command of each component when the policy must not act; null: the last command is held.
    """

    name: Name
    robot: Name
    actuator: Name
    kind: Name
    joints: Names
    links: Names
    shape: Shape
    dtype: Literal["float64"]
    components: Names
    unit: Line
    frame: Name | None
    range: tuple[Bounds, Bounds]
    max_rate: Limits
    max_effort: Limits
    stiffness: NotNegative | None
    damping: NotNegative | None
    attitude: Triple | None
    safe: Bounds


class ActionPart(Record, frozen=True):
    """A part of the output `action`: a choice, with what each option sets, or a number of which -1 and 1 mean
    a range."""

    name: Name
    unit: Line = ""
    low: Finite | None = None
    high: Finite | None = None
    options: dict[Name, dict[Name, Finite]] = {}


class RobotFile(Record, frozen=True):
    """The robot file of a robot, by its name in the run."""

    file: Name
    digest: Digest


class Scenario(Record, frozen=True):
    """The scenario that the policy was trained in.

    Attributes:
        digest: Of the compiled scenario; `task_digest` leaves out names, training and evaluation.
        interface: What policy and scenario agree on, by agent and item; `deepbots export --check` compares
            it.
        licenses: SPDX identifiers in the files of the scenario, by file.
    """

    name: Name
    summary: Text
    digest: Digest
    task_digest: Digest
    robots: dict[Name, RobotFile]
    interface: dict[Name, dict[Name, Text]]
    licenses: dict[Name, Text]


class Training(Record, frozen=True):
    """How the policy was trained; `model` is the name of its file in the run, such as `best`; `versions` are
    those of packages."""

    algorithm: Line
    model: Name
    seed: int
    steps: int | None
    engine: Line
    versions: dict[Name, Line]


class Evaluation(Record, frozen=True):
    """The result on held-out episodes, with 95 % intervals; `text` says the same in a sentence."""

    text: Line
    episodes: int
    seed: int
    mean_return: Finite
    return_interval: tuple[Finite, Finite] | None
    success_rate: Finite | None
    success_interval: tuple[Finite, Finite] | None
    solved: bool | None


class RosTopic(Record, frozen=True):
    """The ROS 2 topic of an input or an output; `part` is the part of its messages, null for the one that
    fits."""

    topic: Annotated[
        str, Meta(max_length=128, pattern=r"^/[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)*$(?!\n)")
    ]
    type: Name
    part: Name | None


class BundleInfo(Record, frozen=True):
    """The content of `bundle.json`.

    Attributes:
        rate_hz: Steps of the policy per second; another rate needs another training.
        action: The parts of the output `action`, which is the action in the form that the environment takes.
        files: The SHA-256 of all other files, by their path in the bundle; what is not named here is not
            read.
        evaluation: Null for a run that was not evaluated.
        ros: The ROS 2 topics of inputs and outputs, by name; others have those of
            `deepbots_robot.topics.first_mapping`.
    """

    format: Literal[1]
    deepbots: Name
    scenario: Scenario
    training: Training
    rate_hz: Rate
    timestep_s: Annotated[float, Meta(ge=1e-4, le=100)]
    inputs: Annotated[tuple[Input, ...], Meta(max_length=MAX_FIELDS)]
    memory: Annotated[tuple[Memory, ...], Meta(max_length=MAX_FIELDS)]
    outputs: Annotated[tuple[Output, ...], Meta(min_length=1, max_length=MAX_FIELDS)]
    action: Annotated[tuple[ActionPart, ...], Meta(min_length=1, max_length=MAX_FIELDS)]
    files: Annotated[dict[FileName, Digest], Meta(max_length=MAX_FILES)]
    evaluation: Evaluation | None
    ros: Annotated[dict[Name, RosTopic], Meta(max_length=2 * MAX_FIELDS)] = {}

    @property
    def action_shape(self) -> tuple[int, ...]:
        """The shape of the output `action`."""
        if self.choices:
            return () if len(self.choices) == 1 else (len(self.choices),)
        return (len(self.action),)

    @property
    def choices(self) -> tuple[int, ...]:
        """The number of options of each choice, in order."""
        return tuple(len(part.options) for part in self.action if part.options)


_LIMITS = {"float32": (-3.4e38, 3.4e38), "int64": (-(2.0**53), 2.0**53), "bool": (0, 1), "uint8": (0, 255)}
"""The smallest and the largest number of a type."""


class _Format(msgspec.Struct):
    format: int


def encode(info: BundleInfo) -> bytes:
    """Return the content of `bundle.json`."""
    return msgspec.json.format(msgspec.json.encode(info), indent=2) + b"\n"


def decode(content: bytes) -> BundleInfo:
    """Return the records of `bundle.json`, whose parts are checked against each other.

    Raises:
        BundleError: The text is not JSON, has another format, an unknown or a missing key, or values that
            contradict each other.
    """
    try:
        version = msgspec.json.decode(content, type=_Format).format
        if version != FORMAT:
            raise BundleError(
                f"bundle.json has format {version}, but this version of deepbots_robot reads format {FORMAT}"
            )
        info = msgspec.json.decode(content, type=BundleInfo)
    except (
        msgspec.DecodeError,
        RecursionError,
        UnicodeDecodeError,
    ) as error:
        # A ValidationError is a DecodeError.
        raise BundleError(f"bundle.json is damaged: {' '.join(str(error).split())[:200]}") from error
    problem = next(_problems(info), None)
    if problem is not None:
        raise BundleError(f"bundle.json contradicts itself: {problem}")
    return info


def plain(info: BundleInfo) -> Mapping[str, Any]:
    """Return the content as `json` reads it."""
    plain_data: Mapping[str, Any] = json.loads(msgspec.json.encode(info))
    return plain_data


def printable(text: str) -> str:
    """Return a text of another program with `?` for each character that a terminal obeys."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def size_of(shape: tuple[int, ...]) -> int:
    """Return the number of values in a tensor."""
    size = 1
    for side in shape:
        size *= side
    return size


def _problems(info: BundleInfo) -> Iterator[str]:
    """Yield faults that a schema cannot express: names are unique, and lists have the length of their
    tensor."""
    if abs(info.rate_hz * info.timestep_s - 1.0) > 1e-6:
        yield f"rate_hz {info.rate_hz:g} is not 1 / timestep_s {info.timestep_s:g}"
    read = [*(entry.name for entry in info.inputs), *(entry.name for entry in info.memory)]
    produced = [
        *(entry.name for entry in info.outputs),
        *(f"{entry.name}_next" for entry in info.memory),
        "action",
        "scores",
    ]
    twice = [name for name, count in Counter([*read, *produced]).items() if count > 1]
    if twice:
        yield f"two tensors have the name '{twice[0]}'"
    tensors: tuple[Input | Memory | Output, ...] = (*info.inputs, *info.memory, *info.outputs)
    if sum(size_of(tensor.shape) for tensor in tensors) > MAX_NUMBERS:
        yield f"its inputs, memories and commands have more than {MAX_NUMBERS} numbers together"
    yield from (f"'{path}' is not a path in a bundle" for path in info.files if not _is_path(path))
    for memory in info.memory:
        yield from _wrong_memory(memory)
    for entry in info.inputs:
        yield from _wrong_input(entry)
    for output in info.outputs:
        yield from _wrong_output(output)
    if any(
        not part.options and (part.low is None or part.high is None or part.low >= part.high)
        for part in info.action
    ):
        yield "a part of the action has neither options nor a range"
    yield from _wrong_topics(info)


def _is_path(path: str) -> bool:
    parts = path.split("/")
    return len(parts) <= _MAX_PARTS and all(
        part not in ("", ".", "..") and len(part.encode()) <= _MAX_PART for part in parts
    )


def _wrong_memory(memory: Memory) -> Iterator[str]:
    if len(memory.initial) not in (1, size_of(memory.shape)):
        yield (
            f"'{memory.name}' has {len(memory.initial)} initial numbers and {size_of(memory.shape)} in its"
            " shape"
        )
    low, high = _LIMITS.get(memory.dtype, (-1e300, 1e300))
    is_whole = memory.dtype not in ("float64", "float32")
    if not all(
        low <= number <= high and (not is_whole or number == int(number)) for number in memory.initial
    ):
        yield f"'{memory.name}' has an initial number that is not of type {memory.dtype}"


def _wrong_input(entry: Input) -> Iterator[str]:
    is_picture = len(entry.shape) == 3
    if (
        len(entry.shape) not in (1, 3)
        or is_picture != (entry.dtype == "uint8")
        or (is_picture and entry.range is not None)
    ):
        yield f"'{entry.name}' is neither a row of numbers nor a picture of bytes without a range"
    yield from _wrong_lengths(entry, {"components": entry.components, "joints": entry.joints})
    yield from _wrong_range(entry)
    yield from _twice(entry.name, {"joint": entry.joints})


def _wrong_topics(info: BundleInfo) -> Iterator[str]:
    """Yield topics of fields that do not exist, and types that no message has."""
    fields: tuple[Input | Output, ...] = (*info.inputs, *info.outputs)
    names = {field.name for field in fields}
    for name, topic in info.ros.items():
        if name not in names:
            yield f"'{name}' has a topic, and is neither an input nor an output"
        if topic.type not in topics.PARTS:
            yield f"the topic of '{name}' has the unknown type '{topic.type}'"


def _wrong_output(output: Output) -> Iterator[str]:
    if len(output.shape) != 1:
        yield f"the command '{output.name}' has the shape {list(output.shape)}"
    size = output.shape[0]
    for key, limits in {"max_rate": output.max_rate, "safe": output.safe}.items():
        if len(limits) != size:
            yield f"'{output.name}' has {len(limits)} {key} and the shape {list(output.shape)}"
    if output.kind in ("velocity", "position", "effort") and len(output.joints) != size:
        yield f"'{output.name}' has {len(output.joints)} joints and the shape {list(output.shape)}"
    if output.max_effort and len(output.max_effort) not in (size, len(output.joints)):
        yield f"'{output.name}' has {len(output.max_effort)} max_effort and the shape {list(output.shape)}"
    yield from _twice(output.name, {"joint": output.joints, "link": output.links})
    yield from _wrong_lengths(output, {"components": output.components})
    yield from _wrong_range(output)
    ends = zip(output.safe, *output.range, strict=False)
    if any(
        safe is not None and ((low is not None and safe < low) or (high is not None and safe > high))
        for safe, low, high in ends
    ):
        yield f"the safe command of '{output.name}' is outside of its range"


def _twice(name: str, lists: Mapping[str, tuple[str, ...]]) -> Iterator[str]:
    for what, names in lists.items():
        if len(set(names)) != len(names):
            yield f"'{name}' has a {what} twice"


def _wrong_lengths(field: Input | Output, lists: Mapping[str, tuple[Any, ...]]) -> Iterator[str]:
    for key, values in lists.items():
        if values and len(values) != field.shape[0]:
            yield f"'{field.name}' has {len(values)} {key} and the shape {list(field.shape)}"


def _wrong_range(field: Input | Output) -> Iterator[str]:
    if field.range is None:
        return
    if any(len(ends) != field.shape[0] for ends in field.range):
        yield f"'{field.name}' has a range of another length than its shape {list(field.shape)}"
    if any(
        low is not None and high is not None and low > high for low, high in zip(*field.range, strict=False)
    ):
        yield f"'{field.name}' has a range whose low end is above the high one"


# The JSON Schema


PATH = Path("schemas") / f"bundle-{FORMAT}.schema.json"
_URL = "https://json-schema.org/draft/2020-12/schema"


def json_schema() -> str:
    """Return the schema of the records in `model.py`."""
    about = {"$schema": _URL, "title": f"Bundle of an exported policy (bundle.json), format {FORMAT}"}
    schema = msgspec.json.schema(BundleInfo)
    for record in schema["$defs"].values():  # before 0.23, msgspec leaves docstrings indented
        if "description" in record:
            record["description"] = inspect.cleandoc(record["description"])
    return json.dumps(about | schema, indent=1) + "\n"


if __name__ == "__main__":
    PATH.write_text(json_schema(), encoding="utf-8")
