"""The sections of the evaluation, of `tune`, and of the tests of a scenario."""

from typing import Annotated, Any, ClassVar, Literal

from deepbots_cli.scenario.agent import AgentName, Choice
from deepbots_cli.scenario.base import FORMS, KeyCount, Many, Section, Size
from deepbots_cli.scenario.fields.base import Scalar
from deepbots_cli.scenario.fields.names import Bool, LocalName, Reference
from deepbots_cli.scenario.fields.quantities import Bounds, Expression, PositiveInt, Quantity, WholeNumber
from deepbots_cli.scenario.search import SearchField
from deepbots_cli.scenario.training import EndingNames, Settings


class Case(Section):
    """One case of the evaluation."""

    set: Settings = {}
    """Changes: parameters by name, or other values by path."""
    episodes: PositiveInt | None = None
    """Number of episodes of this case."""


class Evaluation(Section):
    """Evaluation of a trained policy."""

    episodes: PositiveInt = 100
    """Number of episodes, for each case."""
    cases: dict[LocalName, Case] = {}
    """Further conditions under which the policy is evaluated, each under a name that you choose."""


class Tune(Section):
    """A search for better values, for `deepbots tune`. An option of the command replaces the key of the same
    name."""

    search: Annotated[
        dict[Annotated[str, Reference("setting")], Annotated[str | Many[Any], SearchField()]], Size(1, "key")
    ]
    """The values to try: parameters by name, or other values by path. Each has a range, such as `0.5 .. 1.5
    m`, or choices, such as `64 | 128` or `[[64, 64], [10, 10]]`. Values of `1e-4 .. 1e-2 :log` are drawn by
    their logarithm."""
    trials: Annotated[int, WholeNumber(1, 100_000)] = 40
    """Number of trials. A trial trains the scenario with one set of values, once for each seed."""
    seeds: Annotated[int, WholeNumber(1, 1000)] = 3
    """Number of seeds of each trial, counted from 0."""
    timesteps: Annotated[int, WholeNumber(1, 10**12)] | None = None
    """Number of steps of each training. Default: `train.total_timesteps`."""
    objective: Literal["solved", "success_rate", "mean_return"] | None = None
    """What makes a trial good. `solved`: few steps until the task is solved. `success_rate`, `mean_return`:
    those of the evaluation of the best models. Default: `solved` where the scenario has the key `solved`,
    else `success_rate` where it defines success."""
    prune: Bool = True
    """Whether a trial ends early while its evaluations are worse than the median of other trials after as
    many steps."""


# Tests

DriverName = Annotated[str, Reference("driver")]
FixedAction = dict[
    Annotated[str, Reference("action")],
    Annotated[dict[Annotated[str, Reference("choice")], Choice] | Choice, FORMS],
]
Requirement = Annotated[str, Expression("test", boolean=True)]
Requirements = Annotated[Annotated[Many[Requirement], Size(1, "condition")] | Requirement, FORMS]


class Expectation(Section):
    """Results that a test expects. The test passes if all of them are met."""

    key_rules: ClassVar[tuple[KeyCount, ...]] = (
        KeyCount(
            ("success_rate", "failure_rate", "mean_return", "ends_by", "always", "eventually"), min=1, max=6
        ),
    )

    success_rate: Annotated[Scalar, Bounds()] | None = None
    """Fraction of successful episodes: a minimum, or a range."""
    failure_rate: Annotated[Scalar, Bounds()] | None = None
    """Fraction of episodes that end by a failure: a minimum, or a range."""
    mean_return: Annotated[Scalar, Bounds()] | None = None
    """Mean return of the episodes: a minimum, or a range."""
    ends_by: EndingNames | None = None
    """The allowed endings and limits: each episode must end by one of them."""
    always: Requirements | None = None
    """Conditions that must be true after every step."""
    eventually: Requirements | None = None
    """Conditions, each of which must be true after at least one step of every episode."""


class ScenarioTest(Section):
    """Episodes without a trained policy, and their expected result."""

    key_rules: ClassVar[tuple[KeyCount, ...]] = (
        KeyCount(("driver", "actions"), min=1),
        KeyCount(("case", "stage")),
    )

    agent: AgentName | None = None
    """With several agents, the one whose results are expected, and whose names conditions may use. Default:
    the first one."""
    driver: Annotated[dict[AgentName, Annotated[str, Reference("driver")]] | DriverName, FORMS] | None = None
    """Who acts: a script, `random`, or `zero` (the middle of each range and the first option of each choice);
    or who acts for each of several agents."""
    actions: Annotated[Many[Annotated[FixedAction | Choice, FORMS]], Size(1, "action")] | None = None
    """Actions of the first steps; the episode stops after the last of them. With several agents, the action
    of each: `{hunter: {gas: 1}, prey: {gas: 0}}`; an agent without one does nothing in this step."""
    episodes: Annotated[int, WholeNumber(1, 1000)] = 1
    """Number of episodes."""
    seed: Annotated[int, WholeNumber(0, 1_000_000_000)] = 0
    """Seed of the test. Its episodes start like the episodes of an evaluation with this seed."""
    max_steps: PositiveInt | None = None
    """Number of steps after which an episode stops."""
    max_time: Annotated[Scalar, Quantity("time", minimum=0, exclusive=True)] | None = None
    """Simulated time after which an episode stops."""
    case: Annotated[str, Reference("case")] | None = None
    """Case of `evaluation` whose settings the test uses."""
    stage: Annotated[str, Reference("stage")] | None = None
    """Stage of `curriculum` whose settings the test uses."""
    expect: Expectation
    """Expected result."""
