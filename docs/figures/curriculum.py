"""The stages of one training of find_ball_random, from its record."""

from __future__ import annotations

import json
from pathlib import Path

from deepbots_cli import api
from figures.drawing import Drawing, Point

ROOT = Path(__file__).resolve().parents[2]
SEED = "111"
LEFT, TOP, WIDTH, HEIGHT = 60.0, 56.0, 550.0, 170.0


def draw() -> str:
    record = json.loads(
        (ROOT / "tools" / "results" / "records" / "find_ball_random.json").read_text(encoding="utf-8")
    )["trainings"]["main"][SEED]
    names = [stage.name for stage in api.compile("find_ball_random").program.curriculum]
    hours, successes = record["curve"]["simulated_hours"], record["curve"]["success"]
    drawing = Drawing(640, 300, "The success rate of a training over the stages of its curriculum")

    def at(hour: float, rate: float) -> Point:
        return LEFT + WIDTH * hour / record["simulated_hours"], TOP + HEIGHT * (1 - rate)

    drawing.line([at(0, 1), at(0, 0), at(record["simulated_hours"], 0)], "soft")
    for rate in (0.0, 0.5, 1.0):
        drawing.text((LEFT - 8, at(0, rate)[1] + 4), f"{100 * rate:.0f} %", "soft", anchor="end")
    begins = [0.0, *(stage["simulated_hours"] for stage in record["stages"])]
    for number, (name, begin) in enumerate(zip(names, begins, strict=False)):
        if begin:
            drawing.line([at(begin, 1.05), at(begin, 0)], "orange", dashed=True)
        drawing.text((at(begin, 0)[0] + 4, TOP - 30 + 16 * (number % 2)), name, "orange", code=True)
    drawing.line(
        [at(hour, rate) for hour, rate in zip(hours, successes, strict=True) if rate is not None], "blue"
    )
    for hour in (0.5, 1.0, 1.5, 2.0, 2.5):
        drawing.text((at(hour, 0)[0], TOP + HEIGHT + 20), f"{hour:g} h", "soft", anchor="middle")
    drawing.text(
        (LEFT, TOP + HEIGHT + 46),
        f"simulated hours; successes of the last training episodes, seed {SEED}",
        "soft",
    )
    return drawing.svg()
