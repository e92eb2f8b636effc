"""Algorithms of Stable-Baselines3, created for a scenario; their table is `scenario.training.ALGORITHMS`.

Networks, environments and replay buffers that do not fit into the memory are refused before they are created.
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from inspect import signature, unwrap
from itertools import pairwise
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.noise import ActionNoise
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.her import HerReplayBuffer
from torch import nn

from deepbots_cli.diagnostics.nearest import did_you_mean
from deepbots_cli.errors import MissingExtraError, UsageError
from deepbots_cli.learning.sb3 import defaults, internals
from deepbots_cli.learning.sb3.networks import asymmetric
from deepbots_cli.plugins import import_attribute
from deepbots_cli.program.task import ACTIVATIONS, AdaptiveRate, Hyperparameter, Schedule, Training
from deepbots_cli.program.task import ActionNoise as NoiseSettings
from deepbots_cli.scenario.training import ALGORITHMS, MAX_LAYERS, MAX_WEIGHTS
from deepbots_cli.scenario.training import Training as Model

_MIN_RATE, _MAX_RATE = 1e-5, 1e-2


def value_of(hyperparameter: Hyperparameter) -> object:
    """Return the value of a hyperparameter as Stable-Baselines3 takes it."""
    if hyperparameter.name == "train_freq" and isinstance(hyperparameter.value, str):
        count, _, unit = hyperparameter.value.partition(" ")
        # `TrainFrequencyUnit` of the library has the units in the singular, `step` and `episode`.
        return int(count), unit.rstrip("s")
    if isinstance(hyperparameter.value, AdaptiveRate):
        return DivergenceRate(hyperparameter.value)
    if not isinstance(hyperparameter.value, Schedule):
        return hyperparameter.value
    start, end = hyperparameter.value.start, hyperparameter.value.end
    # The library passes the share of the training that is left, from 1 to 0.
    return lambda remaining: end + (start - end) * remaining


class DivergenceRate:
    """A learning rate that keeps the KL divergence of an update near a target.

    The rule and its numbers are those of RSL-RL (Schwarke et al., arXiv:2509.10771), applied after each
    update instead of each batch.
    """

    def __init__(self, settings: AdaptiveRate) -> None:
        self.kl = settings.kl
        self.rate = settings.start

    def __call__(self, remaining: float) -> float:
        return self.rate

    def follow(self, divergence: float) -> None:
        """Change the rate after an update with this divergence."""
        if divergence > 2.0 * self.kl:
            self.rate = max(_MIN_RATE, self.rate / 1.5)
        elif 0.0 < divergence < 0.5 * self.kl:
            self.rate = min(_MAX_RATE, self.rate * 1.5)


class DecayingNoise(ActionNoise):
    """Noise on the actions of an off-policy algorithm, with a standard deviation that may change over the
    training.

    Draws come from numpy's global generator, which the training seeds. Drifting noise (`ornstein_uhlenbeck`)
    is sampled exactly: n' = a n + sigma sqrt(1 - a^2) w with a = exp(-theta) and w of unit variance, so that
    its deviation is sigma whatever theta is (D. T. Gillespie, Phys. Rev. E 54, 1996, p. 2084). The first
    value of an episode has the same distribution as all others.

    Args:
        settings: The settings of the scenario.
        size: The shape of an action.
        remaining: Returns the share of the training that is left, from 1 to 0.
    """

    def __init__(
        self, settings: NoiseSettings, size: tuple[int, ...], remaining: Callable[[], float]
    ) -> None:
        super().__init__()
        self._settings = settings
        self._size = size
        self._remaining = remaining
        self._factor = math.exp(-settings.theta) if settings.type == "ornstein_uhlenbeck" else None
        self.drift: npt.NDArray[np.float64] | None = None
        """The last value of drifting noise of unit deviation; None at the start of an episode."""

    @property
    def sigma(self) -> float:
        """The standard deviation at this point of the training, in the agent's [-1, 1]."""
        start, end = self._settings.sigma.start, self._settings.sigma.end
        return end + (start - end) * self._remaining()

    def __call__(self) -> npt.NDArray[np.float32]:
        if self._factor is None:
            return np.random.normal(0.0, self.sigma, self._size).astype(np.float32)
        noise = np.random.normal(0.0, 1.0, self._size)
        self.drift = (
            noise
            if self.drift is None
            else self._factor * self.drift + math.sqrt(1.0 - self._factor**2) * noise
        )
        return (self.sigma * self.drift).astype(np.float32)

    def reset(self) -> None:
        self.drift = None


