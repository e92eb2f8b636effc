"""Nine carts under one policy."""

from tests.results.experiment import RANDOM, Ahead, Bar, Experiment, Held, Mark, Solved, Training, seeds

EXPERIMENTS = (
    Experiment(
        scenario="multi_cartpole",
        title="MultiCartPole",
        prose="Nine carts, each with a channel of its own, share one policy and learn from what all of them meet. An episode ends for"
        " all when the first pole falls. Steps and simulated hours count each cart.",
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
