"""The files of a checkpoint: the valid content of `state.json` and of the arrays, and how they are read.

A run may come from someone else, and libraries do not check the state that they are given. Therefore every
number has bounds here, and an array must have the dtype and the shape of the one that it replaces, which are
compared before the array is read. Nothing is unpickled.
"""

from __future__ import annotations

import math
import os
import struct
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import Annotated, Any, Literal, Self, TypeVar

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, Field, NonNegativeInt, model_validator

from deepbots_cli.compiler.inputs import RESOLVED_NAME
from deepbots_cli.errors import DeepbotsError, RunError
from deepbots_cli.learning.callbacks import MAX_CHECK_INTERVAL, CallbackState
from deepbots_cli.learning.runs.curriculum import CurriculumState
from deepbots_cli.learning.runs.directories import read_json
from deepbots_cli.learning.runs.episodes import StatisticsState
from deepbots_cli.learning.runs.records import MAX_STATE_BYTES
from deepbots_cli.learning.runs.run import Run

Array = npt.NDArray[Any]
Arrays = Mapping[str, Array]

# The state

_MAX_WORLDS = 1_024
_WORDS = 624
"""Numbers of 32 bits in the state of a Mersenne Twister, the generator of Python, of numpy's functions and of
torch."""

Text = Annotated[str, Field(max_length=2_000)]
Count = Annotated[int, Field(ge=0, lt=2**62)]
Bit = Annotated[int, Field(ge=0, le=1)]
Word = Annotated[int, Field(ge=0, lt=2**32)]
LongWord = Annotated[int, Field(ge=0, lt=2**128)]  # for PCG64, whose state and increment have 128 bits each
WordIndex = Annotated[int, Field(ge=0, le=_WORDS)]


class CheckpointPart(BaseModel, strict=True, extra="forbid", allow_inf_nan=False):
    """Base of the models of a checkpoint."""


class NumpyScalar(CheckpointPart):
    """A number with its type in numpy, because the mean of float32 differs from that of float64. None stands
    for NaN, which JSON does not have."""

    dtype: Literal[
        "bool",
        "int8",
        "int16",
        "int32",
        "int64",
        "uint8",
        "uint16",
        "uint32",
        "uint64",
        "float16",
        "float32",
        "float64",
    ]
    value: bool | int | float | None

    @model_validator(mode="after")
    def _has_its_type(self) -> Self:
        try:
            self.number()
        except (OverflowError, TypeError) as error:
            raise ValueError(str(error)) from error
        return self

    def number(self) -> Any:
        return np.array(self.value, dtype=self.dtype)[()]


Number = int | float | NumpyScalar
Pending = tuple[dict[Text, bool | Number | str | None], dict[Text, Count], dict[Text, list[Text]]]
"""The entries of the log that are recorded but not yet written: their values, their counts, and the outputs
that leave them out."""


class _GeneratorWords(CheckpointPart):
    state: LongWord
    inc: LongWord


class GeneratorState(CheckpointPart):
    """The state of a generator PCG64 of numpy, in the words of numpy."""

    bit_generator: Literal["PCG64"]
    state: _GeneratorWords
    has_uint32: Bit
    uinteger: Word


class StreamsState(CheckpointPart):
    """The random generators of a world (`Supervisor.random_state`), and of each copy of a robot in it."""

    root: Annotated[int, Field(ge=0, lt=2**64)]
    generators: Annotated[dict[Text, GeneratorState], Field(max_length=10_000)]
    agents: Annotated[list[StreamsState], Field(max_length=_MAX_WORLDS)] | None = None


