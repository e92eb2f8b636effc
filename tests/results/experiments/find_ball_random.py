"""Find the ball among obstacles that are placed anew for each episode: what the paper's agent failed to generalise to."""

from tests.results.experiment import RANDOM, Bar, Evaluation, Experiment, Training, seeds
from tests.results.figures import Held, Trained

EXPERIMENTS = (
    Experiment(
        scenario="find_ball_random",
        title="FindBallRandom",
        prose="The same robot among one to ten obstacles, all placed anew in each episode.",
        trainings=(Training(seeds(3), evaluations=(Evaluation(episodes=1000),)),),
        baselines=(RANDOM,),
        bars=(
            Bar(Trained("simulated_hours"), at_most=2.5),
            Bar(Held("success_rate", case="none"), at_least=0.98, over="mean"),
            Bar(Held("success_rate", case="many"), at_least=0.68, over="mean"),
        ),
        paper='Of its agent, trained in one layout, the paper says that it "fails to generalize in more complicated scenes".',
        curve="success",
    ),
)
