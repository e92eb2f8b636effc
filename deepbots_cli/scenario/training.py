"""Training of the policy, and its curriculum: stages for all worlds, or a level for each world.

Each algorithm has one model, whose hyperparameters have the names of Stable-Baselines3 and sb3-contrib. A
test compares them with the signatures there. Devices, seeds, classes of buffers and loggers are left out;
`SET_ELSEWHERE_HELP` has the places where they are set instead.
"""

from collections import ChainMap
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, Field

from deepbots_cli.plugins import PluginTable
from deepbots_cli.records import dataclass
from deepbots_cli.scenario.base import FORMS, Kinds, Many, Section, Size, check_kind_model, kind_of
from deepbots_cli.scenario.fields import Bool, LocalName, PlainText, Reference, Scalar, Text, error
from deepbots_cli.scenario.quantities import (
    Bounds,
    Fraction,
    Number,
    PositiveInt,
    Range,
    Schedule,
    Setting,
    Until,
    WholeNumber,
)

MAX_ENVIRONMENTS = 1024
MAX_SHARDS = 256
AUTO = "auto"
"""The algorithm of a `train` section that names none: deepbots chooses it."""
NonNegative = Annotated[float, Number(0)]
Positive = Annotated[float, Number(0, exclusive=True)]
StepsOrEpisodes = WholeNumber(
    1,
    1_000_000_000,
    pattern="[1-9][0-9]{0,8} (?:step|episode)s?",
    noun="a number of steps or episodes",
    example="1 episode",
)

_AUTO_FROM = r"auto(?:_(?=[0-9.]*[1-9])[0-9]+(?:\.[0-9]+)?)?"
"""`auto`, or `auto_` with a first value above 0."""
WORD = Text(
    "a word of a name",
    r"[A-Za-z0-9](?:[A-Za-z0-9_]{0,62}[A-Za-z0-9])?",
    "left",
    role="a word of a name",
    help="write the part of the names by which the sides differ, such as `FL` of `FL_hip_joint`",
)

SET_ELSEWHERE_HELP: Mapping[str, str] = {
    "seed": "set it on the command line: `deepbots train --seed 1`",
    "verbose": "set it on the command line: `deepbots train --quiet`",
    "tensorboard_log": "remove it: every run writes its TensorBoard log into its own directory",
    "policy": "remove it: deepbots chooses the policy class; `network: {hidden: [64, 64]}` sets its layers",
    "policy_kwargs": "write `network: {hidden: [64, 64], activation: tanh}`",
    "net_arch": "write `network: {hidden: [64, 64]}`",
    **dict.fromkeys(
        ("hidden_dims", "actor_hidden_dims", "critic_hidden_dims"),
        "write `network: {hidden: [512, 256, 128]}`",
    ),
    "max_iterations": "write `total_timesteps`: `max_iterations` * `environments` * the steps of each"
    " environment",
    "replay_buffer_class": "write `replay: her`",
    "replay_buffer_kwargs": "write `replay: {type: her, n_sampled_goal: 4}`",
    "lstm_hidden_size": "write `lstm: 64`",
    "optimize_memory_usage": "remove it: Stable-Baselines3 refuses it where episodes are truncated",
    **dict.fromkeys(
        ("episodes", "n_episodes"),
        "write the number of steps, for example `total_timesteps: 100_000`: deepbots counts the steps of a"
        " training, not its episodes, and each episode has at most those of `truncation`",
    ),
}
"""Hyperparameters of other tools, and where they are set here."""


def _not_zero(value: int) -> int:
    if value == 0:
        raise error("DB105", "`0` has no meaning here", "write -1, or a number of at least 1")
    return value


StepsOrAll = Annotated[int, WholeNumber(-1, 1_000_000_000), AfterValidator(_not_zero)]


class ActionNoise(Section):
    """Noise on actions during training."""

    type: Literal["normal", "ornstein_uhlenbeck"]
    """Kind of noise: independent in each step (`normal`), or correlated in time (`ornstein_uhlenbeck`)."""
    sigma: Schedule
    """Standard deviation, where actions are in [-1, 1]: a number, or a schedule such as `0.5 -> 0.1`."""
    theta: Positive = 0.15
    """How fast Ornstein-Uhlenbeck noise decays: by the factor `exp(-theta)` in each step."""


