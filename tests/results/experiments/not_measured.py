"""Shipped scenarios without an experiment, and why."""

TO_COME = "No figures yet."

REASONS: dict[str, str] = {
    "cartpole_long": "CartPole with another pole, an example of `extends`; a test trains one like it.",
    "cartpole_wireless": "CartPole over a bad radio, an example of channels.",
    "quadruped": "20 million steps, which take days of one core.",
    "see_ball": TO_COME,
    "tag": TO_COME,
}
