"""Networks and optimisers as plain arrays in a file, without pickle.

The file is an uncompressed `.npz` (numpy reads it) with one more member, `state.json`. Nothing in it says how to build
anything: a model is built from the run's scenario first, and only arrays of the names, shapes and types that this model
has are read, so that a file from a stranger can cost no more memory than the model itself.

    policy/action_net.weight              a tensor of a module
    policy.optimizer/3/exp_avg            what an optimiser remembers of its parameter 3
    variable/log_ent_coef                 a tensor of the algorithm
    replay/observations                   transitions of an off-policy algorithm, oldest first
    replay/observations/camera            the same for a part of what is seen
"""

from __future__ import annotations

import hashlib
import json
import math
import re
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt
import torch
from gymnasium.spaces import Discrete
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.her import HerReplayBuffer

from deepbots_cli.errors import RunError
from deepbots_cli.files import atomic
from deepbots_cli.learning.atomic import Entries, parse_object

Array = npt.NDArray[Any]

_STATE = "state.json"
_STATE_LIMIT = 4_000_000
_OVERHEAD_LIMIT = 8_000_000
# Of version 1.0, in C order. Numpy's own reader evaluates the header as Python and may fail in a dozen ways.
_HEADER = re.compile(rb"\{'descr': '(?P<dtype>[<|][a-zA-Z]\d{0,2})', 'fortran_order': False, 'shape': \((?P<shape>[\d, ]{0,80})\), \} *\n")
_REPLAY = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


@dataclass(frozen=True)
class Slot:
    """Where an array belongs.

    `rows` lets the first axis be shorter than it is in `shape`; of the arrays of one `group` there are all or none.
    """

    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    required: bool
    rows: bool = False
    group: str = ""

    @property
    def size(self) -> int:
        """Bytes, at most."""
        return math.prod(self.shape) * self.dtype.itemsize

    def fits(self, shape: tuple[int, ...]) -> bool:
        if self.rows:
            return len(shape) == len(self.shape) and shape[1:] == self.shape[1:] and shape[0] <= self.shape[0]
        return shape == self.shape


def networks(model: BaseAlgorithm) -> dict[str, Array]:
    """Every tensor that the policy consists of, by name."""
    return {f"policy/{name}": _array(tensor) for name, tensor in model.policy.state_dict().items()}


def everything(model: BaseAlgorithm) -> dict[str, Array]:
    """Networks, optimisers, further tensors of the algorithm, and the replay buffer: what training goes on from."""
    arrays = networks(model)
    for name, optimiser in _optimisers(model):
        for index, memory in optimiser.state_dict()["state"].items():
            arrays |= {f"{name}/{index}/{key}": _array(tensor) for key, tensor in memory.items()}
    arrays |= {f"variable/{name}": _array(tensor) for name, tensor in _variables(model)}
    replay = _replay(model)
    if replay is not None:
        arrays |= {f"replay/{name}": _in_order(array, replay) for name, array in _columns(replay).items()}
    return arrays


def put(model: BaseAlgorithm, arrays: Mapping[str, Array]) -> None:
    """Set what `read` returned for this model."""
    model.policy.load_state_dict(
        {name.removeprefix("policy/"): torch.tensor(a) for name, a in arrays.items() if name.startswith("policy/")}
    )
    for name, optimiser in _optimisers(model):
        state: dict[int, dict[str, torch.Tensor]] = {}
        for key, array in arrays.items():
            if key.startswith(f"{name}/"):
                _, index, moment = key.split("/")
                state.setdefault(int(index), {})[moment] = torch.tensor(array)
        optimiser.load_state_dict({**optimiser.state_dict(), "state": state})
    for name, tensor in _variables(model):
        if f"variable/{name}" in arrays:
            tensor.data.copy_(torch.tensor(arrays[f"variable/{name}"]))
    replay = _replay(model)
    if replay is not None and "replay/rewards" in arrays:
        _refill(replay, arrays)


def digest(arrays: Mapping[str, Array]) -> str:
    """SHA-256 over names, shapes and bytes; equal exactly for equal networks."""
    total = hashlib.sha256()
    for name in sorted(arrays):
        total.update(f"{name} {arrays[name].dtype.str} {arrays[name].shape}\n".encode())
        total.update(np.asarray(arrays[name], order="C").tobytes())
    return total.hexdigest()


def not_finite(arrays: Mapping[str, Array]) -> str | None:
    """The name of the first array that holds an infinity or no number."""
    return next((name for name, array in arrays.items() if not np.isfinite(array).all()), None)


