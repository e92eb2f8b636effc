"""How the policy is trained: the `train` section, and whether its algorithm suits the task."""

from __future__ import annotations

from deepbots_cli.compiler.values import Values
from deepbots_cli.program.task import ActionRange, Agent, Choices, Truncation
from deepbots_cli.program.training import ActionNoise, Hindsight, Hyperparameter, Policy, Schedule, Training
from deepbots_cli.scenario.fields import read_schedule
from deepbots_cli.scenario.scenario import Scenario
from deepbots_cli.scenario.task import DiscreteAction
from deepbots_cli.scenario.training import ActionNoise as ActionNoiseSpec
from deepbots_cli.scenario.training import Hindsight as HindsightSpec

_ONE_CHOICE = frozenset({"DQN"})
_CHOICES = frozenset({"DQN", "MaskablePPO"})
_INTERVALS = frozenset({"SAC", "TD3", "DDPG", "TQC"})

Action = tuple[Choices | ActionRange, ...]


def training(spec: Scenario, values: Values, action: Action, agent: Agent, limits: Truncation, tick: float) -> Training | None:
    """The training section; `tick` is the timestep in s.

    An algorithm that cannot act in this action space is a finding, and so is hindsight without a goal, or before an episode can have ended.
    """
    if spec.train is None:
        return None
    _check_algorithm(spec, spec.train.algorithm, values, action)
    own = spec.train.hyperparameters
    figures = []
    for name, given in own.items():
        if name != "replay" and (isinstance(given, (bool, int, float, str)) or given is None):
            ramp = read_schedule(given) if isinstance(given, str) else None
            figures.append(Hyperparameter(name, Schedule(*ramp) if ramp else given))
    replay = _hindsight(own.get("replay"), spec, values)
    starts = own.get("learning_starts")
    if replay is not None and starts is not None and limits != Truncation():
        rows = spec.train.environments * (agent.each.count if agent.each else 1)
        longest = rows * limits.last_step(tick * agent.repeat)
        if starts < longest:
            headline = f"learning begins after {starts:_} steps, and no episode need have ended by then to take goals from"
            values.findings.add("DB105", values.span(("train", "learning_starts")), headline, help=f"give at least {longest:_}")
    return Training(
        spec.train.algorithm,
        spec.train.total_timesteps,
        spec.train.environments,
        tuple(figures),
        Policy(tuple(spec.train.policy.hidden), spec.train.policy.activation),
        _action_noise(own.get("action_noise")),
        replay,
    )


def _action_noise(given: ActionNoiseSpec | None) -> ActionNoise | None:
    if given is None:
        return None
    start, end = read_schedule(given.sigma) or (0.0, 0.0)  # the schema has read it before
    return ActionNoise(given.type, Schedule(start, end), given.theta)


def _hindsight(given: HindsightSpec | str | None, spec: Scenario, values: Values) -> Hindsight | None:
    if given is None or given == "uniform":
        return None
    if spec.goal is None and not values.is_lost("goal"):
        help = "add a `goal`, with what is achieved and what is desired, or take `replay` out"
        values.findings.add("DB102", values.span(("train", "replay")), "hindsight replay without a goal to make up", help=help)
    return Hindsight(given.n_sampled_goal, given.goal_selection_strategy) if isinstance(given, HindsightSpec) else Hindsight()


def _check_algorithm(spec: Scenario, algorithm: str, values: Values, action: Action) -> None:
    intervals = [part for part in action if isinstance(part, ActionRange)]
    if algorithm in _ONE_CHOICE and (intervals or len(action) > 1):
        headline, help = f"{algorithm} needs one choice as its action", "use PPO, or give the action as `choices`"
    elif algorithm in _CHOICES and intervals:
        headline, help = "a range, where `MaskablePPO` can only choose between options", "use PPO, or give the action as `choices`"
    elif algorithm in _INTERVALS and len(intervals) < len(action):
        headline, help = f"{algorithm} cannot choose between options", "use PPO or DQN, or give the action as a range"
    elif intervals and len(intervals) < len(action):
        headline, help = "no algorithm acts by both choices and ranges", "give the ranges as choices, or the choices as ranges"
    elif algorithm != "MaskablePPO" and any(isinstance(part, DiscreteAction) and part.forbid for part in spec.action.values()):
        headline, help = f"{algorithm} does not heed what `forbid` forbids", "use MaskablePPO, or take `forbid` out"
    else:
        return
    values.findings.add("DB612", values.span(("train", "algorithm")), headline, help=help)