class Hindsight(Section):
    """Hindsight experience replay, for a scenario with a `goal`."""

    type: Literal["her"]
    """The kind of replay."""
    n_sampled_goal: PositiveInt = 4
    """Number of additional transitions with a sampled goal for each real transition."""
    goal_selection_strategy: Literal["future", "final", "episode"] = "future"
    """Which achieved goals of the same episode are sampled: of this or a later step (`future`), of the last
    step (`final`), or of any step (`episode`)."""


class Teacher(Section):
    """A script that teaches the policy."""

    script: PlainText
    """Name of a script of the scenario. It may use values that the policy does not observe."""
    share: Fraction = 0.3
    """Largest share of the timesteps in which the policy only imitates the script. With DQN, the script
    drives during a third of these timesteps."""


class SelfPlay(Section):
    """One policy for two equal agents, which plays against itself and against past versions of itself."""

    every: Annotated[int, WholeNumber(1, 10**12)] | None = None
    """Number of timesteps after which the present policy becomes a member of the pool. Default: a twentieth
    of `total_timesteps`."""
    pool: Annotated[int, WholeNumber(1, 100)] = 10
    """Largest number of past policies in the pool. A new one replaces the oldest."""
    newest: Fraction = 0.5
    """Share of the environments in which the policy plays against itself, and learns from both sides. In the
    others it plays against a random member of the pool."""
    scripts: Fraction = 0.0
    """Share of the environments in which the policy plays against a random script of the other agent."""


MAX_LAYERS = 16
MAX_WEIGHTS = 50_000_000  # per network; with gradients and moments, actor and critic then take 1.6 GB


class PolicyNetwork(Section):
    """The network of the policy."""

    hidden: Many[Annotated[int, WholeNumber(1, 8192)]] = (64, 64)
    """Units of each hidden layer, such as `[64, 64]`."""
    activation: Literal["tanh", "relu", "elu", "leaky_relu", "gelu", "silu"] = "tanh"
    """Activation function of the hidden layers."""


class AdaptiveRate(Section):
    """A learning rate that follows the divergence of the policy."""

    kl: Positive
    """Target of the KL divergence between the policies before and after an update. After an update with more
    than twice the target, the rate is divided by 1.5; with less than half the target, it is multiplied by
    1.5. It stays from 1e-5 to 1e-2."""
    start: Positive = 1e-3
    """Learning rate of the first update."""


class Symmetry(Section):
    """The mirror symmetry of a robot and its task, from which a policy learns twice as much: each sample of a
    rollout has a mirror image."""

    swap: dict[Annotated[str, WORD], Annotated[str, WORD]] = {}
    """Words that change places in names: with `{FL: FR}`, `dog.q.FL_hip_joint` is the mirror image of
    `dog.q.FR_hip_joint`. A word ends at `_`, at `.` and at the ends of a name."""
    flip: Many[PlainText] = ()
    """Numbers of the observation and the action that change their sign, by name or by pattern: `wz`, `v.y`,
    `'*_hip_joint'`. The previous action has the sign of the action."""


AnyRate = Annotated[AdaptiveRate | Schedule, FORMS]


