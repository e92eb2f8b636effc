"""Models as Stable-Baselines3's `.zip` files, which plain Stable-Baselines3 loads without deepbots.

The algorithm is built from the run's scenario, and only tensors of the names, shapes and types that it has
are taken from the file, by `torch.load(weights_only=True)`. That function also calls `bytearray`, and makes
sparse and quantized tensors, and some without numbers; a pickle that names anything but plain tensors is
refused before. No member may be compressed, so a file from a stranger cannot take more memory than its size,
which is limited by that of the model.
"""

from __future__ import annotations

import io
import os
import pickle
import pickletools
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from operator import attrgetter
from pathlib import Path
from traceback import walk_tb
from typing import Any

import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.save_util import is_json_serializable, save_to_zip_file

from deepbots_cli.errors import RunError, StorageError, UsageError
from deepbots_cli.files import atomic_write
from deepbots_cli.learning.learner import Initialization
from deepbots_cli.learning.model_files import opened
from deepbots_cli.learning.sb3 import internals

_VARIABLES = "pytorch_variables"
_STORAGES = ("Float", "Double", "Half", "BFloat16", "Long", "Int", "Short", "Char", "Byte", "Bool")
_PLAIN_GLOBALS = {
    "collections OrderedDict",
    "torch._utils _rebuild_tensor_v2",
    *(f"torch {name}Storage" for name in _STORAGES),
}
_OVERHEAD_BYTES = 8_000_000
NOT_FINITE = "the policy gives actions that are not finite: its weights are damaged, or the training diverged"
_DISTRIBUTION = "torch.distributions.distribution"
"""The module that checks the parameters of each distribution of torch."""
_MAX_MEMBERS = 32  # a model of SAC, which has three optimizers, has 8
# What a model cannot be loaded without, and JSON cannot hold; all of it is pickled by reference to
# Stable-Baselines3, Gymnasium and torch.
_PICKLED_ENTRIES = ("policy_class", "policy_kwargs", "observation_space", "action_space", "train_freq")
# Needs an environment to be loaded.
_HINDSIGHT_ENTRIES = ("replay_buffer_class", "replay_buffer_kwargs")


@contextmanager
def overflow_explained() -> Iterator[None]:
    """Context that turns torch's error about parameters of a distribution that are not finite into a
    RunError.

    torch raises a plain ValueError for these, which is recognized by the module that raises it.

    Raises:
        RunError: The parameters are not finite.
    """
    try:
        yield
    except ValueError as error:
        *_, (frame, _) = walk_tb(error.__traceback__)
        if frame.f_globals["__name__"] != _DISTRIBUTION:
            raise
        raise RunError(NOT_FINITE) from error


def save(path: Path, model: BaseAlgorithm) -> None:
    """Write a model that plain Stable-Baselines3 loads; schedules, noise and buffers are left out.

    Raises:
        RunError: The file cannot be written.
    """
    left_out = {
        *internals.unsaved_members(model),
        *_HINDSIGHT_ENTRIES,
        *(name.partition(".")[0] for name in _parts(model)),
    }
    data = {
        name: value
        for name, value in vars(model).items()
        if name not in left_out and (name in _PICKLED_ENTRIES or is_json_serializable(value))
    }
    if isinstance(getattr(model.policy, "columns", None), tuple):
        # The class of a policy whose critic sees more is made here: plain Stable-Baselines3 cannot load it.
        data = {name: value for name, value in data.items() if name != "policy_class"}
    # A schedule is a function of ours; training on elsewhere begins with the present rate.
    rate = data["learning_rate"] = float(model.lr_schedule(max(0.0, internals.progress_remaining(model))))
    parameters = model.get_parameters()
    for part in parameters.values():
        for group in part.get("param_groups", ()):
            group["lr"] = (
                # the library sets it in the next update only, so a resumed training would have another one
                # here
                rate
            )
    # In memory first: where a disk is full, torch's own writer ends in an error that does not say so.
    content = io.BytesIO()
    save_to_zip_file(content, data, parameters, dict(_variables(model)))
    with atomic_write(path, StorageError) as draft, draft.open("wb") as stream:
        stream.write(content.getbuffer())
        stream.flush()
        os.fsync(stream.fileno())  # so that the model survives a power cut


