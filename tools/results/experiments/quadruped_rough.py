"""Cross rough ground of six kinds."""

from tools.results.experiment import RANDOM, Ahead, Bar, Baseline, Experiment, Held, Trained, Training, seeds

KINDS = ("up", "down", "slope", "waves", "rough", "blocks")

EXPERIMENTS = (
    Experiment(
        scenario="quadruped_rough",
        title="A1Rough",
        prose="Each case has one kind of tile at half of the hardest level: stairs of 8 cm up and down, a slope"
        " of 14 deg, waves of 12 cm, rough ground of 5 cm and blocks of 7 cm. Without a case, kinds and levels"
        " are drawn, up to stairs of 14 cm. The baseline is the trot by hand that the policy corrects.",
        trainings=(Training(seeds(3, first=133)),),
        baselines=(
            RANDOM,
            Baseline("trot", ("--driver", "zero"), words="the trot by hand, without a policy"),
        ),
        bars=(
            *(Bar(Ahead(name), at_least=0) for name in ("random", "trot")),
            *(Bar(Held("success_rate", case=kind), at_least=0.8) for kind in KINDS),
            Bar(Trained("cpu_seconds"), at_most=3600),
        ),
        case="up",
    ),
)
