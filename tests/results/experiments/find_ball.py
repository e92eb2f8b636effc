"""The paper's third task, in the paper's own layout."""

from tests.results.experiment import RANDOM, Bar, Baseline, Evaluation, Experiment, Held, Mark, Solved, Trained, Training, seeds

FRESH = seeds(5, first=201)
"""Some of 101 to 125 showed how the best network has to be chosen (docs/training.md), so they are not reported."""

EXPERIMENTS = (
    Experiment(
        scenario="find_ball",
        title="FindBall",
        prose="A small robot with eight infrared sensors has to find a ball behind a box without touching anything. DDPG, as "
        "in the paper. "
        "This is the fifth set of seeds. The first three each had one seed that failed the bar (of 1,000: 101 to 103 98.8, 31.7 and "
        "99.8 %; 111 to 115 99.9, 81.2, 99.9, 97.0 and 100 %; 121 to 125 99.8, 100, 100, 100 and 90.7 %): an early or unlucky network "
        "had been kept, and each time the way to choose it was changed. The fourth, 131 to 135, was trained before the engine ignored "
        "contacts that carry nothing; its worst seed had 98.5 %.",
        trainings=(Training(FRESH, evaluations=(Evaluation(episodes=1000),)),),
        baselines=(RANDOM, Baseline("around the box", ("--driver", "around"))),
        bars=(
            Bar(Trained("simulated_hours"), at_most=3),
            Bar(Held("success_rate"), at_least=0.95),
            Bar(Solved("episode"), at_most=500, stretch=True),
        ),
        paper="The paper's agent, DDPG, had 500 episodes, about 3 simulated hours; how often it got there is not told.",
        marks=(Mark("the paper: 3 h", hours=3),),
        curve="success",
    ),
)
