"""What the benchmark compares: tasks, algorithms and the values that each of them learns with;
docs/benchmark.md shows the results.

`python -m tools.results benchmark` measures what is missing, `python -m tools.results benchmark/panda_reach`
that of one task. A cell is a task and an algorithm: an `Experiment` for each task has a training for each
algorithm, of the same name. A learner of a shipped scenario has the values of its `train` section. The values
of all others are those of the chosen learner (docs/training.md), written out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

from tools.results.experiment import Evaluation, Experiment, Training, seeds

GROUP = "benchmark"
SEEDS = seeds(3, first=301)
"""No value of a scenario or of deepbots was chosen by these."""
ENGINES = ("pybullet", "mujoco")
CPU_LIMIT = 240
"""Seconds of CPU that a training takes at most, about: the timesteps below, measured on two cores beside
other work."""
PPO_STEPS = 200_000
UPDATES: Mapping[str, int] = {"SAC": 40_000, "TD3": 60_000, "TQC": 20_000, "DQN": 60_000}
"""4.8 ms of CPU for an update with SAC, 3 ms with TD3, 10 ms with TQC, with the steps that belong to it."""
DISCRETE = "discrete actions"


@dataclass(frozen=True)
class Cell:
    """An algorithm in a task: what is trained, or the `reason` why nothing is; `learner` says where the
    values are from."""

    algorithm: str
    training: Training | None
    learner: str = ""
    reason: str = ""


@dataclass(frozen=True)
class Task:
    """A shipped scenario on the engine that steps it fastest; `advice` says what its `train` section has to
    do with the table."""

    scenario: str
    title: str
    engine: str
    cells: tuple[Cell, ...]
    advice: str = ""

    @property
    def experiment(self) -> Experiment:
        trainings = tuple(cell.training for cell in self.cells if cell.training)
        return Experiment(self.scenario, self.title, "", trainings, bars=(), engines=ENGINES, group=GROUP)


def _training(algorithm: str, engine: str, *sets: str) -> Training:
    # Of the evaluation at the end of a training, nothing is kept: 100 episodes follow.
    common = (f"world.engine={engine}", "evaluation={episodes: 20}")
    return Training(SEEDS, algorithm, (*common, *sets), evaluations=(Evaluation(episodes=100),))


def own(algorithm: str, engine: str = "mujoco") -> Cell:
    return Cell(algorithm, _training(algorithm, engine), "the `train` section of the scenario")


def ppo(gamma: float, *, worlds: int = 8, epochs: int = 10, batch: int = 128, rate: str = "1e-3") -> Cell:
    values = (
        f"n_steps: {2048 // worlds if worlds > 8 else 64}, batch_size: {batch}, n_epochs: {epochs},"
        f" learning_rate: {rate}"
    )
    section = (
        f"{{algorithm: PPO, total_timesteps: {PPO_STEPS}, environments: {worlds}, {values}, gamma:"
        f" {gamma}, gae_lambda: 0.95"
    )
    return Cell(
        "PPO",
        _training("PPO", "mujoco", f"train={section}, normalize: reward, network: {{hidden: [64, 64]}}}}"),
        "values of the chosen learner (PPO)",
    )


def off_policy(algorithm: str, gamma: float, *, engine: str = "mujoco", hindsight: bool = False) -> Cell:
    """With hindsight an update for each step of four worlds, otherwise for every second step of eight."""
    special = (
        "environments: 4, replay: her, tau: 0.02"
        if hindsight
        else "environments: 8, train_freq: 1, gradient_steps: 4"
    )
    values = (
        f"{special}, batch_size: 256, learning_rate: 1e-3, gamma: {gamma}, network: {{hidden: [128,"
        f" 128], activation: relu}}"
    )
    steps = UPDATES[algorithm] * (1 if hindsight else 2)
    section = f"train={{algorithm: {algorithm}, total_timesteps: {steps}, {values}}}"
    return Cell(
        algorithm,
        _training(algorithm, engine, section),
        f"values of the chosen learner (SAC{' with hindsight' if hindsight else ''})",
    )


def ddpg() -> Cell:
    """The algorithm of the paper's FindBall."""
    values = (
        "environments: 8, gradient_steps: 4, learning_rate: 1e-3 -> 1e-4, action_noise: {type: normal,"
        " sigma: 0.4 -> 0.1}"
    )
    section = f"train={{algorithm: DDPG, total_timesteps: 84000, {values}, network: {{hidden: [128, 128]}}}}"
    return Cell("DDPG", _training("DDPG", "mujoco", section), "values of FindBallAsPrinted")


def _no_ranges(instead: str = "") -> tuple[Cell, ...]:
    return tuple(Cell(algorithm, None, reason=f"{DISCRETE}{instead}") for algorithm in ("SAC", "TD3", "TQC"))


def _all_off_policy(gamma: float, *, engine: str = "mujoco") -> tuple[Cell, ...]:
    return tuple(off_policy(algorithm, gamma, engine=engine) for algorithm in ("SAC", "TD3", "TQC"))


TASKS = (
    Task(
        "cartpole",
        "CartPole",
        "mujoco",
        (own("PPO"), *_no_ranges("; CartPoleContinuous has ranges"), off_policy("DQN", 0.98)),
    ),
    Task("cartpole_continuous", "CartPoleContinuous", "mujoco", (own("PPO"), *_all_off_policy(0.98))),
    Task("pit_escape", "PitEscape", "mujoco", (own("PPO"), *_no_ranges(), off_policy("DQN", 0.98))),
    Task(
        "find_ball",
        "FindBall",
        "mujoco",
        (
            ppo(0.99, worlds=16, epochs=5, batch=256, rate="1e-3 -> 1e-4"),
            off_policy("SAC", 0.99),
            own("TD3"),
            off_policy("TQC", 0.99),
            ddpg(),
        ),
        "TD3 needs the fewest simulated hours. It is DDPG, the algorithm of the paper, with a second critic.",
    ),
    Task(
        "panda_reach",
        "PandaReach",
        "mujoco",
        (
            ppo(0.92),
            off_policy("SAC", 0.92, hindsight=True),
            own("TD3"),
            off_policy("TQC", 0.92, hindsight=True),
        ),
        "TD3 needs a sixth of the simulated time, which counts in PyBullet, the default engine.",
    ),
    Task(
        "quadrotor", "Hover", "pybullet", (own("PPO", "pybullet"), *_all_off_policy(0.99, engine="pybullet"))
    ),
    Task("line_follower", "LineFollower", "mujoco", (own("PPO"), *_all_off_policy(0.99))),
)


@cache
def experiments() -> dict[str, Experiment]:
    """One for each task, by the name of its record: `benchmark/cartpole`."""
    return {task.experiment.name: task.experiment for task in TASKS}