Settings = dict[str, Any]


def create(
    training: Training,
    env: VecEnv,
    *,
    seed: int,
    total_timesteps: int,
    longest_episode: int = 1,
    to_learn: bool = True,
    mixin: type | None = None,
    policy_columns: Sequence[int] | None = None,
) -> BaseAlgorithm:
    """Create a fresh model for the environment. A model that is not to learn gets no room for experience.

    `longest_episode` is in steps. With hindsight, learning begins after this number of steps, when at least
    one episode has ended. The methods of the class `mixin` override those of the algorithm. `policy_columns`
    are those of a policy whose critic sees more.

    Raises:
        UsageError: The algorithm is unknown, or refuses the settings or the spaces; the networks would be
            larger than any memory; or there is no such device.
        MissingExtraError: The algorithm is one of sb3-contrib, which is not installed.
    """
    algorithm = _entry(training.algorithm)
    check_size(training.network.hidden, numbers_in(env.observation_space))
    # Each copy of a robot is a row of its own, and the defaults depend on the number of rows.
    training = replace(training, environments=env.num_envs)
    settings: Settings = defaults.default_values(training, total_timesteps, longest_episode)
    default_noise = settings.pop("action_noise", None)
    noise = training.action_noise or default_noise
    if settings.pop("replay", None) is not None and training.replay is not None:
        buffer_options = {
            "n_sampled_goal": training.replay.goals,
            "goal_selection_strategy": training.replay.strategy,
        }
        settings |= {"replay_buffer_class": HerReplayBuffer, "replay_buffer_kwargs": buffer_options}
    settings |= {h.name: value_of(h) for h in training.hyperparameters}
    if noise is not None and isinstance(env.action_space, gym.spaces.Box):
        # The noise is created before the model, whose progress it reads later.
        settings["action_noise"] = DecayingNoise(
            noise, env.action_space.shape, lambda: internals.progress_remaining(model)
        )
    if to_learn:
        check_replay(settings, env.observation_space)
    else:
        _without_experience(settings, algorithm)
    memory = settings.pop("lstm", None)
    std = settings.pop("init_std", 1.0)
    inputs = "MultiInput" if isinstance(env.observation_space, gym.spaces.Dict) else "Mlp"
    policy = f"{inputs}{'' if memory is None else 'Lstm'}Policy"
    settings |= {
        "seed": seed,
        "device": _device(training.device, to_learn=to_learn),
        "verbose": 0,
        "policy_kwargs": _networks(training, algorithm, memory, std),
    }
    policy_class = _policy_class(algorithm, policy, policy_columns)
    model = _create_model(algorithm, mixin, training, policy_class, env, settings)
    for name in ("optimizer_class", "optimizer_kwargs"):  # so that model files name no class of deepbots
        model.policy_kwargs.pop(name, None)
    if not internals.saved_members(model)[0] or not model.policy.state_dict():
        raise UsageError(_not_in_torch_modules(algorithm, "its runs could be neither evaluated nor resumed"))
    return model


def _policy_class(algorithm: type[Model], policy: str, columns: Sequence[int] | None) -> str | type:
    """Return the policy by the library's name, or the class of one whose critic sees more."""
    if columns is None:
        return policy
    library_class: Any = _imported(algorithm)
    try:
        return asymmetric(library_class.policy_aliases[policy], columns)
    except (AttributeError, KeyError, TypeError) as error:
        raise UsageError(
            f"{algorithm.__name__} has no policy whose critic may see more; remove `critic` from the scenario"
        ) from error


def _without_experience(settings: Settings, algorithm: type[Model]) -> None:
    """Change the settings to those of a model that does not learn."""
    if not algorithm.on_policy:
        # The library allocates all rows of the buffer with the model, by default 1,000,000.
        settings["buffer_size"] = 1
    else:
        # PPO asserts more than one sample: the advantages of a single one have no standard deviation.
        settings["n_steps"] = 2
        if algorithm.base() != "A2C":
            settings["batch_size"] = 2
    for name in ("replay_buffer_class", "replay_buffer_kwargs"):
        settings.pop(name, None)


