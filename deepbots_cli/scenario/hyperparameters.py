"""The algorithms, and the hyperparameters of each under their own names.

The table follows the signatures of Stable-Baselines3 and sb3-contrib, which a test compares. What is not a
figure of the algorithm (devices, seeds, buffers' classes, loggers) is left out; `ELSEWHERE` says where it went.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from deepbots_cli.scenario.part import FORMS, Part, field
from deepbots_cli.scenario.plain import Count, Fraction, Frequency, Real, Schedule, Word
from deepbots_cli.scenario.quantity import OnOff, Whole

Ramp = Annotated[str | int | float, Schedule()]
Weight = Annotated[float, Real(0)]
Share = Annotated[str | int | float, Fraction()]
Positive = Annotated[float, Real(0, exclusive=True)]


class ActionNoise(Part):
    """Noise on the actions while training."""

    type: Annotated[Literal["normal", "ornstein_uhlenbeck"], Word()] = field(
        description="Independent (`normal`) or drifting (`ornstein_uhlenbeck`)."
    )
    sigma: Ramp = field(description="Standard deviation in the agent's [-1, 1], or a schedule such as `0.5 -> 0.1`.")
    theta: Positive = field(default=0.15, description="How fast drifting noise returns to zero: by the factor `exp(-theta)` in a step.")


class Hindsight(Part):
    """Hindsight experience replay, for a scenario with a `goal`."""

    type: Annotated[Literal["her"], Word()] = field(description="The kind of replay.")
    n_sampled_goal: Whole = field(default=4, description="Goals that are made up for each step.")
    goal_selection_strategy: Annotated[Literal["future", "final", "episode"], Word()] = field(
        default="future", description="Where they come from: later in the episode, its end, or anywhere in it."
    )


@dataclass(frozen=True)
class Hyperparameter:
    """What may be written for it, and one sentence for the editor."""

    annotation: Any
    description: str


_STEPS_OR_ALL = Annotated[int, Count(minimum=-1)]
_AUTO = Annotated[str | int | float, Real(text="auto")]
_RATE = Hyperparameter(Ramp, "Learning rate: a number, or a schedule such as `3e-4 -> 0`.")
_GAMMA = Hyperparameter(Share, "Discount of later rewards per step, 0 to 1.")
_WINDOW = Hyperparameter(Whole, "Episodes over which progress is averaged.")
_BATCH = Hyperparameter(Annotated[int, Count(minimum=2)], "Samples in one gradient step.")
_CLIP = Hyperparameter(Positive, "Largest norm of a gradient; larger ones are scaled down.")
_SDE = {
    "use_sde": Hyperparameter(OnOff, "Explore by noise that depends on the state instead of noise per step."),
    "sde_sample_freq": Hyperparameter(_STEPS_OR_ALL, "Steps between two draws of that noise; -1 draws once per roll-out."),
}
_SDE_WARMUP = {"use_sde_at_warmup": Hyperparameter(OnOff, "Use that noise already before learning starts.")}

_ON_POLICY = {
    "learning_rate": _RATE,
    "n_steps": Hyperparameter(Whole, "Steps of each environment between two updates."),
    "gamma": _GAMMA,
    "gae_lambda": Hyperparameter(Share, "Trade-off of bias and variance of the advantage, 0 to 1."),
    "normalize_advantage": Hyperparameter(OnOff, "Whether advantages are normalised."),
    "ent_coef": Hyperparameter(Weight, "Weight of the entropy: higher explores more."),
    "vf_coef": Hyperparameter(Weight, "Weight of the value function in the loss."),
    "max_grad_norm": _CLIP,
    "stats_window_size": _WINDOW,
}
_PROXIMAL = _ON_POLICY | {
    "batch_size": _BATCH,
    "n_epochs": Hyperparameter(Whole, "Passes over the samples of a roll-out."),
    "clip_range": Hyperparameter(Ramp, "How far the policy may change in one update; a number or a schedule."),
    "clip_range_vf": Hyperparameter(Ramp, "How far the value function may change in one update; a number or a schedule."),
    "target_kl": Hyperparameter(Positive, "Stops an update when the policy has changed this much."),
}
_OFF_POLICY = {
    "learning_rate": _RATE,
    "buffer_size": Hyperparameter(Whole, "Steps that are remembered."),
    "learning_starts": Hyperparameter(Annotated[int, Count(minimum=0)], "Steps before the first update."),
    "batch_size": Hyperparameter(Whole, "Samples in one gradient step."),
    "tau": Hyperparameter(Share, "Share by which the target network follows, 0 to 1."),
    "gamma": _GAMMA,
    "train_freq": Hyperparameter(Annotated[str | int, Frequency()], "Steps between two updates, or `1 episode`."),
    "gradient_steps": Hyperparameter(_STEPS_OR_ALL, "Gradient steps in an update; -1 makes as many as steps were taken."),
    "optimize_memory_usage": Hyperparameter(OnOff, "Keep each observation once instead of twice."),
    "n_steps": Hyperparameter(Whole, "Steps over which a return is summed before it is estimated."),
    "replay": Hyperparameter(
        Annotated[Hindsight | Annotated[Literal["uniform", "her"], Word()], FORMS],
        "How remembered steps are drawn: `uniform`, or `her` for goals.",
    ),
}
_ACTOR = _OFF_POLICY | {"action_noise": Hyperparameter(ActionNoise, "Noise on the actions while training.")}
_DELAYED = {
    "policy_delay": Hyperparameter(Whole, "Updates of the critics for one of the actor."),
    "target_policy_noise": Hyperparameter(Weight, "Standard deviation of the noise on the target's action."),
    "target_noise_clip": Hyperparameter(Weight, "Largest such noise."),
    "stats_window_size": _WINDOW,
}
_TARGET = Hyperparameter(Whole, "Steps between two updates of the target network.")
_SOFT = (
    _ACTOR
    | _SDE
    | _SDE_WARMUP
    | {
        "ent_coef": Hyperparameter(
            Annotated[str | int | float, Real(0, text=r"auto(_\d+(\.\d+)?)?")],
            "Weight of the entropy; `auto` learns it, `auto_0.1` from that on.",
        ),
        "target_update_interval": _TARGET,
        "target_entropy": Hyperparameter(_AUTO, "The entropy that `ent_coef: auto` aims at."),
        "stats_window_size": _WINDOW,
    }
)

ALGORITHMS: Mapping[str, Mapping[str, Hyperparameter]] = {
    "PPO": _PROXIMAL | _SDE,
    "A2C": _ON_POLICY
    | _SDE
    | {
        "rms_prop_eps": Hyperparameter(Positive, "Guards RMSprop against division by zero."),
        "use_rms_prop": Hyperparameter(OnOff, "RMSprop instead of Adam."),
    },
    "DQN": _OFF_POLICY
    | {
        "target_update_interval": _TARGET,
        "exploration_fraction": Hyperparameter(Share, "Share of the training over which exploration goes down."),
        "exploration_initial_eps": Hyperparameter(Share, "Share of random actions at the start."),
        "exploration_final_eps": Hyperparameter(Share, "Share of random actions in the end."),
        "max_grad_norm": _CLIP,
        "stats_window_size": _WINDOW,
    },
    "SAC": _SOFT,
    "TD3": _ACTOR | _DELAYED,
    "DDPG": _ACTOR,
    "MaskablePPO": _PROXIMAL,
    "RecurrentPPO": _PROXIMAL
    | _SDE
    | {
        "lstm": Hyperparameter(
            Annotated[int, Count(maximum=2048)], "Units of the memory: an LSTM before the layers of actor and of critic."
        )
    },
    "TQC": _SOFT
    | {"top_quantiles_to_drop_per_net": Hyperparameter(Annotated[int, Count(minimum=0)], "Highest quantiles to drop, per critic.")},
}

ELSEWHERE: Mapping[str, str] = {
    "seed": "give it when you train: `--seed 1`",
    "device": "small networks train on the processor; there is nothing to choose",
    "verbose": "give it when you train: `--quiet`",
    "tensorboard_log": "every run writes its TensorBoard log into its own directory",
    "policy_kwargs": "write `policy: {hidden: [64, 64], activation: tanh}`",
    "net_arch": "write `policy: {hidden: [64, 64]}`",
    "replay_buffer_class": "write `replay: her`",
    "replay_buffer_kwargs": "write `replay: {type: her, n_sampled_goal: 4}`",
    "lstm_hidden_size": "write `lstm: 64`",
    "n_envs": "write `environments`",
}
