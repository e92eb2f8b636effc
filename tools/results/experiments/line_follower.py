"""Follow a painted track."""

from tools.results.experiment import RANDOM, Ahead, Bar, Baseline, Experiment, Held, Training, seeds

EXPERIMENTS = (
    Experiment(
        scenario="line_follower",
        title="LineFollower",
        prose="`steer` is a rule by hand.",
        trainings=(Training(seeds(3)),),
        baselines=(RANDOM, Baseline("steer", ("--driver", "steer"))),
        bars=(
            Bar(Ahead("random"), at_least=0),
            Bar(Held("success_rate"), at_least=0.95, words="laps completed, held out"),
        ),
        curve="success",
    ),
)
