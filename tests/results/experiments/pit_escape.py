"""The paper's second task: a ball rocks itself out of a pit."""

from tests.results.experiment import RANDOM, Bar, Baseline, Experiment, Mark, Training, seeds
from tests.results.figures import Crossed, Held, Solved, Trained, Tried

EXPERIMENTS = (
    Experiment(
        scenario="pit_escape",
        title="PitEscape",
        prose="A ball with a weight inside has to leave a pit whose wall is too steep for its motors, so it must rock. The return of "
        "an episode is half the share of the way out while it is inside, and from 0.5 to 1 the sooner it gets out. Two layers "
        "of 60 ReLU units, PPO; it counts as solved when the mean of 100 consecutive training episodes is at least 0.8. The "
        "second training goes on for three hours.",
        trainings=(
            Training(seeds(5)),
            Training(seeds(5), name="long", timesteps=42_000, full=True, words="three simulated hours, whether solved or not"),
        ),
        baselines=(
            RANDOM,
            Baseline("forward", ("--actions", "forward"), episodes=200),
            Baseline("rocking", ("--script", "rocking"), episodes=200),
        ),
        bars=(
            Bar(Solved("simulated_hours"), at_most=1.3),
            Bar(Trained("cpu_seconds"), at_most=60),
            Bar(Held("mean_return"), at_least=0.89),
            Bar(Held("success_rate"), at_least=1),
            Bar(Tried("forward", "successes"), at_most=0),
            Bar(Tried("rocking", "success_rate"), at_least=0.95),
            Bar(Crossed(0.9, "simulated_hours", training="long"), at_most=3, stretch=True),
        ),
        paper="The paper's agent, PPO with the same networks, passed a mean of 0.6 near episode 90 and 0.8 from about episode 150 on,"
        " after some 3 simulated hours (500 episodes) altogether.",
        marks=(Mark("solved: 0.8", value=0.8), Mark("the paper: 3 h", hours=3)),
    ),
)
