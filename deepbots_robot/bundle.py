"""Loading a bundle with all checks, and the policy in it as an object to call.

The checks refuse a bundle that is damaged, put together from several exports, or made to read files, to run
without an end, or to command more than its own ranges. An attacker who can write weights can also write
digests. Only a signature proves who exported the bundle.
"""

from __future__ import annotations

import hashlib
import io
import os
import stat
import warnings
import zipfile
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, BinaryIO

import msgspec
import numpy as np
import onnxruntime
from numpy.typing import NDArray

from deepbots_robot import model, onnx_file, signature
from deepbots_robot.model import BundleError, BundleInfo, InputError

BUNDLE_NAME, GRAPH_NAME, PARITY_NAME = "bundle.json", "policy.onnx", "parity.npz"
SCENARIO_NAME, README_NAME, SIGNATURE_NAME = "scenario.yaml", "README.md", "bundle.sig"
_REQUIRED = (GRAPH_NAME, PARITY_NAME, SCENARIO_NAME, README_NAME)
METADATA_KEY = "deepbots.bundle"
"""The key of the metadata of the graph with the digest of the bundle.json that belongs to it."""
TOLERANCE = 1e-5
"""The largest difference of a command, in shares of its range, and of two scores that count as equal."""
_MAX_JSON_BYTES = 4_000_000
_MAX_SIGNATURE_BYTES = 10_000
_MAX_GRAPH_BYTES = 100_000_000
_MAX_PARITY_BYTES = 100_000_000
"""The largest size of the recorded steps, packed and unpacked."""
_MAX_PARITY_OPERATIONS = 3_000_000_000
"""The largest number of operations of all recorded steps together, which take at most 1.2 s."""
_BYTE_OPERATIONS = 8
"""The cost of the digest of a byte in operations of the graph: 2.6 ns."""
_STEP_OPERATIONS, _FIELD_OPERATIONS = 100_000, 20_000
"""The cost of Python in a step, and for each input, memory and command in it, in operations of the graph."""
_MAX_BYTES = 500_000_000
"""The largest size of all files of a bundle together."""
_CHUNK_BYTES = 1 << 20
_MAX_DESCRIPTION_BYTES = 1 << 26
_MAX_RATIO = 10_000
_MAX_HEADER_BYTES = 20_000
"""The largest size of the header of an array; numpy reads 10,000."""
_ENTRY_OF_ARCHIVE = b"PK\x01\x02"
"""The bytes with which an entry of the directory of a zip file begins."""

Array = NDArray[Any]
_NUMPY_TYPES = {
    "float64": np.float64,
    "float32": np.float32,
    "int64": np.int64,
    "bool": np.bool_,
    "uint8": np.uint8,
}
_ONNX_TYPES = {
    "float64": "tensor(double)",
    "float32": "tensor(float)",
    "int64": "tensor(int64)",
    "bool": "tensor(bool)",
    "uint8": "tensor(uint8)",
}


