"""Keys the records of docs/results anew after names in digests have changed.

    python -m tests.results.rekey OLD

OLD is a checkout from before the change. The entries of an experiment that counted there count here, if every program behind the experiment
has the same generated code in both, and the same random episodes to the bit; else they stay as they are.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from deepbots_cli import api
from deepbots_cli.codegen import generate_module
from deepbots_cli.program import Program
from tests.contract import rollout
from tests.results.experiment import Experiment, experiments
from tests.results.measure import ROOT, Places, compiled, pieces, put, read


def known() -> dict[str, dict[str, Any]]:
    """Of each experiment, as this checkout has it: what it does, and the digest and command of each piece."""
    return {
        name: {
            "behaviour": behaviour(experiment),
            "pieces": {"/".join(piece.keys): list(piece.asked()) for piece in pieces(experiment, Places())},
        }
        for name, experiment in experiments().items()
    }


def behaviour(experiment: Experiment) -> str:
    """SHA-256 of the code and of two random episodes of every program."""
    found = hashlib.sha256()
    for program in programs(experiment):
        environment = api.build(program)
        found.update(re.sub(r"scenario [0-9a-f]{12}\.", "", generate_module(program)).encode())
        found.update(rollout.digest(environment, 0).encode())
        environment.close()
    return found.hexdigest()


def programs(experiment: Experiment) -> Iterator[Program]:
    """What is trained and evaluated, with all cases and stages."""
    asked = [(experiment.scenario, ()), *((experiment.scenario, training.sets) for training in experiment.trainings)]
    asked += [(wanted.scenario, ()) for training in experiment.trainings for wanted in training.evaluations if wanted.scenario]
    for scenario, sets in dict.fromkeys(asked):
        program = compiled(scenario, sets)
        yield from (program, *(variant.program for variant in (*program.cases, *program.curriculum)))


def main() -> None:
    if sys.argv[1:] == ["known"]:
        json.dump(known(), sys.stdout)
        return
    source = Path(sys.argv[1]).resolve()
    settings = {**os.environ, "PYTHONPATH": str(source), "PYTHONDONTWRITEBYTECODE": "1"}
    told = subprocess.run([sys.executable, "-P", __file__, "known"], cwd=source, env=settings, check=True, stdout=subprocess.PIPE)
    before, after = json.loads(told.stdout), known()
    for name, new in after.items():
        old, path = before.get(name, {}), Places().record(name)
        if old.get("behaviour") != new["behaviour"]:
            print(f"{name}: its code or its motion differs")
            continue
        for place, (digest, command) in new["pieces"].items():
            entry: Any = read(path)
            for key in place.split("/"):
                entry = entry.get(key, {})
            if [entry.get("digest"), entry.get("command")] == old["pieces"].get(place) and command == entry["command"]:
                put(path, {**entry, "digest": digest}, *place.split("/"))
        print(f"{path.relative_to(ROOT)}: {len(new['pieces'])} entries")


if __name__ == "__main__":
    main()
