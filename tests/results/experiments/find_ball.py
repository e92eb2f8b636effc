"""The paper's third task, in the paper's own layout."""

from tests.results.experiment import RANDOM, Bar, Evaluation, Experiment, Mark, Training, seeds
from tests.results.figures import Held, Trained

EXPERIMENTS = (
    Experiment(
        scenario="find_ball",
        title="FindBall",
        prose="A small robot with eight infrared sensors has to find a ball behind an obstacle without touching anything.",
        trainings=(Training(seeds(1), evaluations=(Evaluation(episodes=1000, case="paper"),)),),
        baselines=(RANDOM,),
        bars=(
            Bar(Trained("simulated_hours"), at_most=3),
            Bar(Held("success_rate"), at_least=0.95),
        ),
        paper="The paper's agent, DDPG, had 500 episodes, about 3 simulated hours; how often it got there is not told.",
        marks=(Mark("the paper: 3 h", hours=3),),
        curve="success",
    ),
)
