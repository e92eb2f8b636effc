"""The paper's third task, in the paper's own layout."""

from tests.results.experiment import RANDOM, Bar, Baseline, Evaluation, Experiment, Mark, Training
from tests.results.figures import Held, Solved, Trained

FRESH = (121, 122, 123, 124, 125)
"""101 to 104 were trained before trials chose the best model, and by 102 it was found that they should; 111 to 115 before a network
that solves the task went before one with a higher return, and by 112 that was found."""

EXPERIMENTS = (
    Experiment(
        scenario="find_ball",
        title="FindBall",
        prose="A small robot with eight infrared sensors has to find a ball behind a box without touching anything. DDPG, as in the paper.",
        trainings=(Training(FRESH, evaluations=(Evaluation(episodes=1000),)),),
        baselines=(RANDOM, Baseline("around the box", ("--script", "around"))),
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