def _networks(training: Training, algorithm: type[Model], memory: int | None, std: float) -> Settings:
    """Return the networks of a policy, with an LSTM of `memory` units and the initial standard deviation
    `std` of the actions, and their optimizer."""
    layers = list(training.network.hidden)
    networks: Settings = {
        "net_arch": {"pi": layers, "vf": layers} if algorithm.on_policy else layers,
        "activation_fn": getattr(nn, ACTIVATIONS[training.network.activation]),
    }
    if memory is not None:
        networks["lstm_hidden_size"] = memory
    if std != 1.0:
        networks["log_std_init"] = math.log(std)
    if algorithm.base() == training.algorithm != "A2C":  # the optimizer of A2C is one of Stable-Baselines3
        epsilon = 1e-5 if algorithm.on_policy else 1e-8  # the defaults of Stable-Baselines3 and of torch
        networks |= {"optimizer_class": Adam, "optimizer_kwargs": {"eps": epsilon}}
    return networks


def _create_model(
    algorithm: type[Model],
    mixin: type | None,
    training: Training,
    policy: str | type,
    env: VecEnv,
    settings: Settings,
) -> BaseAlgorithm:
    """Create the model of the library. Its errors become errors of deepbots."""
    algorithm_class: Any = _imported(algorithm)
    if mixin is not None:
        algorithm_class = type(algorithm_class.__name__, (mixin, algorithm_class), {})
    try:
        with warnings.catch_warnings():
            # Batches that do not divide a rollout do no harm.
            warnings.simplefilter("ignore")
            model: BaseAlgorithm = algorithm_class(policy, env, **settings)
            return model
    except (AssertionError, MemoryError, RuntimeError, TypeError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise UsageError(
            f"{training.algorithm} does not accept the settings under 'train': {reason}"
        ) from error
    # A class of another package may raise anything. From a built-in one, it is a bug.
    except Exception as error:
        if training.algorithm == algorithm.base():
            raise
        reason = f"it fails with {type(error).__name__}: {' '.join(str(error).split())[:200]}"
        raise UsageError(_not_in_torch_modules(algorithm, reason)) from error


class Adam(torch.optim.Adam):
    """Adam of torch without its decorators for `torch.compile`.

    They import `torch._dynamo` when an optimizer is first made, which takes 1.4 s of CPU. The numbers are the
    same to the bit.
    """

    add_param_group = unwrap(torch.optim.Adam.add_param_group)
    zero_grad = unwrap(torch.optim.Adam.zero_grad)
    state_dict = unwrap(torch.optim.Adam.state_dict)
    load_state_dict = unwrap(torch.optim.Adam.load_state_dict)
    step = torch.no_grad()(unwrap(torch.optim.Adam.step))


def _not_in_torch_modules(algorithm: type[Model], reason: str) -> str:
    return (
        f"{algorithm.__name__} ({algorithm.import_path}) does not keep its networks as {algorithm.base()} of"
        " Stable-Baselines3 does, in"
        f" modules of torch: {reason}; docs/extending.md shows an adapter for algorithms in JAX"
    )


def _device(device: str, *, to_learn: bool) -> str:
    """Return `cpu` or `cuda`. A policy that was trained on a GPU acts on the CPU if there is no GPU."""
    if device == "cuda" and to_learn and not torch.cuda.is_available():
        raise UsageError(
            "`train.device` is cuda, but torch finds no CUDA device; write `device: auto` to use the CPU"
        )
    return "cuda" if device != "cpu" and torch.cuda.is_available() else "cpu"


def _imported(algorithm: type[Model]) -> type[BaseAlgorithm]:
    try:
        algorithm_class: type[BaseAlgorithm] = import_attribute(algorithm.import_path)
    except ModuleNotFoundError as error:
        raise MissingExtraError(
            "contrib", f"training with {algorithm.import_path.rpartition(':')[2]}"
        ) from error
    return algorithm_class


@contextmanager
def torch_settings() -> Iterator[None]:
    """Context in which torch uses one thread, because networks of this size are slower on several. Afterwards
    the settings are as before."""
    threads = torch.get_num_threads()
    cudnn = torch.backends.cudnn
    before = cudnn.deterministic, cudnn.benchmark  # SB3 changes both when it sets a seed for a GPU
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
        cudnn.deterministic, cudnn.benchmark = before


def takes_masks(model: BaseAlgorithm) -> bool:
    """Return whether the policy uses action masks."""
    return any(
        "action_masks" in signature(vars(kind)["predict"]).parameters
        for kind in type(model).__mro__
        if "predict" in vars(kind)
    )


def collects_as_usual(training: Training, model: BaseAlgorithm) -> bool:
    """Return whether the algorithm collects rollouts with the method of its built-in base algorithm."""
    algorithm = _entry(training.algorithm)
    usual: Any = _imported(ALGORITHMS[algorithm.base()])
    return type(model).collect_rollouts is usual.collect_rollouts  # type: ignore[attr-defined]


def check(training: Training) -> None:
    """Check an algorithm and its networks.

    Raises:
        UsageError: The table does not contain the algorithm, or the networks would be larger than any memory.
    """
    _entry(training.algorithm)
    check_size(training.network.hidden)


def check_teachable(training: Training) -> None:
    """Check that an algorithm can be taught.

    Raises:
        UsageError: The algorithm cannot learn from a teacher.
    """
    if _entry(training.algorithm).is_recurrent:
        raise UsageError(f"{training.algorithm} cannot learn from a teacher; leave out --teacher")


def _entry(name: str) -> type[Model]:
    if name not in ALGORITHMS:
        hint = did_you_mean(name, ALGORITHMS)
        raise UsageError(f"there is no algorithm '{name}'; use one of {', '.join(ALGORITHMS)}{hint}")
    return ALGORITHMS[name]


CONTAINER_LIMITS = (
    Path("/sys/fs/cgroup/memory.max"),
    Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"),
)
"""The files with the memory limit of a container, of cgroups 2 and 1."""
_BYTES_PER_ENVIRONMENT = 29_000_000  # measured for a cart-pole in PyBullet


def check_size(hidden: Sequence[int], inputs: int = 0) -> None:
    """Check the sizes of the hidden layers of a network; `inputs` is 0 if it is not known yet.

    Raises:
        UsageError: The network would be larger than any memory.
    """
    if len(hidden) > MAX_LAYERS:
        raise UsageError(f"a policy has at most {MAX_LAYERS} hidden layers")
    if sum(width * next_width for width, next_width in pairwise((inputs, *hidden))) > MAX_WEIGHTS:
        observed = f"{inputs:,} observed numbers and " if inputs else ""
        raise UsageError(
            f"a policy with {observed}hidden layers of {', '.join(map(str, hidden))} units has more than"
            f" {MAX_WEIGHTS:,} weights"
        )


def check_memory(environments: int, memory: int | None = None) -> None:
    """Check that this number of environments fits into the memory of this machine. `memory` is in bytes, by
    default all memory of the machine.

    Raises:
        UsageError: They do not fit.
    """
    _require_memory(f"{environments} environments need about", environments * _BYTES_PER_ENVIRONMENT, memory)


def check_replay(settings: Mapping[str, Any], space: gym.Space[Any], memory: int | None = None) -> None:
    """Check that the replay buffer fits into the memory of this machine; `memory` as for `check_memory`.

    Raises:
        UsageError: It does not fit.
    """
    steps = settings.get("buffer_size", 0)
    # The library stores each observation twice, as the present and as the next one.
    needed = (
        2
        * steps
        * sum(
            math.prod(part.shape or ()) * (part.dtype or np.dtype(np.float32)).itemsize
            for part in _parts_of(space)
        )
    )
    subject = f"a replay buffer of {steps:,} steps needs"
    _require_memory(subject, needed, memory, "; lower 'buffer_size' under 'train'")


def _require_memory(subject: str, needed: int, memory: int | None, hint: str = "") -> None:
    memory = available_memory() if memory is None else memory
    if memory is not None and needed > memory:
        raise UsageError(
            f"{subject} {needed / 1e9:.1f} GB of memory, and this machine or container has"
            f" {memory / 1e9:.1f} GB{hint}"
        )


def available_memory() -> int | None:
    """Return the memory in bytes that this machine or its container has; None on Windows."""
    if not hasattr(os, "sysconf"):
        return None
    limits: list[int] = [os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")]
    for path in CONTAINER_LIMITS:
        with suppress(OSError, ValueError):  # there is no such file, or it says `max`
            limits.append(int(path.read_text()))
    return min(limits)


def numbers_in(space: gym.Space[Any]) -> int:
    """Return how many numbers an observation has. Layers of filters reduce its pictures before the first
    hidden layer."""
    return sum(math.prod(part.shape or ()) for part in _parts_of(space) if len(part.shape or ()) == 1)


def _parts_of(space: gym.Space[Any]) -> Iterable[gym.Space[Any]]:
    return space.spaces.values() if isinstance(space, gym.spaces.Dict) else [space]
