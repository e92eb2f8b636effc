"""Shipped scenarios without an experiment, and why."""

REASONS: dict[str, str] = {
    "cartpole_long": "CartPole with another pole, an example of `extends`; a test trains one like it.",
    "cartpole_wireless": "CartPole over a bad radio, an example of channels.",
    "find_ball_as_printed": "A lesson in rewards: what it pays for stands on its page.",
}
