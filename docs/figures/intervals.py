"""The interval of 95 % of a success rate of 90 %, for evaluations of different length."""

from __future__ import annotations

from deepbots_cli.learning.runs.statistics import wilson
from figures.drawing import Drawing

EPISODES = (10, 30, 100, 300, 1000)
RATE, LOWEST = 0.9, 0.5
LEFT, RIGHT, TOP, STEP = 150.0, 560.0, 66.0, 34.0


def draw() -> str:
    drawing = Drawing(640, 280, "The interval of a success rate shrinks with the number of episodes")

    def at(rate: float) -> float:
        return LEFT + (RIGHT - LEFT) * (rate - LOWEST) / (1.0 - LOWEST)

    bottom = TOP + STEP * len(EPISODES) - 10
    drawing.text((10, 24), "90 % of the evaluated episodes succeed: the interval of the true success rate")
    for percent in range(50, 101, 10):
        drawing.line(
            [(at(percent / 100), TOP - 18), (at(percent / 100), bottom)],
            "ink" if percent == 90 else "soft",
            dashed=percent != 90,
        )
        drawing.text((at(percent / 100), bottom + 20), f"{percent} %", anchor="middle")
    for row, episodes in enumerate(EPISODES):
        y = TOP + STEP * row
        low, high = wilson(round(RATE * episodes), episodes)
        drawing.text((LEFT - 14, y + 4), f"{episodes:,} episodes", anchor="end")
        drawing.line([(at(low), y), (at(high), y)], "blue")
        for end in (low, high):
            drawing.line([(at(end), y - 6), (at(end), y + 6)], "blue")
        drawing.circle((at(RATE), y), 4, "blue", fill="solid-blue")
        drawing.text((RIGHT + 12, y + 4), f"{100 * low:.0f} .. {100 * high:.0f}", "blue")
    drawing.text((LEFT, bottom + 46), "success rate, with its interval of 95 % (Wilson)", "soft")
    return drawing.svg()
