"""Walk and turn as commanded, on two legs."""

from tools.results.experiment import RANDOM, Ahead, Bar, Baseline, Experiment, Held, Trained, Training, seeds

EXPERIMENTS = (
    Experiment(
        scenario="biped",
        title="BipedVelocity",
        prose="In the case `forward` the command is 0.4 m/s straight ahead, in the case `turn` 0.2 m/s and 0.5"
        " rad/s. An episode succeeds if the speed, smoothed over one step of the gait, or the turning rate,"
        " smoothed over two, stays within 20 % of the command to the end. The baseline is the gait by hand"
        " that the policy corrects.",
        trainings=(Training(seeds(3, first=121)),),
        baselines=(
            RANDOM,
            Baseline("gait", ("--driver", "zero"), words="the gait by hand, without a policy"),
        ),
        bars=(
            *(Bar(Ahead(name), at_least=0) for name in ("random", "gait")),
            *(Bar(Held("success_rate", case=case), at_least=0.9) for case in ("forward", "turn")),
            Bar(Trained("cpu_seconds"), at_most=2400),
        ),
        case="forward",
    ),
)
