"""The pictures of templates and shipped scenarios on the first page of the studio, and the times of their
trainings: `python -m tools.gallery_pictures [NAME ...]` takes some seconds for each picture.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

from deepbots_cli.cli.starters.draft import template_summaries
from deepbots_cli.document.shipped import scenario_names
from deepbots_cli.processes import python_command, python_environment
from deepbots_cli.studio.dialogs import PICTURES
from tools.results import measure
from tools.results.experiment import experiments
from tools.results.measure import Places
from tools.results.standing import Headline, Standing

TIMES = PICTURES / "trainings.json"
_SIZE, _RENDERED = (320, 200), "1280x800"
_FOLLOWED = {"quadrotor": "drone", "quadruped_rough": "dog"}
"""The robots that are too small in a picture of the whole world."""


def training_times() -> dict[str, str]:
    """Return the median CPU time of the measured trainings of each scenario, rounded."""
    times = {}
    for name, experiment in experiments().items():
        headline = Headline.of(Standing.of(experiment, measure.read(Places().record(name))))
        if headline is not None:
            seconds = headline.cpu_seconds
            times[name] = (
                f"{max(10, round(seconds, -1)):.0f} s" if seconds < 95 else f"{seconds / 60:.0f} min"
            )
    return times


def main(names: list[str]) -> None:
    TIMES.write_text(json.dumps(training_times(), indent=2) + "\n", encoding="utf-8")
    for name in names or [*template_summaries(), *scenario_names()]:
        with tempfile.TemporaryDirectory() as folder:
            shown = name
            if name in template_summaries() and name not in scenario_names():
                _run(folder, "new", name, "--template", name)
                shown = f"{name}.yaml"
            camera = ("--follow", _FOLLOWED[name]) if name in _FOLLOWED else ()
            _run(folder, "render", shown, "-o", "start.png", "--size", _RENDERED, *camera)
            with Image.open(Path(folder, "start.png")) as picture:
                small = picture.convert("RGB").resize(_SIZE, Image.Resampling.LANCZOS)
            small.save(PICTURES / f"{name}.webp", quality=80, method=6)
        print(name, flush=True)


def _run(folder: str, *words: str) -> None:
    subprocess.run(python_command("deepbots_cli", *words), cwd=folder, env=python_environment(), check=True)


if __name__ == "__main__":
    main(sys.argv[1:])
