"""Shipped scenarios without an experiment, and why."""

TO_COME = "No figures yet."

REASONS: dict[str, str] = {
    "balancer": TO_COME,
    "cartpole_long": "CartPole with another pole, an example of `extends`; a test trains one like it.",
    "cartpole_wireless": "CartPole over a bad radio, an example of channels.",
    "find_and_avoid": TO_COME,
    "find_ball": TO_COME,
    "find_ball_random": TO_COME,
    "line_follower": TO_COME,
    "multi_cartpole": TO_COME,
    "panda_push": TO_COME,
    "pit_escape": TO_COME,
    "quadrotor": TO_COME,
    "quadruped": TO_COME,
    "see_ball": TO_COME,
    "tag": TO_COME,
}