class Training(Section):
    """Keys of all algorithms; each adds its hyperparameters."""

    import_path: ClassVar[str] = ""
    """`module:attribute` of its class, imported when it is used: an algorithm of the library where the model
    is a built-in one or derived from one, else a `deepbots_cli.learning.learner.Learner`."""
    on_policy: ClassVar[bool] = False
    imitates: ClassVar[bool] = False
    """Whether its policy can be fitted to the actions of a script."""
    acts_by: ClassVar[frozenset[Literal["choice", "choices", "ranges"]]] = frozenset(
        {"choice", "choices", "ranges"}
    )
    """The actions that it can take: one choice, several choices, ranges."""
    uses_masks: ClassVar[bool] = False
    """Whether the policy never takes a choice that `forbid` excludes."""
    is_recurrent: ClassVar[bool] = False
    """Whether its policy has a memory."""
    mirrors: ClassVar[bool] = False
    """Whether it can learn from mirror images (`symmetry`)."""
    has_critic: ClassVar[bool] = False
    """Whether it has a value function beside the policy, which may see more (`critic` of a scenario)."""

    algorithm: PlainText
    """The learning algorithm."""
    total_timesteps: Annotated[int, WholeNumber(1, 10**12)]
    """Number of steps to train for, summed over all environments."""
    environments: Annotated[int, WholeNumber(1, MAX_ENVIRONMENTS)] = 1
    """Number of environments that run at the same time."""
    shards: Annotated[int, WholeNumber(1, MAX_SHARDS)] = 1
    """Number of groups of environments, each with a copy of the policy."""
    staleness: Annotated[int, WholeNumber(0, 1)] = 0
    """Age of the weights with which shards collect, in updates. With 1, shards on workers collect the next
    steps during an update."""
    network: PolicyNetwork = Field(default_factory=PolicyNetwork)
    """The network of the policy."""
    patience: Annotated[int, WholeNumber(1, 10**12)] | None = None
    """Number of timesteps without a better evaluation after which the training ends. Default: it does not end
    before the last."""
    normalize: Literal["reward"] | None = None
    """`reward` divides rewards by a running standard deviation of the return, for learning only; logs show
    the original rewards."""
    teacher: Annotated[Teacher | PlainText, FORMS] | None = None
    """A script that teaches the policy."""
    self_play: SelfPlay | None = None
    """Train one policy for two equal agents, against itself and past versions of itself."""
    turns: Annotated[int, WholeNumber(1, 10**12)] | None = None
    """With several agents that are trained together: number of timesteps for which one of them learns, before
    it is the turn of the next one. Default: all learn all the time."""
    symmetry: Symmetry | None = None
    """The mirror symmetry of the task: the policy also learns from the mirror image of each step."""
    device: Literal["auto", "cpu", "cuda"] = "cpu"
    """Device of the networks. `auto` is `cuda` (a GPU) if there is one, otherwise `cpu`. Small networks train
    faster on the CPU."""

    @classmethod
    def hyperparameter_names(cls) -> tuple[str, ...]:
        """Return the algorithm's own parameters."""
        return tuple(name for name in cls.model_fields if name not in Training.model_fields)

    @classmethod
    def base(cls) -> str:
        """Return the built-in algorithm that it is, or is derived from; its own name if it brings its own
        learner."""
        return next(
            (model.__name__ for model in cls.__mro__ if model in _BUILT_IN), kind_of(cls, "algorithm")
        )

    @classmethod
    def is_derived(cls) -> bool:
        """Return whether it is a built-in algorithm, or derived from one."""
        return issubclass(cls, _BUILT_IN)

    @property
    def hyperparameters(self) -> Mapping[str, Any]:
        """The hyperparameters that the user set, or that the model of a plug-in has a default for, in the
        order of the model."""
        names = self.hyperparameter_names()
        return {
            name: getattr(self, name)
            for name in names
            if name in self.model_fields_set or getattr(self, name) is not None
        }


class _OnPolicy(Training):
    on_policy = True
    imitates = True
    has_critic = True

    learning_rate: Schedule | None = None
    """Learning rate: a number, or a schedule such as `3e-4 -> 0`."""
    n_steps: PositiveInt | None = None
    """Steps of each environment between two updates."""
    gamma: Fraction | None = None
    """Discount factor, 0 to 1: a reward that comes n steps later has the weight gamma^n."""
    gae_lambda: Fraction | None = None
    """Lambda of generalized advantage estimation (GAE), 0 to 1: a trade-off between bias and variance."""
    normalize_advantage: Bool | None = None
    """Whether advantages are normalized."""
    ent_coef: NonNegative | None = None
    """Weight of the entropy in the loss: a higher weight means more exploration."""
    vf_coef: NonNegative | None = None
    """Weight of the value function in the loss."""
    max_grad_norm: Positive | None = None
    """Largest norm of a gradient; larger gradients are scaled down."""
    stats_window_size: PositiveInt | None = None
    """Episodes in the moving averages that Stable-Baselines3 logs."""