def load(folder: str | Path, *, trusted: str | Path | Sequence[str] | None = None) -> Bundle:
    """Load a bundle of `deepbots export`.

    Checks the schema of bundle.json, the digests of all files, the operators, shapes, inputs and outputs of
    the graph, and that the graph belongs to this bundle.json; then repeats the recorded steps.

    Args:
        folder: The folder of the bundle.
        trusted: Public keys, or a file with one key per line: the bundle must be signed with one of them.
            Without them, a signature is not checked.

    Raises:
        BundleError: A check fails; the message names the file and, for a step that differs, the number of the
            step and the field.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise BundleError(f"{folder} is not a bundle of `deepbots export`: there is no such folder")
    if not os.path.lexists(folder / BUNDLE_NAME):
        raise BundleError(f"{folder} is not a bundle of `deepbots export`: it contains no {BUNDLE_NAME}")
    keys = None if trusted is None else signature.keys_of(trusted)
    try:
        description = _read(folder, BUNDLE_NAME, _MAX_JSON_BYTES)
        if keys is not None:
            signature.verify(description, _read(folder, SIGNATURE_NAME, _MAX_SIGNATURE_BYTES), keys)
        info = model.decode(description)
        missing = next((name for name in _REQUIRED if name not in info.files), None)
        if missing is not None:
            raise BundleError(f"{BUNDLE_NAME} has no digest of {missing}")
        size = _checked_size(folder, info)
        for name in info.files.keys() - {GRAPH_NAME, PARITY_NAME}:
            _check_digest(folder, info, name)
        if model.encode(info) != description:  # a key occurs twice, which other readers may read differently
            raise BundleError(f"{BUNDLE_NAME} is not written as an export writes it")
        bundle = Bundle(info, _exported(folder, info, GRAPH_NAME, _MAX_GRAPH_BYTES), folder)
        replay(
            bundle,
            read_parity(_exported(folder, info, PARITY_NAME, _MAX_PARITY_BYTES), info),
            _BYTE_OPERATIONS * size,
        )
    except (
        BundleError,
        OSError,
    ) as error:
        # An OSError means a name that the file system does not accept, or a folder without rights.
        raise BundleError(
            f"{folder}: {_one_line(error, 1000)}; export the run again{' with --sign KEY' if keys else ''}"
        ) from error
    return bundle


def description_digest(info: BundleInfo) -> str:
    """Return the digest of everything in a bundle.json except for the digests of the files."""
    return hashlib.sha256(msgspec.json.encode(msgspec.structs.replace(info, files={}))).hexdigest()


def _checked_size(folder: Path, info: BundleInfo) -> int:
    """Return the size of all files together, in bytes.

    Raises:
        BundleError: The files are too large.
    """
    sizes = 0
    for name in info.files:
        sizes += _regular_file(folder, name).stat().st_size
    if sizes > _MAX_BYTES:
        raise BundleError(f"its files have more than {_MAX_BYTES} bytes together")
    return sizes


def _check_digest(folder: Path, info: BundleInfo, name: str) -> None:
    """Compare a file that is not needed here with its digest.

    Raises:
        BundleError: The file is missing, or has another digest.
    """
    digest, left = hashlib.sha256(), _MAX_BYTES
    with _opened(folder, name) as file:
        while left > 0 and (content := file.read(_CHUNK_BYTES)):
            digest.update(content)
            left -= len(content)
    if digest.hexdigest() != info.files[name]:
        raise BundleError(f"{name} is not the file that was exported")


def _exported(folder: Path, info: BundleInfo, name: str, most: int) -> bytes:
    """Read the content of a file.

    Raises:
        BundleError: The file is missing, too large, or does not match the digest in `info`.
    """
    content = _read(folder, name, most)
    if hashlib.sha256(content).hexdigest() != info.files.get(name):
        raise BundleError(f"{name} is not the file that was exported")
    return content


def _opened(folder: Path, name: str) -> BinaryIO:
    """Open a file in a folder. A link or a pipe that replaces it after the checks is neither followed nor
    waited for."""
    flags = (
        os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    )
    file = os.fdopen(os.open(_regular_file(folder, name), flags), "rb")
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise BundleError(f"{name} is not a regular file")
    return file


def _regular_file(folder: Path, name: str) -> Path:
    """Return the path of a file in a folder.

    Raises:
        BundleError: The file is missing, or reached through a link.
    """
    path = folder
    for part in PurePosixPath(name).parts:
        path = path / part
        if path.is_symlink():
            raise BundleError(f"{name} is reached through a symbolic link")
    if not path.is_file():
        raise BundleError(f"{name} is {'not a regular file' if os.path.lexists(path) else 'missing'}")
    return path


def _read(folder: Path, name: str, most: int) -> bytes:
    try:
        with _opened(folder, name) as file:
            content = file.read(most + 1)
    except OSError as error:
        raise BundleError(f"{name} cannot be read: {error.strerror}") from error
    if len(content) > most:
        raise BundleError(f"{name} is larger than {most} bytes")
    return content


class Bundle:
    """A policy with the description of its inputs and outputs.

    Attributes:
        info: The content of bundle.json.
        folder: The folder from which the policy was read; None if it was not read from one.
        operations: An upper limit of the operations of a step.
    """

    def __init__(self, info: BundleInfo, graph: bytes, folder: Path | None = None) -> None:
        """Create the session of a graph that fits `info`.

        Raises:
            BundleError: The graph cannot be run, or its inputs, outputs or metadata differ from `info`.
        """
        self.operations = onnx_file.require_plain(graph)
        self.info, self.folder = info, folder
        options = onnxruntime.SessionOptions()
        # By default, another shape only gives a warning.
        options.add_session_config_entry("session.strict_shape_type_inference", "1")
        # A small network is slower on several threads.
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        # Else a model whose bytes 4 to 7 are "ORTM" is read as the format of onnxruntime, in which these
        # checks see another graph.
        options.add_session_config_entry("session.load_model_format", "ONNX")
        options.log_severity_level = 4  # errors that onnxruntime writes to the terminal are raised as well
        try:
            self.session = onnxruntime.InferenceSession(
                graph, options, providers=["CPUExecutionProvider"], enable_fallback=False
            )
            inputs, outputs = self.session.get_inputs(), self.session.get_outputs()
            metadata = self.session.get_modelmeta().custom_metadata_map.get(METADATA_KEY)
        except Exception as error:  # by onnxruntime, or by Python for a name that is not text
            raise BundleError(f"{GRAPH_NAME} cannot be run by onnxruntime: {_one_line(error)}") from error
        problem = next(_differences(info, inputs, outputs), None)
        if problem is not None:
            raise BundleError(f"{GRAPH_NAME} does not fit {BUNDLE_NAME}: {problem}")
        if metadata != description_digest(info):
            raise BundleError(f"{GRAPH_NAME} and {BUNDLE_NAME} are not of the same export")
        self.output_names = tuple(entry.name for entry in outputs)

    def start(self, rate_hz: float | None = None) -> Policy:
        """Return the policy at the start of an episode, with its own memory.

        Args:
            rate_hz: The number of calls of `step` per second of the robot, by default the rate of the bundle.
                In a loop that is n times faster, the policy acts in every nth call, beginning with the first,
                and returns its last commands in between.

        Raises:
            BundleError: The rate is not a whole multiple of that of the bundle.
        """
        every = 1.0 if rate_hz is None else rate_hz / self.info.rate_hz
        if not (0.999 <= every <= _MAX_RATIO and abs(every - round(every)) <= 1e-3 * every):
            raise BundleError(
                f"the policy acts at {self.info.rate_hz:g} Hz, and a loop of {rate_hz:g} Hz is not a whole"
                " multiple of it; call it at"
                f" {self.info.rate_hz:g} Hz, or {2 * self.info.rate_hz:g} Hz, or train again with another"
                " timestep"
            )
        return Policy(self, round(every))

    def description(self) -> dict[str, bytes]:
        """Return the files that define the meaning of the values: bundle.json, the scenario as
        `resolved.yaml`, and its files in `inputs`.

        The scenario is left out if it is missing or too large, because a policy acts without it.
        """
        contents = {BUNDLE_NAME: model.encode(self.info)}
        if self.folder is None:
            return contents
        inputs = sorted(name for name in self.info.files if name.startswith("inputs/"))
        names = {"resolved.yaml": SCENARIO_NAME, **{name: name for name in inputs}}
        try:
            files = {
                new: _exported(self.folder, self.info, name, _MAX_DESCRIPTION_BYTES)
                for new, name in names.items()
            }
        except BundleError:
            return contents
        return contents | files if sum(map(len, files.values())) <= _MAX_DESCRIPTION_BYTES else contents


def _differences(info: BundleInfo, inputs: Sequence[Any], outputs: Sequence[Any]) -> Iterator[str]:
    """Yield the differences of the inputs and outputs of a graph from those of a bundle.json."""
    read: tuple[model.Input | model.Memory, ...] = (*info.inputs, *info.memory)
    inputs_wanted = [(entry.name, entry.shape, entry.dtype) for entry in read]
    outputs_wanted: list[tuple[str, tuple[int, ...], str]] = [
        (entry.name, entry.shape, entry.dtype) for entry in info.outputs
    ]
    outputs_wanted += [(f"{entry.name}_next", entry.shape, entry.dtype) for entry in info.memory]
    choices = info.choices
    outputs_wanted.append(("action", info.action_shape, "int64" if choices else "float32"))
    outputs_wanted += [("scores", (sum(choices),), "float32")] if choices else []
    for what, wanted, declared in (("input", inputs_wanted, inputs), ("output", outputs_wanted, outputs)):
        names, names_found = [entry[0] for entry in wanted], [entry.name for entry in declared]
        if names != names_found:
            other = next(
                (name for name in (*names, *names_found) if (name in names) != (name in names_found)), None
            )
            order = (
                f"the {what}s have another order"
                if other is None
                else f"'{other}' is an {what} of only one of them"
            )
            yield order
        for (name, shape, dtype), entry in zip(wanted, declared, strict=False):
            if tuple(entry.shape) != shape or entry.type != _ONNX_TYPES[dtype]:
                yield (
                    f"the {what} '{name}' is {dtype} {list(shape)} in one, and {entry.type} {entry.shape}"
                    " in the other"
                )


class Policy:
    """A policy that acts: `step` once per timestep of the bundle, `reset` at the start of an episode.

    One policy acts for one robot, because it has a memory of earlier steps.
    """

    def __init__(self, bundle: Bundle, every: int = 1) -> None:
        """Create a policy that acts once in `every` calls of `step`."""
        self._every = every
        self._run = bundle.session.run
        self._inputs = [(entry.name, entry.shape, _NUMPY_TYPES[entry.dtype]) for entry in bundle.info.inputs]
        self._names = frozenset(entry.name for entry in bundle.info.inputs)
        self._outputs = bundle.output_names
        self._memories = [(entry.name, f"{entry.name}_next") for entry in bundle.info.memory]
        self._ranges = list(_ranges(bundle.info))
        self._initial = {entry.name: initial_value(entry) for entry in bundle.info.memory}
        self.reset()

    def reset(self) -> None:
        """Forget all earlier steps. The next one is the first of an episode."""
        self._memory = dict(self._initial)
        self._calls, self._last = 0, dict[str, Array]()

    def step(self, values: Mapping[str, Any]) -> dict[str, Array]:
        """Return the commands for the present values of the sensors.

        Args:
            values: The values of each input in its shape, in SI units; a single number for the shape [1].

        Returns:
            The command of each actuator (float64 [n], SI units) by its name; `action`, and with choices
            `scores` of all options.

        Raises:
            InputError: A value is missing, unknown, of another shape or kind, or not finite.
            BundleError: The graph cannot compute with these values, or computes a command that is not finite.
                As after an InputError, the memory of the policy has not changed.
        """
        if values.keys() != self._names:
            raise InputError(self._wrong_names(values))
        feeds = dict(self._memory)
        for name, shape, kind in self._inputs:
            feeds[name] = _fitting(name, values[name], shape, kind)
        if self._calls % self._every:
            self._calls += 1
            return {name: value.copy() for name, value in self._last.items()}
        try:
            results = dict(zip(self._outputs, self._run(None, feeds), strict=True))
        except Exception as error:  # raised by onnxruntime, for example for a place beyond the end of a table
            raise BundleError(f"{GRAPH_NAME} cannot compute with these values: {_one_line(error)}") from error
        for name, low, high in self._ranges:
            value = results[name]
            if not ((value >= low) & (value <= high)).all():  # includes NaN
                if not np.isfinite(value).all() or value.dtype.kind == "i":
                    raise BundleError(f"{GRAPH_NAME} computes '{name}' as {_numbers(value)}")
                results[name] = np.clip(value, low, high).astype(value.dtype)
        self._calls += 1
        for name, following in self._memories:
            self._memory[name] = results.pop(following)
        self._last = results if self._every == 1 else {name: value.copy() for name, value in results.items()}
        return results

    def _wrong_names(self, values: Mapping[str, Any]) -> str:
        missing, unknown = sorted(self._names - values.keys()), sorted(map(str, values.keys() - self._names))
        parts = [
            f"{len(names)} {what} ({', '.join(names[:5])})"
            for what, names in (("missing", missing), ("unknown", unknown))
            if names
        ]
        return f"the values do not fit the inputs of the policy: {', '.join(parts)}"


def _ranges(info: BundleInfo) -> Iterator[tuple[str, Array, Array]]:
    """Yield the smallest and the largest number of each output; without a limit, those of finite numbers."""
    limit = np.finfo(np.float64).max
    for entry in info.outputs:
        low, high = (
            [limit * sign if each is None else each for each in ends]
            for ends, sign in zip(entry.range, (-1, 1), strict=True)
        )
        yield entry.name, np.array(low), np.array(high)
    if info.choices:
        yield "action", np.zeros(info.action_shape), np.array(info.choices).reshape(info.action_shape) - 1
        yield "scores", np.array(-limit), np.array(limit)
    else:
        yield "action", np.array(-1.0), np.array(1.0)


def initial_value(entry: model.Memory) -> Array:
    """Return a memory at the start of an episode."""
    return np.ascontiguousarray(
        np.broadcast_to(np.array(entry.initial, _NUMPY_TYPES[entry.dtype]), model.size_of(entry.shape))
    ).reshape(entry.shape)


def _fitting(name: str, value: Any, shape: tuple[int, ...], kind: type[Any]) -> Array:
    try:
        array = np.asarray(value)
    except ValueError as error:
        raise InputError(f"the value of '{name}' is not an array") from error
    if array.shape != shape:
        if array.shape == () and shape == (1,):
            array = array.reshape(1)
        else:
            raise InputError(
                f"the value of '{name}' has the shape {list(array.shape)}; it must have {list(shape)}"
            )
    if array.dtype == kind:
        pass
    elif kind in (np.float64, np.float32) and array.dtype.kind in "iuf":
        with np.errstate(over="ignore"):  # an infinite value is refused below
            array = array.astype(kind)
    else:
        raise InputError(
            f"the value of '{name}' is of the type {array.dtype}; it must be {np.dtype(kind).name}"
        )
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise InputError(f"the value of '{name}' is not finite")
    return array


# Recorded steps


@dataclass(frozen=True)
class Parity:
    """Recorded steps: rows of each input and each output, and the numbers of the steps with which an episode
    begins."""

    inputs: Mapping[str, Array]
    outputs: Mapping[str, Array]
    starts: tuple[int, ...]

    @property
    def steps(self) -> int:
        return len(next(iter(self.outputs.values())))


def read_parity(content: bytes, info: BundleInfo) -> Parity:
    """Read the steps of a parity.npz.

    Raises:
        BundleError: The file is damaged, or has other arrays than the bundle.
    """
    wanted = {f"input/{entry.name}": entry for entry in info.inputs} | {
        f"output/{entry.name}": entry for entry in info.outputs
    }
    names = {*wanted, "output/action", "starts", *(["output/scores"] if info.choices else [])}
    try:
        arrays = _read_archive(content, names)
    except BundleError:
        raise
    except Exception as error:  # zipfile, zlib and numpy raise a dozen kinds of exceptions for damaged files
        raise BundleError(f"{PARITY_NAME} is damaged: {_one_line(error)}") from error
    starts = arrays.pop("starts")
    count = len(arrays["output/action"]) if arrays["output/action"].ndim else 0
    if starts.dtype.kind != "i" or starts.ndim != 1 or not len(starts) or not count or starts[0] != 0:
        raise BundleError(f"{PARITY_NAME} has no steps, or does not say where episodes begin")
    if (np.diff(starts) <= 0).any() or starts[-1] >= count:
        raise BundleError(f"the starts in {PARITY_NAME} are not in order")
    shapes = {name: (entry.shape, _NUMPY_TYPES[entry.dtype]) for name, entry in wanted.items()}
    shapes["output/action"] = (info.action_shape, np.int64 if info.choices else np.float32)
    shapes |= {"output/scores": ((sum(info.choices),), np.float32)} if info.choices else {}
    for name, (shape, dtype) in shapes.items():
        if arrays[name].shape != (count, *shape) or arrays[name].dtype != dtype:
            raise BundleError(f"'{name}' in {PARITY_NAME} has another shape or type than in {BUNDLE_NAME}")
        if arrays[name].dtype.kind == "f" and not np.isfinite(arrays[name]).all():
            raise BundleError(f"'{name}' in {PARITY_NAME} has a number that is not finite")
    own = {
        name: {key.partition("/")[2]: array for key, array in arrays.items() if key.startswith(name)}
        for name in ("input", "output")
    }
    return Parity(own["input"], own["output"], tuple(starts.tolist()))


def _read_archive(content: bytes, names: Collection[str]) -> dict[str, Array]:
    """Read the arrays of these names, which must be the only content of a zip file. This takes no more time
    and memory than their size justifies."""
    # Each of millions of entries would become an object.
    if content.count(_ENTRY_OF_ARCHIVE) > 2 * len(names) + 100:
        raise BundleError(f"{PARITY_NAME} has more entries than {BUNDLE_NAME} has fields")
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        entries = archive.infolist()
        sizes = {entry.filename: entry.file_size for entry in entries}
        if any(entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) for entry in entries):
            # LZMA allocates as much memory as the file states.
            raise BundleError(f"{PARITY_NAME} is not compressed as an export compresses it")
        if sum(entry.compress_size for entry in entries) > len(content):
            raise BundleError(f"{PARITY_NAME} has arrays in the same bytes")
        if len(sizes) != len(entries):
            raise BundleError(f"{PARITY_NAME} has two arrays with one name")
        if sum(sizes.values()) > _MAX_PARITY_BYTES:
            raise BundleError(f"{PARITY_NAME} holds more than {_MAX_PARITY_BYTES} bytes")
        if sizes.keys() != {f"{name}.npy" for name in names}:
            raise BundleError(f"{PARITY_NAME} has other arrays than {BUNDLE_NAME} has fields")
        return {name: _read_array(archive, f"{name}.npy", sizes[f"{name}.npy"]) for name in names}


def _read_array(archive: zipfile.ZipFile, name: str, size: int) -> Array:
    """Read an array of numbers, which takes no more memory than its bytes."""
    with archive.open(name) as file:
        content = file.read(size)
    header = io.BytesIO(content[:_MAX_HEADER_BYTES])
    if np.lib.format.read_magic(header) != (1, 0):
        raise ValueError(f"{name} has another version than an export writes")
    with warnings.catch_warnings(action="ignore"):  # for example, one about headers of Python 2 shows a path
        shape, by_columns, dtype = np.lib.format.read_array_header_1_0(header)
    if dtype.hasobject or len(content) - header.tell() != model.size_of(shape) * dtype.itemsize:
        raise ValueError(f"{name} has another number of bytes than its shape and type")
    return np.frombuffer(content, dtype, offset=header.tell()).reshape(
        shape, order="F" if by_columns else "C"
    )


def most_steps(bundle: Bundle, spent: int = 0) -> int:
    """Return the number of recorded steps that may be repeated when a bundle is loaded and other checks have
    taken `spent` operations."""
    info = bundle.info
    python = _STEP_OPERATIONS + _FIELD_OPERATIONS * (
        len(info.inputs) + 2 * len(info.memory) + len(info.outputs)
    )
    return max(0, _MAX_PARITY_OPERATIONS - spent) // (bundle.operations + python)


def replay(bundle: Bundle, parity: Parity, spent: int = 0) -> None:
    """Repeat recorded steps, after other checks that took the time of `spent` operations.

    Raises:
        BundleError: A command or a score differs by more than 1e-5 of its range, or another option is chosen
            although its score is smaller by more than 1e-5; or the graph cannot be run.
    """
    if parity.steps > most_steps(bundle, spent):
        raise BundleError(
            f"the {parity.steps} recorded steps take more than {max(0, _MAX_PARITY_OPERATIONS - spent):,}"
            " operations"
        )
    policy = bundle.start()
    starts, skipping = set(parity.starts), False
    spans: dict[str, Any] = {entry.name: span_of(entry) for entry in bundle.info.outputs} | {"action": 2.0}
    for step in range(parity.steps):
        if step in starts:
            policy.reset()
            skipping = False
        try:
            answers = policy.step({name: rows[step] for name, rows in parity.inputs.items()})
        except InputError as error:
            raise BundleError(f"step {step} in {PARITY_NAME}: {error}") from error
        except BundleError as error:
            raise BundleError(f"step {step} in {PARITY_NAME}: {error}") from error
        wanted = {name: rows[step] for name, rows in parity.outputs.items()}
        if skipping or _are_tied(bundle.info.choices, answers, wanted):
            skipping = True  # the commands are those of another option, and later steps may depend on them
            continue
        if "scores" in wanted:
            spans["scores"] = max(1.0, float(np.abs(wanted["scores"]).max()))
        for name, span in spans.items():
            if not np.all(np.abs(answers[name] - wanted[name]) <= TOLERANCE * span):
                numbers = f"'{name}' is {_numbers(answers[name])} and was {_numbers(wanted[name])}"
                raise BundleError(f"the policy differs from its recording in step {step}: {numbers}")


def span_of(entry: model.Output) -> Array:
    """Return the width of the range of each component of a command; 1 without a limit."""
    ends = zip(*entry.range, strict=True)
    return np.array([1.0 if low is None or high is None or low == high else high - low for low, high in ends])


def _are_tied(choices: tuple[int, ...], answers: Mapping[str, Array], wanted: Mapping[str, Array]) -> bool:
    """Return whether another option was chosen, of two whose scores are equal except for rounding."""
    if not choices or np.array_equal(answers["action"], wanted["action"]):
        return False
    now, before = np.atleast_1d(answers["action"]), np.atleast_1d(wanted["action"])
    first = 0
    for size, one, other in zip(choices, now.tolist(), before.tolist(), strict=True):
        scores = wanted["scores"][first : first + size]
        if not 0 <= other < size or abs(float(scores[one]) - float(scores[other])) > TOLERANCE:
            return False
        first += size
    return True


def _numbers(array: Array) -> str:
    return ", ".join(f"{number:.6g}" for number in np.atleast_1d(array).tolist()[:6])


def _one_line(error: BaseException, most: int = 200) -> str:
    """Return the text of an error, which may contain names of a graph, without characters that a terminal
    obeys."""
    text = " ".join(str(error).split())[:most] or type(error).__name__
    return model.printable(text)