def write(path: Path, arrays: Mapping[str, Array], state: Mapping[str, Any]) -> None:
    with atomic(path, RunError) as draft, zipfile.ZipFile(draft, "w", zipfile.ZIP_STORED) as archive:
        archive.writestr(_STATE, json.dumps(state, allow_nan=False))
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, np.asarray(array, order="C"), version=(1, 0), allow_pickle=False)


def read(path: Path, model: BaseAlgorithm) -> dict[str, Array]:
    """The arrays of a file that was written for a model like this one.

    Raises:
        RunError: The file is missing, no archive of ours, or holds other arrays than the model has.
    """
    slots = _slots(model)
    with _opened(path, sum(slot.size for slot in slots.values())) as archive:
        arrays = _arrays(archive, path, slots)
    _check_meaning(arrays, model, path)
    return arrays


def read_state(path: Path) -> Entries:
    """What `write` was given as `state`.

    Raises:
        RunError: As for `read`.
    """
    with _opened(path, limit=None) as archive, archive.open(_STATE) as member:
        return Entries(parse_object(member.read(_STATE_LIMIT), f"{path}: {_STATE}"), f"{path}: {_STATE}")


@contextmanager
def _opened(path: Path, limit: int | None) -> Iterator[zipfile.ZipFile]:
    if not path.is_file():
        raise RunError(f"{path} is missing")
    try:
        if limit is not None and path.stat().st_size > limit + _OVERHEAD_LIMIT:
            raise RunError(f"{path} is larger than the scenario's policy can be")
        with zipfile.ZipFile(path) as archive:
            yield archive
    except (zipfile.BadZipFile, OSError, EOFError, ValueError, KeyError, RuntimeError) as error:
        # Report only the first line of the library's error; NotImplementedError is a RuntimeError.
        raise RunError(
            f"{path} is damaged, or no model of ours ({str(error).splitlines()[0][:120] if str(error) else 'cut short'})"
        ) from error


def _arrays(archive: zipfile.ZipFile, path: Path, slots: Mapping[str, Slot]) -> dict[str, Array]:
    members = {item.filename.removesuffix(".npy"): item for item in archive.infolist() if item.filename != _STATE}
    missing = next((name for name, slot in slots.items() if slot.required and name not in members), None)
    strange = next((name for name in members if name not in slots), None)
    groups = {slots[name].group for name in members if name in slots}
    missing = missing or next((name for name, slot in slots.items() if slot.group and slot.group in groups and name not in members), None)
    if missing or strange:
        what = f"lacks '{missing}'" if missing else f"holds '{str(strange)[:80]}', which the scenario's policy has no place for"
        raise RunError(f"{path} {what}")
    arrays = {}
    for name, item in members.items():
        if item.compress_type != zipfile.ZIP_STORED:
            raise RunError(f"{path}: '{name}' is compressed, which no model of ours is")
        with archive.open(item) as member:
            arrays[name] = _read_array(member, slots[name], f"{path}: '{name}'")
    counts = {array.shape[0] for name, array in arrays.items() if slots[name].rows}
    if len(counts) > 1:
        raise RunError(f"{path}: the arrays of the replay buffer differ in length")
    return arrays


def _read_array(member: IO[bytes], slot: Slot, where: str) -> Array:
    """One array, after its header was found to fit: nothing is allocated on the word of the file."""
    start = member.read(10)
    header = _HEADER.fullmatch(member.read(int.from_bytes(start[8:], "little")))
    if start[:8] != b"\x93NUMPY\x01\x00" or header is None:
        raise RunError(f"{where} is no array as we write them")
    dtype, shape = header["dtype"].decode(), tuple(int(size) for size in header["shape"].split(b",") if size.strip())
    if dtype != slot.dtype.str or not slot.fits(shape):
        raise RunError(f"{where} is {dtype} of shape {shape}, the scenario's policy needs {slot.dtype.str} of shape {slot.shape}")
    size = math.prod(shape) * slot.dtype.itemsize
    content = member.read(size + 1)
    if len(content) != size:
        raise RunError(f"{where} is cut short or too long")
    array = np.frombuffer(content, slot.dtype).reshape(shape).copy()
    if not np.isfinite(array).all():
        raise RunError(f"{where} holds a number that is not finite")
    return array