class CheckpointState(CheckpointPart):
    """The part of a checkpoint that is JSON."""

    digest: Text
    """The digest of the scenario."""
    arithmetic: dict[Text, Text]
    statistics: StatisticsState
    curriculum: CurriculumState
    callback: CallbackState
    stages: Annotated[list[NonNegativeInt], Field(max_length=_MAX_WORLDS)]
    """The stage of the curriculum that each world is in."""
    starts: Annotated[
        list[Annotated[int, Field(ge=0, lt=2**64)] | GeneratorState | StreamsState],
        Field(max_length=_MAX_WORLDS),
    ]
    """The start of each world's running episode: its seed, or the states of its random generators."""
    observed: Text
    """The fingerprint of the last observations."""
    pending: Pending
    # Python's generator has 624 words, and behind them the index of the next one.
    python: tuple[
        Literal[3], Annotated[list[Word], Field(min_length=_WORDS + 1, max_length=_WORDS + 1)], float | None
    ]
    numpy: tuple[WordIndex, Bit, float]
    logs: dict[Text, Count]
    """Bytes of each log."""
    inexact: Annotated[list[Text], Field(max_length=1_000)]

    @property
    def steps(self) -> int:
        return self.statistics.steps

    @model_validator(mode="after")
    def _agrees_with_itself(self) -> Self:
        steps, statistics = self.steps, self.statistics
        step_counts = [
            self.callback.evaluated_at,
            self.callback.next_beat - MAX_CHECK_INTERVAL,
            self.curriculum.first_step,
        ]
        step_counts += [
            statistics.episodes,
            *(stage.steps for stage in self.curriculum.ends),
            *([statistics.solved_at.steps] if statistics.solved_at else []),
        ]
        if max(step_counts) > steps:
            raise ValueError("its counts of steps contradict each other")
        if len(self.stages) != len(self.starts):
            raise ValueError("its counts of worlds contradict each other")
        return self


S = TypeVar("S", bound=CheckpointState)


def latest_checkpoint(run: Run) -> Path | None:
    """Return the last checkpoint of a run, if there is one."""
    # isdecimal alone also accepts the digits of other scripts.
    folders = run.checkpoints.iterdir() if run.checkpoints.is_dir() else ()
    return max(
        (path for path in folders if len(path.name) == 12 and path.name.isdecimal() and path.name.isascii()),
        default=None,
    )


def read_state(folder: Path, model: type[S]) -> S:
    """Read the state of a checkpoint.

    Raises:
        RunError: The checkpoint is damaged.
    """
    state = read_json(folder / "state.json", model, MAX_STATE_BYTES)
    if state.steps != int(folder.name):
        raise RunError(
            f"{folder} is damaged: its state was saved after {state.steps:,} steps, which its name"
            " contradicts"
        )
    return state


@contextmanager
def damage_explained(run: Run, folder: Path | None) -> Iterator[None]:
    """Context in which any error of a damaged checkpoint becomes one sentence, with what to do instead."""
    try:
        yield
    except (
        ArithmeticError,
        AttributeError,
        DeepbotsError,
        LookupError,
        MemoryError,
        RuntimeError,
        TypeError,
        ValueError,
    ) as error:
        explained = error
        if not isinstance(error, RunError):
            reason = " ".join(str(error).split())[:200]
            explained = RunError(
                f"{folder} is damaged, or belongs to another training ({type(error).__name__}: {reason})"
            )
        path = quote(str(run.path))
        explained.add_note(
            "the run has no earlier checkpoint; its policies can still be evaluated: deepbots eval " + path
        )
        scenario = quote(str(run.path / RESOLVED_NAME))
        explained.add_note(
            f"to start a new run with the weights of the best policy: deepbots train {scenario}"
            f" --initialize-from {path}"
        )
        raise explained from error


# The arrays

_OVERHEAD_BYTES = 1_000_000


@dataclass(frozen=True)
class ArraySpec:
    """The shape and type that an array of a checkpoint must have. With `max_rows` it may have fewer rows, of
    any numeric type of up to 8 bytes."""

    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    max_rows: int | None = None
    is_optional: bool = False

    @classmethod
    def like(cls, array: Array) -> Self:
        return cls(array.dtype, array.shape)

    @property
    def max_bytes(self) -> int:
        return (
            math.prod(self.shape) * self.dtype.itemsize
            if self.max_rows is None
            else math.prod((self.max_rows, *self.shape)) * 8
        )

    def accepts(self, shape: tuple[int, ...], dtype: np.dtype[Any]) -> bool:
        if self.max_rows is None:
            return shape == self.shape and dtype == self.dtype
        # `np.array` of an episode without actions has no further axes.
        is_empty = shape == (0,)
        return (
            dtype.kind in "biuf"
            and dtype.itemsize <= 8
            and (is_empty or (shape[0:1] <= (self.max_rows,) and shape[1:] == self.shape))
        )


