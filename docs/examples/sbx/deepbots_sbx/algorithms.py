"""The algorithms of sbx with their arrays as torch tensors, which is how deepbots stores and reads weights.

A model has two parts: `policy` holds the parameters of the networks, `learner` the optimizers, the random
keys and the entropy coefficient. Both have the `state_dict` and `load_state_dict` of torch.
"""

from typing import ClassVar

import flax.linen as nn
import jax
import numpy as np
import sbx
import torch
from flax.training.train_state import TrainState
from sbx.ppo.policies import PPOPolicy
from sbx.sac.policies import SACPolicy

ACTIVATIONS = {
    "ELU": nn.elu,
    "GELU": nn.gelu,
    "LeakyReLU": nn.leaky_relu,
    "ReLU": nn.relu,
    "SiLU": nn.silu,
    "Tanh": nn.tanh,
}


def to_tensors(tree):
    """The arrays of a tree by their path; JAX's unsigned random keys become int64, which torch can handle."""
    found = {}
    for path, leaf in jax.tree_util.tree_flatten_with_path(tree)[0]:
        array = np.array(jax.numpy.asarray(leaf))
        found[jax.tree_util.keystr(path)] = torch.from_numpy(
            array.astype(np.int64) if array.dtype == np.uint32 else array
        )
    return found


def from_tensors(tree, tensors):
    """A tree like `tree`, with the arrays of `to_tensors`."""
    paths, shape = jax.tree_util.tree_flatten_with_path(tree)
    leaves = [
        jax.numpy.asarray(tensors[jax.tree_util.keystr(p)].numpy(), jax.numpy.asarray(leaf).dtype)
        for p, leaf in paths
    ]
    return jax.tree_util.tree_unflatten(shape, leaves)


class Networks:
    """Mixed in before a policy of sbx: its parameters as a `state_dict`, and the activations of deepbots."""

    def __init__(self, *args, activation_fn=torch.nn.Tanh, **settings):
        super().__init__(*args, activation_fn=ACTIVATIONS[activation_fn.__name__], **settings)

    def states(self):
        return {name: value for name, value in vars(self).items() if isinstance(value, TrainState)}

    def _parameters_of(self, state):
        return {name: getattr(state, name) for name in ("params", "target_params") if hasattr(state, name)}

    def state_dict(self):
        return to_tensors({name: self._parameters_of(state) for name, state in self.states().items()})

    def load_state_dict(self, tensors):
        found = from_tensors(
            {name: self._parameters_of(state) for name, state in self.states().items()}, tensors
        )
        for name, state in self.states().items():
            self.__dict__[name] = state.replace(**found[name])


class Learner:
    """Everything else that the next update depends on."""

    def __init__(self, model):
        self.model = model

    def _tree(self):
        policy = self.model.policy
        optimizers = {
            name: {"step": state.step, "opt_state": state.opt_state}
            for name, state in policy.states().items()
        }
        keys = {"model": self.model.key, "policy": policy.key, "noise": policy.noise_key}
        return optimizers, keys, getattr(self.model, "ent_coef_state", None)

    def state_dict(self):
        return to_tensors(self._tree())

    def load_state_dict(self, tensors):
        optimizers, keys, entropy = from_tensors(self._tree(), tensors)
        policy = self.model.policy
        for name, state in policy.states().items():
            policy.__dict__[name] = state.replace(**optimizers[name])
        self.model.key, policy.key, policy.noise_key = keys["model"], keys["policy"], keys["noise"]
        if entropy is not None:
            self.model.ent_coef_state = entropy


class Stored:
    """Mixed in before an algorithm of sbx: names the parts to store."""

    def _setup_model(self):
        super()._setup_model()
        self.learner = Learner(self)

    def _get_torch_save_params(self):
        return ["policy", "learner"], []


class StoredPPOPolicy(Networks, PPOPolicy):
    """The policy of `JaxPPO`."""


class StoredSACPolicy(Networks, SACPolicy):
    """The policy of `JaxSAC`."""


class JaxPPO(Stored, sbx.PPO):
    """PPO of sbx."""

    policy_aliases: ClassVar = {"MlpPolicy": StoredPPOPolicy}


class JaxSAC(Stored, sbx.SAC):
    """SAC of sbx."""

    policy_aliases: ClassVar = {"MlpPolicy": StoredSACPolicy}
