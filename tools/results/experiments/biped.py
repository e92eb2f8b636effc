"""Walk on two legs as commanded."""

from tools.results.experiment import RANDOM, Ahead, Bar, Baseline, Experiment, Held, Trained, Training, seeds

EXPERIMENTS = (
    Experiment(
        scenario="biped",
        title="BipedVelocity",
        prose="In the case `forward` the command is 0.4 m/s straight ahead, in `turning` 0.3 m/s and 0.4 rad/s; an"
        " episode succeeds if the speed and the turning rate, smoothed over the sway of the steps, stay within"
        " 20 % of the command to the end. The training has no pushes, as the case `pushed` has.",
        trainings=(Training(seeds(3)),),
        baselines=(RANDOM, Baseline("standing", ("--driver", "zero"), words="every joint where it stands")),
        bars=(
            *(Bar(Ahead(name), at_least=0) for name in ("random", "standing")),
            Bar(Held("success_rate", case="forward"), at_least=0.9),
            Bar(Held("success_rate", case="turning"), at_least=0.9),
            Bar(Held("mean_length"), at_least=475),
            Bar(Trained("cpu_seconds"), at_most=2400),
            Bar(Held("mean_length", case="pushed"), at_least=450, stretch=True),
        ),
        case="forward",
    ),
)