def _check_meaning(arrays: Mapping[str, Array], model: BaseAlgorithm, path: Path) -> None:
    """Refuse numbers on which an update would fail: a count below zero, a choice that the agent does not have."""
    for name, array in arrays.items():
        if name.endswith("/step") and array < 0:
            raise RunError(f"{path}: '{name}' counts below zero")
    taken, space = arrays.get("replay/actions"), model.action_space
    if taken is not None and isinstance(space, Discrete) and not ((taken >= space.start) & (taken < space.start + space.n)).all():
        raise RunError(f"{path}: 'replay/actions' holds actions that the scenario does not have")


def _slots(model: BaseAlgorithm) -> dict[str, Slot]:
    """Every array that a file for this model may hold."""
    slots = {name: Slot(array.dtype, array.shape, required=True) for name, array in networks(model).items()}
    for name, optimiser in _optimisers(model):
        moments = _moments(optimiser)
        parameters = [p for group in optimiser.param_groups for p in group["params"]]
        for index, parameter in enumerate(parameters):
            for moment in moments:
                shape = () if moment == "step" else tuple(parameter.shape)
                slots[f"{name}/{index}/{moment}"] = Slot(np.dtype(np.float32), shape, required=False, group=f"{name}/{index}")
    for name, tensor in _variables(model):
        slots[f"variable/{name}"] = Slot(_array(tensor).dtype, tuple(tensor.shape), required=False)
    replay = _replay(model)
    if replay is not None:
        for name, array in _columns(replay).items():
            slots[f"replay/{name}"] = Slot(array.dtype, array.shape, required=False, rows=True, group="replay")
    return slots


def _moments(optimiser: torch.optim.Optimizer) -> list[str]:
    """What an optimiser remembers of each parameter, found out with a parameter of no concern."""
    probe = torch.nn.Parameter(torch.zeros(1))
    probe.grad = torch.zeros(1)
    build: Callable[..., torch.optim.Optimizer] = type(optimiser)
    likewise = build([{**optimiser.param_groups[0], "params": [probe]}])
    likewise.step()
    return list(likewise.state[probe])


def _optimisers(model: BaseAlgorithm) -> Iterator[tuple[str, torch.optim.Optimizer]]:
    for name in model._get_torch_save_params()[0]:
        part = attrgetter(name)(model)
        if isinstance(part, torch.optim.Optimizer):
            yield name, part


def _variables(model: BaseAlgorithm) -> Iterator[tuple[str, torch.Tensor]]:
    for name in model._get_torch_save_params()[1]:
        yield name, attrgetter(name)(model)


def _replay(model: BaseAlgorithm) -> ReplayBuffer | None:
    """The replay buffer, unless it keeps each observation once only: that kind is not kept."""
    return model.replay_buffer if isinstance(model, OffPolicyAlgorithm) and not model.optimize_memory_usage else None


def _columns(replay: ReplayBuffer) -> dict[str, Array]:
    """The arrays of a replay buffer by name, a row per step; what is seen in parts has one for each part."""
    columns: dict[str, Array] = {}
    for name in _REPLAY:
        column = getattr(replay, name)
        columns |= {f"{name}/{part}": array for part, array in column.items()} if isinstance(column, dict) else {name: column}
    return columns


def _in_order(array: Array, replay: ReplayBuffer) -> Array:
    """The rows of a ring that are filled, oldest first."""
    return np.concatenate((array[replay.pos :], array[: replay.pos])) if replay.full and replay.pos else array[: replay.size()]


def _refill(replay: ReplayBuffer, arrays: Mapping[str, Array]) -> None:
    count = len(arrays["replay/rewards"])
    for name, column in _columns(replay).items():
        column[:count] = arrays[f"replay/{name}"]
    replay.pos = count % replay.buffer_size
    replay.full = count == replay.buffer_size
    if isinstance(replay, HerReplayBuffer):
        _find_episodes(replay, count)


def _find_episodes(replay: HerReplayBuffer, count: int) -> None:
    """Where each remembered step's episode begins and how long it is; 0 for those that had not ended, which are not drawn from."""
    for copy in range(replay.n_envs):
        first = 0
        for end in np.flatnonzero(replay.dones[:count, copy]) + 1:
            replay.ep_start[first:end, copy] = first
            replay.ep_length[first:end, copy] = end - first
            first = int(end)
    # What is under way is begun anew.
    replay._current_ep_start[:] = replay.pos


def _array(tensor: torch.Tensor) -> Array:
    array: Array = tensor.detach().cpu().numpy()
    return array
