"""Seven messages of a robot with a latency of 50 ms and a lost one, as the channel of the runtime delivers
them."""

from __future__ import annotations

from deepbots_cli.program.robots import Route
from deepbots_cli.runtime.messages import LossyChannel
from deepbots_cli.runtime.streams import Streams
from figures.drawing import Drawing
from tests.named import constant

TIMESTEP, LATENCY = 0.020, 0.050  # s
LOST = 3
COUNT = 8
LEFT, WIDTH, SENT, TAKEN = 120.0, 62.0, 70.0, 170.0


def draw() -> str:
    drawing = Drawing(660, 320, "Messages on their way through a channel with latency and loss")

    def at(step: float) -> float:
        return LEFT + WIDTH * step

    drawing.text(
        (10, 24),
        f"timestep {1000 * TIMESTEP:g} ms, latency {1000 * LATENCY:g} ms, message {LOST} is lost, on_loss:"
        " hold",
        "soft",
    )
    drawing.text((10, SENT + 4), "robot sends")
    drawing.text((10, TAKEN + 4), "supervisor has")
    for line in (SENT, TAKEN):
        drawing.line([(LEFT - 10, line), (at(COUNT) + 20, line)], "soft")
    for step in range(COUNT):
        drawing.line([(at(step), SENT - 6), (at(step), TAKEN + 6)], "soft", dashed=True)
        drawing.text((at(step), SENT - 24), str(step), "soft", anchor="middle")
    drawing.text((10, SENT - 24), "timestep", "soft")
    channel = _channel()
    delivered: dict[int, int] = {}
    for step in range(COUNT):
        channel.loss = 1.0 if step == LOST else 0.0
        channel.send(step)
        channel.receive()
        drawing.circle((at(step), SENT), 9, "blue", fill="solid")
        drawing.text((at(step), SENT + 5), str(step), "blue", anchor="middle")
        latest = channel.latest
        if channel.message_received:
            delivered[int(latest)] = step
        shown = "" if latest is None else str(latest)
        color = "green" if channel.message_received else "orange"
        if shown:
            drawing.circle((at(step), TAKEN), 9, color, fill="solid")
            drawing.text((at(step), TAKEN + 5), shown, color, anchor="middle")
            drawing.text((at(step), TAKEN + 36), f"{1000 * channel.age:g}", color, anchor="middle")
    for number, step in delivered.items():
        arrives = number + LATENCY / TIMESTEP
        share = (arrives - number) / (step - number)
        drawing.line(
            [
                (at(number), SENT + 10),
                (at(arrives), SENT + 10 + share * (TAKEN - SENT - 20)),
                (at(step), TAKEN - 10),
            ],
            "blue",
            arrow=True,
        )
    middle = at(LOST) + WIDTH * 0.8, SENT + 10 + 0.32 * (TAKEN - SENT - 20)
    drawing.line([(at(LOST), SENT + 10), middle], "orange", dashed=True)
    drawing.text((middle[0] + 4, middle[1] + 12), "lost", "orange")
    drawing.text((10, TAKEN + 36), "age, ms")
    drawing.circle((20, 252), 9, "green", fill="solid")
    drawing.text((38, 257), "a message arrived in this timestep: `message_received` is true")
    drawing.circle((20, 284), 9, "orange", fill="solid")
    drawing.text((38, 289), "no message arrived: the values of the last one stay, and their age grows")
    return drawing.svg()


def _channel() -> LossyChannel:
    """A channel that may lose messages; which ones is set above."""
    made = LossyChannel("robot", Route(constant(LATENCY), constant(0.5)), TIMESTEP)
    made.begin(Streams(0))
    return made