class _Proximal(_OnPolicy):
    learning_rate: AnyRate | None = None  # type: ignore[assignment]  # takes more
    """Learning rate: a number, a schedule such as `3e-4 -> 0`, or `{kl: 0.01}` for a rate that follows the KL
    divergence of the policy."""
    batch_size: Annotated[int, WholeNumber(2, 1_000_000_000)] | None = None
    """Samples in one gradient step."""
    n_epochs: PositiveInt | None = None
    """Passes over the samples of a rollout."""
    clip_range: Schedule | None = None
    """Limit on the change of the policy in one update: a number or a schedule."""
    clip_range_vf: Schedule | None = None
    """Limit on the change of the value function in one update: a number or a schedule."""
    target_kl: Positive | None = None
    """Limit on the KL divergence between the old and the new policy: an update stops early beyond 1.5 times
    this value."""


class _StateDependentExploration(Section):
    use_sde: Bool | None = None
    """Whether to explore with noise that depends on the state (gSDE) instead of independent noise in each
    step."""
    sde_sample_freq: StepsOrAll | None = None
    """Steps between two draws of the noise of `use_sde`; -1 draws once per rollout."""


class _GaussianActions(_StateDependentExploration):
    init_std: Positive | None = None
    """Initial standard deviation of the ranges of the action, where a range is from -1 to 1. A smaller value
    suits robots that fall easily."""


class _OffPolicy(Training):
    learning_rate: Schedule | None = None
    """Learning rate: a number, or a schedule such as `3e-4 -> 0`."""
    buffer_size: PositiveInt | None = None
    """Size of the replay buffer, in steps."""
    learning_starts: Annotated[int, WholeNumber(0, 1_000_000_000)] | None = None
    """Steps before the first update."""
    batch_size: PositiveInt | None = None
    """Samples in one gradient step."""
    tau: Fraction | None = None
    """Coefficient of the soft update of the target network, 0 to 1; 1 copies the network."""
    gamma: Fraction | None = None
    """Discount factor, 0 to 1: a reward that comes n steps later has the weight gamma^n."""
    train_freq: Annotated[str | int, StepsOrEpisodes] | None = None
    """Steps between two updates, or `1 episode`."""
    gradient_steps: StepsOrAll | None = None
    """Gradient steps in an update; -1 makes as many as there were steps since the last update."""
    n_steps: PositiveInt | None = None
    """n of n-step returns: number of rewards that are summed before the value estimate is added."""
    replay: Annotated[Hindsight | Literal["uniform", "her"], FORMS] | None = None
    """How steps are sampled from the replay buffer: `uniform`, or `her` for hindsight experience replay."""


class _Deterministic(_OffPolicy):
    imitates = True
    has_critic = True
    acts_by = frozenset({"ranges"})

    action_noise: ActionNoise | None = None
    """Noise on actions during training."""


class _SoftActorCritic(_StateDependentExploration, _Deterministic):
    use_sde_at_warmup: Bool | None = None
    """Whether to use state-dependent noise (`use_sde`) also before learning starts."""
    ent_coef: Annotated[Scalar, Number(0, pattern=_AUTO_FROM)] | None = None
    """Weight of the entropy in the loss. `auto` learns it; `auto_0.1` learns it from the initial value
    0.1."""
    target_update_interval: PositiveInt | None = None
    """Steps between two updates of the target network."""
    target_entropy: Annotated[Scalar, Number(pattern="auto")] | None = None
    """The entropy that `ent_coef: auto` aims at. `target_entropy: auto` is minus the number of action
    components."""
    stats_window_size: PositiveInt | None = None
    """Episodes in the moving averages that Stable-Baselines3 logs."""


class PPO(_GaussianActions, _Proximal):
    """On-policy; choices or ranges. The first to try."""

    import_path = "stable_baselines3:PPO"
    mirrors = True

    algorithm: Literal["PPO"]