def write_arrays(path: Path, arrays: Arrays, data: str = "") -> None:
    """Write an uncompressed `.npz`, with a member `data` if there is such a text."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        if data:
            archive.writestr("data", data)
        for name, array in arrays.items():
            # zipfile does not know the size beforehand, and a replay buffer may exceed 2 GiB.
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                # write_array keeps Fortran order, which `_read_array` refuses.
                np.lib.format.write_array(
                    member, np.asarray(array, order="C"), version=(1, 0), allow_pickle=False
                )


def read_arrays(path: Path, specs: Mapping[str, ArraySpec], ignored: Sequence[str] = ()) -> dict[str, Array]:
    """Read the arrays of an uncompressed `.npz`. They match `specs`, and all numbers are finite. Members in
    `ignored` are not read.

    Raises:
        RunError: The file is missing, damaged, or has other content.
    """
    if not path.is_file():
        raise RunError(f"{path} is missing")
    try:
        if path.stat().st_size > _OVERHEAD_BYTES + sum(spec.max_bytes + 1_000 for spec in specs.values()):
            raise ValueError("it is larger than what it should hold")
        with zipfile.ZipFile(path) as archive:
            members = [member for member in archive.infolist() if member.filename not in ignored]
            # Compressed members, and members that share bytes, could expand to any size.
            if sum(member.file_size for member in members) > path.stat().st_size or any(
                m.compress_type for m in members
            ):
                raise ValueError("it is compressed")
            names = [member.filename.removesuffix(".npy") for member in members]
            arrays = {
                name: _read_array(archive, member, specs.get(name))
                for name, member in zip(names, members, strict=True)
            }
        missing = [name for name, spec in specs.items() if name not in arrays and not spec.is_optional]
        if missing:
            raise ValueError(f"'{missing[0]}' is missing")
    except Exception as error:  # numpy parses headers as Python, and raises a dozen kinds of exceptions
        reason = str(error).splitlines()[0][:120] if str(error) else "cut short"
        raise RunError(f"{path} is damaged ({reason})") from error
    return arrays


def _read_array(archive: zipfile.ZipFile, member: zipfile.ZipInfo, spec: ArraySpec | None) -> Array:
    name = repr(member.filename[:80])
    with archive.open(member) as stream:
        if np.lib.format.read_magic(stream) != (1, 0):
            raise ValueError(f"{name} is of an unknown version")
        shape, fortran, dtype = np.lib.format.read_array_header_1_0(stream)
        if spec is None or fortran or not spec.accepts(shape, dtype):
            raise ValueError(f"{name} is {dtype.str[:20]} of shape {str(shape)[:60]}, which does not fit")
        size = math.prod(shape) * dtype.itemsize
        # One byte more, so that a member longer than its header says is noticed.
        content = stream.read(size + 1)
    if len(content) != size:
        raise ValueError(f"{name} does not match its header")
    # An array over bytes cannot be written to.
    array = np.frombuffer(content, dtype).reshape(shape).copy()
    if dtype.kind == "f" and not np.isfinite(array).all():
        raise ValueError(f"{name} contains infinite or NaN values")
    return array


def check_torch_generator(state: Array) -> None:
    """Refuse a state that leads torch's generator beyond its own numbers.

    torch itself compares `left`, the count of unused numbers, and `following`, the index of the next one,
    with 624 each.
    """
    # Behind the initial seed (8 bytes): the fields `left`, `seeded` (skipped) and `next`.
    left, following = struct.unpack_from("<i4xQ", state.tobytes(), 8)
    if left + following not in (1, _WORDS + 1):  # 1 after a seed
        raise ValueError("the state of the generator of torch is impossible")


def flush_to_disk(path: Path) -> None:
    """Have the system write a file or folder to the disk, for a power cut."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def check_actions(actions: Array, space: Any) -> None:
    """Refuse a choice that the agent does not have, on which an update would fail."""
    if hasattr(space, "n") and not ((actions >= space.start) & (actions < space.start + space.n)).all():
        raise ValueError("it contains actions that the scenario does not have")