def load(path: Path, model: BaseAlgorithm) -> None:
    """Set the tensors of a model, its optimizers and its variables.

    Raises:
        RunError: The file is missing, damaged, no model of ours, or has other tensors than the model.
    """
    size = sum(tensor.numel() * tensor.element_size() for tensor in model.policy.state_dict().values())
    # The weights and the two moments of Adam take at most three times the size of the policy.
    tensors = _read(path, 4 * size + _OVERHEAD_BYTES)
    # Everything is checked before the first tensor is set, so a refused file leaves the model as it was.
    names = set(tensors)
    expected = {*_parts(model), _VARIABLES}
    if names != expected:
        _refuse(path, ", ".join(sorted(expected - names)), ", ".join(sorted(names - expected)))
    for name in _parts(model):
        part = attrgetter(name)(model)
        if isinstance(part, torch.optim.Optimizer):
            _check_optimizer(path, name, part, tensors[name])
        else:
            _check_tensors(path, name, part.state_dict(), tensors[name])
    _check_tensors(path, _VARIABLES, dict(_variables(model)), tensors[_VARIABLES])
    for name in _parts(model):
        part = attrgetter(name)(model)
        state = tensors[name]
        if isinstance(part, torch.optim.Optimizer):
            # The settings of the optimizer are those of the scenario, not of the file.
            part.load_state_dict({**part.state_dict(), "state": state["state"]})
        else:
            part.load_state_dict(state)
    for name, variable in _variables(model):
        variable.data.copy_(tensors[_VARIABLES][name])


def initialize(path: Path, model: BaseAlgorithm) -> Initialization:
    """Copy each tensor of the policy that has the same name and shape in the file. Optimizers begin afresh.

    Raises:
        RunError: The file is missing, damaged, or no model.
        UsageError: Nothing in it fits.
    """
    file_tensors = _read(path, path.stat().st_size if path.is_file() else 0)["policy"]
    tensors = model.policy.state_dict()
    reasons: dict[str, str] = {}
    for name, tensor in tensors.items():
        file_tensor = file_tensors.get(name)
        if not isinstance(file_tensor, torch.Tensor):
            reasons[name] = "the other model does not have it"
        elif file_tensor.shape != tensor.shape:
            reasons[name] = f"{tuple(tensor.shape)} here, {tuple(file_tensor.shape)} there"
        elif not torch.isfinite(file_tensor).all():
            reasons[name] = "not finite there"
    copied = tuple(name for name in tensors if name not in reasons)
    if not copied:
        raise UsageError(f"no tensor of {path} fits the policy of this scenario")
    model.policy.load_state_dict(
        {name: file_tensors[name] if name in copied else tensor for name, tensor in tensors.items()}
    )
    return Initialization(copied, reasons)


def _parts(model: BaseAlgorithm) -> list[str]:
    return internals.saved_members(model)[0]


def _variables(model: BaseAlgorithm) -> Iterator[tuple[str, torch.Tensor]]:
    for name in internals.saved_members(model)[1]:
        yield name, attrgetter(name)(model)


def _read(path: Path, limit: int) -> dict[str, Mapping[str, Any]]:
    """Return the state dictionaries of a model file, by part."""
    if not path.is_file():
        raise RunError(f"{path} is missing")
    if path.stat().st_size > limit:
        raise RunError(f"{path} is larger than the scenario's policy can be")
    tensors = {}
    try:
        with opened(path, path.stat().st_size) as archive:
            if len(archive.infolist()) > _MAX_MEMBERS:
                raise ValueError(f"it has {len(archive.infolist())} members")
            for name in archive.namelist():
                if name.endswith(".pth"):
                    content = archive.read(name)
                    # torch would read other content as a file from before 2020.
                    if not content.startswith(b"PK\x03\x04"):
                        raise ValueError("it contains objects other than plain tensors")
                    with opened(io.BytesIO(content), len(content)) as inner:
                        _check_pickle(inner)
                    tensors[name.removesuffix(".pth")] = torch.load(
                        io.BytesIO(content), map_location="cpu", weights_only=True
                    )
    except RunError:
        raise
    except pickle.UnpicklingError as error:
        raise RunError(
            f"{path} is damaged, or was not written by deepbots (it contains objects other than tensors)"
        ) from error
    except Exception as error:  # reading a damaged file raises a dozen kinds of exceptions
        reason = str(error).strip().splitlines()[0][:120] if str(error).strip() else "cut short"
        raise RunError(f"{path} is damaged, or was not written by deepbots ({reason})") from error
    if "policy" not in tensors or not all(isinstance(value, dict) for value in tensors.values()):
        raise RunError(f"{path} is damaged, or was not written by deepbots (it lacks 'policy')")
    return tensors