class A2C(_GaussianActions, _OnPolicy):
    """On-policy; choices or ranges. Simpler than PPO."""

    import_path = "stable_baselines3:A2C"
    mirrors = True

    algorithm: Literal["A2C"]
    rms_prop_eps: Positive | None = None
    """Epsilon of RMSprop, which avoids a division by zero."""
    use_rms_prop: Bool | None = None
    """Whether to use RMSprop instead of Adam."""


class DQN(_OffPolicy):
    """Off-policy; one choice."""

    import_path = "stable_baselines3:DQN"
    acts_by = frozenset({"choice"})

    algorithm: Literal["DQN"]
    target_update_interval: PositiveInt | None = None
    """Steps between two updates of the target network."""
    exploration_fraction: Fraction | None = None
    """Fraction of the training during which the probability of a random action decreases."""
    exploration_initial_eps: Fraction | None = None
    """Initial probability of a random action."""
    exploration_final_eps: Fraction | None = None
    """Final probability of a random action."""
    max_grad_norm: Positive | None = None
    """Largest norm of a gradient; larger gradients are scaled down."""
    stats_window_size: PositiveInt | None = None
    """Episodes in the moving averages that Stable-Baselines3 logs."""


class SAC(_SoftActorCritic):
    """Off-policy; ranges. Maximizes return and entropy."""

    import_path = "stable_baselines3:SAC"

    algorithm: Literal["SAC"]


class TD3(_Deterministic):
    """Off-policy; ranges. DDPG with two critics and delayed updates."""

    import_path = "stable_baselines3:TD3"

    algorithm: Literal["TD3"]
    policy_delay: PositiveInt | None = None
    """Number of critic updates per actor update."""
    target_policy_noise: NonNegative | None = None
    """Standard deviation of the noise on the action of the target policy."""
    target_noise_clip: NonNegative | None = None
    """Largest absolute value of the noise of `target_policy_noise`."""
    stats_window_size: PositiveInt | None = None
    """Episodes in the moving averages that Stable-Baselines3 logs."""


class DDPG(_Deterministic):
    """Off-policy; ranges."""

    import_path = "stable_baselines3:DDPG"

    algorithm: Literal["DDPG"]


class MaskablePPO(_Proximal):
    """PPO that never takes forbidden choices."""

    import_path = "sb3_contrib:MaskablePPO"
    acts_by = frozenset({"choice", "choices"})
    uses_masks = True

    algorithm: Literal["MaskablePPO"]


class RecurrentPPO(_GaussianActions, _Proximal):
    """PPO with a memory (LSTM); choices or ranges."""

    import_path = "sb3_contrib:RecurrentPPO"
    is_recurrent = True

    algorithm: Literal["RecurrentPPO"]
    lstm: Annotated[int, WholeNumber(1, 2048)] | None = None
    """Units of the LSTM layers before the hidden layers of actor and critic."""


class TQC(_SoftActorCritic):
    """Off-policy; ranges. SAC with critics of many quantiles."""

    import_path = "sb3_contrib:TQC"

    algorithm: Literal["TQC"]
    top_quantiles_to_drop_per_net: Annotated[int, WholeNumber(0, 1_000_000_000)] | None = None
    """Number of highest quantiles to drop per critic."""


class Auto(SAC, PPO, MaskablePPO):  # type: ignore[misc]  # `ent_coef` is that of SAC, which takes more
    """deepbots chooses the algorithm, and every key that is not given, by the structure of the scenario."""

    import_path = ""
    acts_by = Training.acts_by

    algorithm: Literal["auto"] = "auto"  # type: ignore[assignment]  # the word of none of its bases
    """The learning algorithm. By default, deepbots chooses it."""
    # The number of steps is chosen as well.
    total_timesteps: Annotated[int, WholeNumber(1, 10**12)] | None = None  # type: ignore[assignment]
    """Number of steps to train for, summed over all environments."""
    learning_rate: AnyRate | None = None  # type: ignore[assignment]  # that of PPO, which takes more
    """Learning rate: a number, a schedule such as `3e-4 -> 0`, or `{kl: 0.01}` for a rate that follows the KL
    divergence of the policy."""


