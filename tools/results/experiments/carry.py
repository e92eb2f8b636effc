"""Two robots push a bar that one alone cannot move."""

from tools.results.experiment import RANDOM, Bar, Baseline, Experiment, Held, Training, seeds

EXPERIMENTS = (
    Experiment(
        scenario="carry",
        title="Carry",
        prose="Both agents learn in the same episodes, each with a policy of its own; returns are the sum of both."
        " `push` is a rule by hand: each robot drives at its end of the bar, slower on the side to turn to; its"
        " return is that of one robot.",
        trainings=(Training(seeds(3)),),
        baselines=(RANDOM, Baseline("push", ("--agent", "left", "--driver", "push"))),
        bars=(Bar(Held("success_rate"), at_least=0.9),),
        curve="success",
    ),
)