def _check_pickle(archive: zipfile.ZipFile) -> None:
    """Refuse a pickle of torch that names anything but dictionaries and plain tensors."""
    (name,) = (name for name in archive.namelist() if name.count("/") == 1 and name.endswith("/data.pkl"))
    for operation, argument, _ in pickletools.genops(archive.read(name)):
        if operation.name == "GLOBAL" and argument not in _PLAIN_GLOBALS:
            raise ValueError(f"it contains objects other than plain tensors: {str(argument)[:60]}")
        # The other operations that import an object. `torch.save` writes protocol 2, without them.
        if operation.name in ("STACK_GLOBAL", "INST", "EXT1", "EXT2", "EXT4"):
            raise ValueError("it contains objects other than plain tensors")


def _check_tensors(
    path: Path, where: str, tensors: Mapping[str, torch.Tensor], file_tensors: Mapping[Any, Any]
) -> None:
    if set(tensors) != set(file_tensors):
        missing = sorted(set(tensors) - set(file_tensors))
        strange = sorted(str(name) for name in set(file_tensors) - set(tensors))
        _refuse(path, f"{where}/{missing[0]}" if missing else "", f"{where}/{strange[0]}" if strange else "")
    for name, tensor in tensors.items():
        _check_tensor(path, f"{where}/{name}", tensor.dtype, tuple(tensor.shape), file_tensors[name])


def _check_optimizer(
    path: Path, where: str, optimizer: torch.optim.Optimizer, file_state: Mapping[str, Any]
) -> None:
    """Check that an optimizer has moments of the right names and shapes for parameters that exist.
    `param_groups` is not taken over."""
    parameters = [p for group in optimizer.param_groups for p in group["params"]]
    moments = _moments(optimizer)
    state = file_state.get("state")
    if not isinstance(state, dict):
        raise RunError(f"{path} lacks '{where}/state'")
    for index, memory in state.items():
        # Not isinstance, which accepts True as 1.
        if type(index) is not int or not 0 <= index < len(parameters) or not isinstance(memory, dict):
            _refuse(path, "", f"{where}/{index}")
        missing, strange = [m for m in moments if m not in memory], [m for m in memory if m not in moments]
        if missing or strange:
            _refuse(
                path,
                f"{where}/{index}/{missing[0]}" if missing else "",
                f"{where}/{index}/{strange[0]}" if strange else "",
            )
        for moment, value in memory.items():
            shape = () if moment == "step" else tuple(parameters[index].shape)
            _check_tensor(path, f"{where}/{index}/{moment}", torch.float32, shape, value)
            if moment == "step" and value < 0:
                raise RunError(f"{path}: '{where}/{index}/step' counts below zero")


def _check_tensor(path: Path, name: str, dtype: torch.dtype, shape: tuple[int, ...], tensor: Any) -> None:
    if not isinstance(tensor, torch.Tensor):
        raise RunError(f"{path}: '{name}' is not a tensor")
    if tensor.dtype != dtype or tuple(tensor.shape) != shape or tensor.layout != torch.strided:
        description = f"{str(tensor.dtype).removeprefix('torch.')} of shape {tuple(tensor.shape)}"
        raise RunError(
            f"{path}: '{name}' is {description}, the scenario's policy needs"
            f" {str(dtype).removeprefix('torch.')} of shape {shape}"
        )
    if not torch.isfinite(tensor).all():
        raise RunError(f"{path}: '{name}' contains infinite or NaN values")


def _refuse(path: Path, missing: str, strange: str) -> None:
    problem = (
        f"lacks '{missing}'"
        if missing
        else f"contains '{strange[:80]}', which the policy of this scenario does not have"
    )
    raise RunError(f"{path} {problem}")


def _moments(optimizer: torch.optim.Optimizer) -> list[str]:
    """Return the names of the moments that an optimizer keeps of each parameter, found with a separate
    parameter."""
    probe = torch.nn.Parameter(torch.zeros(1))
    probe.grad = torch.zeros(1)
    build: Any = type(optimizer)
    likewise = build([{**optimizer.param_groups[0], "params": [probe]}])
    likewise.step()
    return list(likewise.state[probe])
