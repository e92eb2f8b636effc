"""Walk and turn as commanded."""

from tools.results.experiment import RANDOM, Ahead, Bar, Baseline, Experiment, Held, Trained, Training, seeds

EXPERIMENTS = (
    Experiment(
        scenario="quadruped",
        title="A1Velocity",
        prose="In the case `half_speed` the command is 0.5 m/s straight ahead; an episode succeeds if the"
        " speed, smoothed over one "
        "step of the gait, stays within 20 % of it to the end. The training has no pushes and no rough"
        " ground, as the cases "
        "`pushed` and `rough` have. Seed 101, with another weight of the gait in the reward, held the speed"
        " in 81 % of the "
        "episodes (bar: 95 %), and the weight was changed.",
        trainings=(Training(seeds(2, first=111)),),
        baselines=(
            RANDOM,
            Baseline("standing", ("--driver", "zero"), words="every joint where it stands"),
            Baseline("trot", ("--driver", "trot"), words="a gait by hand"),
        ),
        bars=(
            *(Bar(Ahead(name), at_least=0) for name in ("random", "standing", "trot")),
            Bar(Held("success_rate", case="half_speed"), at_least=0.95),
            Bar(Trained("cpu_seconds"), at_most=1440),
            *(
                Bar(Held("mean_length", case=case), at_least=475, stretch=True)
                for case in ("pushed", "rough")
            ),
        ),
        case="half_speed",
    ),
)
