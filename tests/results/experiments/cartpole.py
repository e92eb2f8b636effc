"""The paper's first task, with a choice and with a range of wheel speeds."""

from tests.results.experiment import RANDOM, Bar, Experiment, Held, Mark, Solved, Trained, Training, seeds

BARS = (
    Bar(Solved("simulated_hours"), at_most=0.5),
    Bar(Solved("simulated_hours"), at_most=0.3, over="median"),
    Bar(Trained("cpu_seconds"), at_most=30),
    Bar(Held("mean_return"), at_least=199),
)
MARKS = (Mark("solved: 195", value=195), Mark("the paper: 2.5 h", hours=2.5))
PAPER = "The paper's agent, PPO with the same networks, needed about 2.5 simulated hours (some 281 000 steps)."

EXPERIMENTS = (
    Experiment(
        scenario="cartpole",
        title="CartPole",
        prose="A cart on four wheels keeps a free pole upright by driving back or forth at full speed. Two layers of ten ReLU units, "
        "PPO. It counts as solved when the mean return of 100 consecutive training episodes is at least 195 of 200. A second set of seeds: "
        "101 to 105 were trained before the engine ignored contacts that carry nothing, and were solved after 0.230 to 0.256 h.",
        trainings=(Training(seeds(5, first=201)),),
        baselines=(RANDOM,),
        bars=BARS,
        paper=PAPER,
        marks=MARKS,
    ),
    Experiment(
        scenario="cartpole_continuous",
        title="CartPole with a range of speeds",
        prose="The same cart and pole; the wheels turn at any speed up to the limit. PPO with the same networks. "
        "Trained before the engine ignored contacts that carry nothing.",
        trainings=(Training(seeds(5)),),
        baselines=(RANDOM,),
        bars=BARS,
        paper="The original's continuous variant was given a budget of 10 000 episodes of DDPG; when it was solved is not told.",
        marks=MARKS[:1],
    ),
)
