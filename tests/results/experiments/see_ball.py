"""Find a ball by camera alone."""

from tests.results.experiment import RANDOM, Ahead, Bar, Baseline, Experiment, Training, seeds

EXPERIMENTS = (
    Experiment(
        scenario="see_ball",
        title="SeeBall",
        prose="A small robot finds a ball in an empty arena. The policy sees two pictures of 40 x 40 pixels, its last action, and nothing "
        "else; the color of the ball and the light change. PPO with a convolutional network, 100 000 steps.",
        trainings=(Training(seeds(1)),),
        baselines=(RANDOM, Baseline("zero", ("--driver", "zero"))),
        bars=(Bar(Ahead("random"), at_least=0), Bar(Ahead("zero"), at_least=0)),
        curve="success",
    ),
)
