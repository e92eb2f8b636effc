"""Rollouts from fragments: actors, the rollout buffer filled with the experience of an actor, and the worlds
of a collector as a vector environment.

The library's DummyVecEnv copies every info deeply in every step; `CollectorEnvironment` passes them on, and
also does the work of VecMonitor. With a cart-pole written in Python, a step takes 4.0 us instead of 7.0.

Actors do what `collect_rollouts` of Stable-Baselines3 does, with the same random numbers in the same order,
so that weights are equal to the bit.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
import torch
from gymnasium import spaces
from stable_baselines3.common.noise import VectorizedActionNoise
from stable_baselines3.common.utils import obs_as_tensor
from stable_baselines3.common.vec_env import VecEnv, VecTransposeImage
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvObs, VecEnvStepReturn

from deepbots_cli.errors import UsageError
from deepbots_cli.learning.sb3 import internals, networks
from deepbots_cli.learning.sb3.algorithms import DecayingNoise
from deepbots_cli.rollout.collector import Decision, FetchingCollector, Fragment, LocalCollector, PolicyActor
from deepbots_cli.rollout.worlds import Array, SingleWorlds, WorldsStep


class CollectorEnvironment(VecEnv):
    """Steps the worlds of a collector. The creator of the worlds closes them."""

    def __init__(self, collector: LocalCollector | FetchingCollector) -> None:
        self.collector = collector
        super().__init__(collector.rows, collector.observation_space, collector.action_space)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Do nothing, because the worlds keep the seeds that they were made with."""
        return [None] * self.num_envs

    def reset(self) -> VecEnvObs:
        """Return the observations of the running episodes. The first episodes begin if none has."""
        observations: VecEnvObs = self.collector.begin()
        return observations

    def step_async(self, actions: npt.NDArray[Any]) -> None:
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        return with_library_infos(self.collector.step_all(self._actions))

    def close(self) -> None:
        pass

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        return [agent.get_wrapper_attr(attr_name) for agent in self._agents(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        for agent in self._agents(indices):
            agent.set_wrapper_attr(attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        # A batch has its own masks.
        if (
            method_name == "action_masks"
            and isinstance(self.collector, LocalCollector)
            and (masks := self.collector.action_masks()) is not None
        ):
            return [masks[index] for index in self._get_indices(indices)]
        return [
            agent.get_wrapper_attr(method_name)(*method_args, **method_kwargs)
            for agent in self._agents(indices)
        ]

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: VecEnvIndices = None
    ) -> list[bool]:
        return [False for _ in self._agents(indices)]

    def _agents(self, indices: VecEnvIndices) -> list[Any]:
        agents = self.collector.agents
        # With shards, the spaces of one world are used for all.
        return [agents[index % len(agents)] for index in self._get_indices(indices)]


def with_library_infos(step: WorldsStep) -> VecEnvStepReturn:
    """Return a step of all rows, with the entries that the library reads for the last step of an episode."""
    for row, episode, observation, timed_out in step.endings:
        # A new dictionary, because the rows of a batch share an empty one.
        step.infos[row] = {
            **step.infos[row],
            "terminal_observation": observation,
            "TimeLimit.truncated": timed_out,
            "episode": {"r": episode.total_return, "l": episode.length},
        }
    return step.observations, step.rewards, step.ended, step.infos


class _Spaces(gym.Env[Any, Any]):
    def __init__(self, observation_space: gym.Space[Any], action_space: gym.Space[Any]) -> None:
        self.observation_space, self.action_space = observation_space, action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Return any observation: the library calls this before it learns."""
        return self.observation_space.sample(), {}


def spaces_only(
    observation_space: gym.Space[Any], action_space: gym.Space[Any], rows: int = 1
) -> CollectorEnvironment:
    """Return an environment without a world, for a policy that does not learn, or learns from worlds in other
    processes."""
    return CollectorEnvironment(
        LocalCollector(SingleWorlds([_Spaces(observation_space, action_space)] * rows, [0] * rows))
    )


_LSTM_BUFFERS = ("hidden_states_pi", "cell_states_pi", "hidden_states_vf", "cell_states_vf")


class RolloutActor(PolicyActor):
    """Acts with the policy of PPO, A2C, MaskablePPO or RecurrentPPO.

    The columns of a fragment are `action` before it is clipped, `values`, `log_probs`, `masks` where options
    are forbidden, and the state of a recurrent policy before each step.
    """

    def __init__(self, model: Any) -> None:
        self._model = model
        self._is_recurrent = internals.memory(model) is not None
        self._step = 0
        self.noises: list[DecayingNoise] = []

    def begin(self) -> None:
        self._step = 0
        self._model.policy.set_training_mode(False)
        if self._model.use_sde:
            self._model.policy.reset_noise(self._model.n_envs)

    def __call__(self, observations: Any, starts: Array, masks: Array | None) -> Decision:
        model = self._model
        policy = self._model.policy
        columns: dict[str, Array] = {}
        options: dict[str, Any] = {}
        if model.use_sde and model.sde_sample_freq > 0 and self._step % model.sde_sample_freq == 0:
            policy.reset_noise(model.n_envs)
        self._step += 1
        with torch.no_grad():
            inputs = obs_as_tensor(prepared(model, observations), model.device)
            if self._is_recurrent:
                columns |= self.memory()
                actions, values, log_probs, states = policy(
                    inputs, internals.memory(model), _floats(model, starts)
                )
                internals.set_memory(model, states)
            else:
                if masks is not None:
                    options["action_masks"] = columns["masks"] = masks
                sampled = (
                    networks.sampled_actions(policy, inputs)
                    if isinstance(inputs, torch.Tensor) and masks is None
                    else None
                )
                actions, values, log_probs = policy(inputs, **options) if sampled is None else sampled
        world_actions = actions = actions.cpu().numpy()
        if isinstance(model.action_space, spaces.Box):
            # `collect_rollouts` of RecurrentPPO clips the actions of every policy.
            if policy.squash_output and not self._is_recurrent:
                world_actions = policy.unscale_action(actions)
            else:
                world_actions = np.clip(actions, model.action_space.low, model.action_space.high)
        columns |= {
            "action": actions,
            "values": values.cpu().numpy().flatten(),
            "log_probs": log_probs.cpu().numpy(),
        }
        return Decision(world_actions, columns)

    def parameters(self) -> Mapping[str, Any]:
        return _weights(self._model)

    def load(self, parameters: Mapping[str, Any]) -> None:
        _load_weights(self._model, parameters)

    def memory(self) -> Mapping[str, Array]:
        if not self._is_recurrent:
            return {}
        state = internals.memory(self._model)
        return {
            # torch puts the layers of an LSTM before the rows. A collector divides memories by rows.
            name: part.cpu().numpy().swapaxes(0, 1)
            for name, part in zip(_LSTM_BUFFERS, [*state.pi, *state.vf], strict=True)
        }

    def remember(self, memory: Mapping[str, Array]) -> None:
        if self._is_recurrent:
            parts = [
                torch.tensor(memory[name].swapaxes(0, 1), device=self._model.device) for name in _LSTM_BUFFERS
            ]
            states = type(internals.memory(self._model))
            internals.set_memory(self._model, states((parts[0], parts[1]), (parts[2], parts[3])))


class ExplorationActor(PolicyActor):
    """Acts with the policy of an off-policy algorithm, and explores: with noise, with random actions, or with
    an entropy.

    The column of a fragment is `stored`, the action as the replay buffer keeps it.
    """

    def __init__(self, model: Any) -> None:
        self._model = model
        self._noise = model.action_noise
        if (
            self._noise is not None
            and model.n_envs > 1
            and not isinstance(self._noise, VectorizedActionNoise)
        ):
            # The library does this in `_setup_learn`, after the noise of each row is needed here.
            self._noise = model.action_noise = VectorizedActionNoise(self._noise, model.n_envs)
        self.noises: list[DecayingNoise] = (
            [] if self._noise is None else list(getattr(self._noise, "noises", [self._noise]))
        )
        self._step = 0
        self._rows = model.n_envs

    def begin(self) -> None:
        self._step = 0
        self._model.policy.set_training_mode(False)
        if self._model.use_sde:
            self._model.actor.reset_noise(self._model.n_envs)

    def __call__(self, observations: Any, starts: Array, masks: Array | None) -> Decision:
        model = self._model
        for noise in itertools.compress(self.noises, starts):
            noise.reset()
        if model.use_sde and model.sde_sample_freq > 0 and self._step % model.sde_sample_freq == 0:
            model.actor.reset_noise(model.n_envs)
        begun = model.num_timesteps
        last = internals.last(model)
        model.num_timesteps = begun + self._step * self._rows
        internals.set_last(model, prepared(model, observations), starts)
        self._step += 1
        actions, stored = internals.explore(model, model.learning_starts, self._noise, model.n_envs)
        model.num_timesteps = begun  # the learner counts and stores these steps
        internals.set_last(model, *last)
        return Decision(actions, {"stored": stored})

    def parameters(self) -> Mapping[str, Any]:
        model = self._model
        family = networks.family_of(model.policy)
        if family is None:  # others would act with its first weights
            raise UsageError(networks.unknown_networks(model.policy, "cannot act in other processes"))
        numbers = {
            name: getattr(model, name)
            for name in (*internals.EXPLORATION, "num_timesteps", "n_envs")
            if hasattr(model, name)
        }
        return numbers | {
            name: array for name, array in _weights(model).items() if name.partition(".")[0] == family.name
        }

    def load(self, parameters: Mapping[str, Any]) -> None:
        for name in internals.EXPLORATION:
            if name in parameters:
                setattr(self._model, name, parameters[name])
        self._model.num_timesteps = parameters["num_timesteps"]
        self._rows = parameters["n_envs"]
        _load_weights(self._model, parameters)

    def memory(self) -> Mapping[str, Array]:
        """Return the drift of the noise of each row; NaN where there is none."""
        if not self.noises:
            return {}
        nothing = np.full(self._model.action_space.shape, np.nan)
        return {"drift": np.stack([nothing if noise.drift is None else noise.drift for noise in self.noises])}

    def remember(self, memory: Mapping[str, Array]) -> None:
        for noise, drift in zip(self.noises, memory.get("drift", ()), strict=True):
            noise.drift = None if np.isnan(drift).any() else np.array(drift)


def _weights(model: Any) -> dict[str, Array]:
    return {name: tensor.detach().cpu().numpy() for name, tensor in model.policy.state_dict().items()}


def _load_weights(model: Any, weights: Mapping[str, Any]) -> None:
    with torch.no_grad():
        for name, tensor in model.policy.state_dict().items():
            if name in weights:
                tensor.copy_(torch.from_numpy(np.array(weights[name])))


def fill(model: Any, fragment: Fragment) -> None:
    """Put a fragment into the rollout buffer of the model, with returns and advantages."""
    buffer = model.rollout_buffer
    columns = fragment.columns
    # The update before has flattened the arrays of the buffer. `reset` makes new ones.
    buffer.reset()
    rewards = _rewards(model, fragment)
    observations = fragment.observations
    if isinstance(observations, dict):
        flat = prepared(model, {key: part.reshape(-1, *part.shape[2:]) for key, part in observations.items()})
        for key, part in flat.items():
            buffer.observations[key][...] = part.reshape(buffer.observations[key].shape)
    else:
        buffer.observations[...] = prepared(model, observations.reshape(-1, *observations.shape[2:])).reshape(
            buffer.observations.shape
        )
    buffer.actions[...] = columns["action"].reshape(buffer.actions.shape)
    buffer.rewards[...] = rewards
    buffer.episode_starts[...] = fragment.starts
    buffer.values[...], buffer.log_probs[...] = columns["values"], columns["log_probs"]
    if "masks" in columns:
        buffer.action_masks[...] = columns["masks"].reshape(buffer.action_masks.shape)
    for name in _LSTM_BUFFERS:
        if name in columns:
            getattr(buffer, name)[...] = columns[name].swapaxes(1, 2)
    buffer.pos = buffer.buffer_size
    buffer.full = True
    following = prepared(model, fragment.following)
    internals.set_last(model, following, fragment.following_starts)
    memory = (
        ()
        if "cell_states_vf" not in columns
        else (internals.memory(model).vf, _floats(model, fragment.following_starts))
    )
    with torch.no_grad():
        values = model.policy.predict_values(obs_as_tensor(following, model.device), *memory)
    buffer.compute_returns_and_advantage(last_values=values, dones=fragment.following_starts)


def _rewards(model: Any, fragment: Fragment) -> Array:
    """Return the rewards, normalized if the scenario sets this. At a time limit, the value of the state after
    it is added."""
    rewards = fragment.rewards.copy()
    normalizer = model.get_vec_normalize_env()
    if normalizer is not None:
        ends = [*fragment.starts[1:], fragment.following_starts]
        for step, dones in enumerate(ends):
            # The order of `VecNormalize.step_wait`: a step is scaled by statistics that include it.
            internals.update_returns(normalizer, rewards[step])
            rewards[step] = normalizer.normalize_reward(rewards[step])
            normalizer.returns[dones] = 0
    for number, ending in fragment.endings:
        if ending.timed_out:
            inputs, _ = model.policy.obs_to_tensor(prepared(model, ending.observation))
            memory = _memory_after(model, fragment, number, ending.row)
            with torch.no_grad():
                rewards[number, ending.row] += model.gamma * model.policy.predict_values(inputs, *memory)[0]
    return rewards


def _memory_after(model: Any, fragment: Fragment, number: int, row: int) -> tuple[Any, ...]:
    """Return the arguments of `predict_values` of a recurrent policy after a step of a row, beside the
    observation."""
    if "cell_states_vf" not in fragment.columns:
        return ()
    # The column has the memory before each step, which is the one after the previous step.
    if number + 1 < len(fragment.rewards):
        parts = [
            torch.from_numpy(fragment.columns[name][number + 1, row][:, None].copy())
            for name in _LSTM_BUFFERS[2:]
        ]
    else:
        parts = [part[:, row : row + 1].contiguous() for part in internals.memory(model).vf]
    return tuple(part.to(model.device) for part in parts), _floats(model, np.array([False]))


def _floats(model: Any, truths: Array) -> torch.Tensor:
    return torch.tensor(truths, dtype=torch.float32, device=model.device)


def prepared(model: Any, observations: Any) -> Any:
    """Return observations in the format of the policy, with the channels of pictures first."""
    return (
        model.env.transpose_observations(observations)
        if isinstance(model.env, VecTransposeImage)
        else observations
    )
