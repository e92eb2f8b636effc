"""The loop of reinforcement learning, with the values of CartPole."""

from __future__ import annotations

from deepbots_cli import api
from figures.drawing import Drawing

LEFT, WIDTH, HEIGHT = 4.0, 332.0, 62.0
ABOVE, BELOW = 12.0, 180.0


def draw() -> str:
    program = api.compile("cartpole").program
    names = [one.name.removeprefix("cart.").replace("_", " ") for one in program.agent.numbers]
    (drive,) = program.agent.action
    (term,) = program.agent.reward
    drawing = Drawing(
        340,
        280,
        "The policy chooses an action from the observation; the world answers with a reward and the next"
        " observation",
    )
    middle = LEFT + WIDTH / 2
    for top, color, name, what in (
        (ABOVE, "blue", "policy", "a neural network"),
        (BELOW, "green", "world", "cart, pole and physics"),
    ):
        drawing.box(LEFT, top, WIDTH, HEIGHT, color)
        drawing.text((middle, top + 27), name, color, anchor="middle")
        drawing.text((middle, top + 47), what, anchor="middle")
    down, up = LEFT + 36, LEFT + WIDTH - 36
    drawing.line([(down, ABOVE + HEIGHT), (down, BELOW - 2)], "blue", arrow=True)
    drawing.text((down + 10, 108), "action", "blue")
    for row, option in enumerate(drive.options):
        drawing.text((down + 10, 126 + 18 * row), f"{'or ' * bool(row)}{option.name}")
    drawing.line([(up, BELOW), (up, ABOVE + HEIGHT + 2)], "green", arrow=True)
    drawing.text((up - 10, 96), "observation", "green", anchor="end")
    drawing.text((up - 10, 114), f"{names[0]}, {names[1]},", anchor="end")
    drawing.text((up - 10, 132), f"{names[2]}, {names[3]}", anchor="end")
    drawing.text((up - 10, 158), f"reward: {term.text}", "green", anchor="end")
    drawing.text((middle, 268), "32 ms later, the next step begins", "soft", anchor="middle")
    return drawing.svg()
