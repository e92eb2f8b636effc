"""A folder of scenarios to lint: shipped ones with other names and figures, grown to a hundred lines by
signals and terms of the reward."""

from __future__ import annotations

import random
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
FILES = 200
LINES = 100
# Of each scenario, a number of the order of one to write further expressions of.
BASES = {
    "cartpole": "x / track",
    "pit_escape": "reach / radius",
    "find_ball": "apart / m",
    "line_follower": "offset / width",
}
FORMS = (
    "{a} * exp(-abs({x}))",
    "clamp({a} * {x}, -1 .. 1)",
    "{b} if {x} > {a} and time > {b} s else 1 - {b}",
    "low_pass({x}, {b} s) + {a} * max({x}, 0.1)",
    "{a} * ({x} - {b}) ^ 2",
)


def write(folder: Path, files: int = FILES) -> Path:
    """The folder with the scenarios; the robots that they name lie beside it, as in a project."""
    shutil.copytree(ROOT / "robots", folder / "robots")
    (folder / "deepbots.toml").touch()
    scenarios = folder / "scenarios"
    scenarios.mkdir()
    for number in range(files):
        base = list(BASES)[number % len(BASES)]
        (scenarios / f"{base}_{number:03}.yaml").write_text(scenario(base, number), encoding="utf-8")
    return scenarios


def scenario(base: str, number: int) -> str:
    """The text of one file, the same each time."""
    drawn = random.Random(number)
    text = (ROOT / "scenarios" / f"{base}.yaml").read_text(encoding="utf-8")
    text = re.sub(r"(?m)^(name: \w+)", rf"\g<1>{number}", text)
    text = re.sub(r"(?m)^reward: +\{(.*)\}", r"reward:\n  \1", text)
    text = re.sub(r"(?m)^(  total_timesteps: )\S+", rf"\g<1>{drawn.randrange(10, 100)}_000", text)
    if not re.search(r"(?m)^signals:", text):
        text = text.replace("\nreward:", "\nsignals:\nreward:")
    names = [f"{drawn.choice('abcdefgh')}_{index}" for index in range((LINES - text.count("\n") + 1) // 2)]
    signals = "".join(_signals(names, BASES[base], drawn))
    terms = "".join(f"  {name}_term: {drawn.random():.3f} * {name}\n" for name in names)
    return re.sub(
        r"(?m)^signals:.*\n", rf"\g<0>{signals}", re.sub(r"(?m)^reward:.*\n", rf"\g<0>{terms}", text)
    )


def _signals(names: list[str], value: str, drawn: random.Random) -> Iterator[str]:
    for name in names:
        yield f"  {name}: {drawn.choice(FORMS).format(x=value, a=f'{drawn.uniform(0.1, 1):.2f}', b=f'{drawn.uniform(0.1, 1):.2f}')}\n"
