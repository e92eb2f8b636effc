"""Nine carts under one policy."""

from tools.results.experiment import RANDOM, Ahead, Bar, Experiment, Held, Mark, Solved, Training, seeds

EXPERIMENTS = (
    Experiment(
        scenario="multi_cartpole",
        title="MultiCartPole",
        prose="Steps and simulated hours count each of the nine carts.",
        trainings=(Training(seeds(3)),),
        baselines=(RANDOM,),
        bars=(
            Bar(Ahead("random"), at_least=0),
            Bar(Held("mean_return"), at_least=195),
            Bar(Solved("simulated_hours"), at_most=2.5, stretch=True),
        ),
        marks=(Mark("solved: 195", value=195),),
    ),
)