def _checked_model(name: str, model: Any) -> Iterator[tuple[str, type[Training]]]:
    """Yield the model that an entry point names.

    Raises:
        ValueError: It is not a model of an algorithm, or lacks something.
    """
    if not (isinstance(model, type) and issubclass(model, Training)):
        built_in = ", ".join(built_in.__name__ for built_in in _BUILT_IN)
        raise ValueError(f"{model!r} is derived from none of {built_in}, nor from Training itself")
    check_kind_model(name, model, model.import_path, "algorithm")
    yield name, model


_BUILT_IN = (PPO, A2C, DQN, SAC, TD3, DDPG, MaskablePPO, RecurrentPPO, TQC)
ALGORITHMS: PluginTable[type[Training]] = PluginTable(
    "deepbots.algorithms", {model.__name__: model for model in _BUILT_IN}, _checked_model
)
_GONE = {
    "rsl_rl.PPO": "write `algorithm: PPO, learning_rate: {kl: 0.01}`, with the hyperparameters of `PPO`",
}
# A union of both tables would list all names, and so load the packages of all plug-ins.
AnyTraining = Annotated[
    Training, Kinds("algorithm", ChainMap({AUTO: Auto}, ALGORITHMS), default=AUTO, gone=_GONE)
]


MAX_LEVELS = 100

EndingName = Annotated[str, Reference("ending")]
EndingNames = Annotated[Annotated[Many[EndingName], Size(1, "ending")] | EndingName, FORMS]


@dataclass(frozen=True)
class FirstLevels(Bounds):
    """A level, or the lowest and the highest of several."""

    noun = "a level or a range of levels"
    example = "0 .. 2"


Settings = dict[
    Annotated[str, Reference("setting")],
    Annotated[str | int | float | bool | dict[str, object] | list[object], Setting()],
]


class Stage(Section):
    """A stage of the curriculum."""

    name: LocalName
    """Name of the stage."""
    set: Settings = {}
    """Changes: parameters by name, or other values by path, such as `reset.layout: paper`."""
    until: Annotated[str, Until()] | None = None
    """When this stage ends: `success_rate >= 0.7 over 40 episodes` (training episodes), `success_rate >= 0.7
    in evaluation` (without exploration), or `50_000 steps` (of this stage). `mean_return` can replace
    `success_rate`."""


class Levels(Section):
    """A level for each world of a training, from 0, the easiest, up. A world is one level higher or lower
    after an episode, by how the episode ended."""

    set: Annotated[
        dict[Annotated[str, Reference("parameter")], Annotated[str, Range("any")]], Size(1, "parameter")
    ]
    """Parameters, each with its value in the lowest and in the highest level, such as `0 .. 9`. The levels
    divide the range evenly. The scenario draws the parameter at random, such as `integer(0 .. 9)`: an
    evaluation has all levels."""
    levels: Annotated[int, WholeNumber(2, MAX_LEVELS)]
    """Number of levels."""
    per_world: Annotated[str, Reference("parameter")] | None = None
    """A parameter that has one value in each world for the whole training, such as the kind of a tile: hard
    kinds do not hold back easy ones. The scenario draws it from whole numbers or choices, such as
    `integer(0 .. 5)`, and the worlds have these values in turn. Default: each episode draws it."""
    start: Annotated[Scalar, FirstLevels()] = 0
    """The level in which each world begins, or a range that the worlds divide evenly, such as `0 .. 2`."""
    up: EndingNames
    """Endings after which the next episode of the world is one level higher: names of endings and limits, or
    `success`, `failure`, `termination`, `truncation` for all of them."""
    down: EndingNames | None = None
    """Endings after which it is one level lower. After all other endings the level stays. Default: none."""
    at_top: Literal["stay", "random"] = "stay"
    """The level after `up` in the highest one. `stay`: the same. `random`: one of all levels, at random."""
