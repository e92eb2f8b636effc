"""Keys the records of results anew after names in digests have changed.

    (cd OLD; PYTHONPATH=. python -P NEW/tools/results/rekey.py centred=centered) > known.json
    python -m tools.results.rekey centred=centered known.json

OLD is a checkout from before the change. The entries of an experiment that counted there count here, if every
program behind the experiment has the same generated code in both, apart from comments and from the names, and
the same random episodes to the bit; else they stay as they are.
"""

from __future__ import annotations

import hashlib
import json
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from deepbots_cli import api
from deepbots_cli.codegen import generate_module
from tests.contract import rollout
from tools.results import benchmark
from tools.results.experiment import Experiment, experiments
from tools.results.measure import Places, compiled, pieces, put, read


def behavior(experiment: Experiment, names: Mapping[str, str] = MappingProxyType({})) -> str:
    """SHA-256 of what is trained and evaluated, with all cases and stages: the code with new names for old
    ones, and random episodes."""
    scenarios = [
        (experiment.scenario, ()),
        *((experiment.scenario, training.sets) for training in experiment.trainings),
    ]
    scenarios += [
        (evaluation.scenario, ())
        for training in experiment.trainings
        for evaluation in training.evaluations
        if evaluation.scenario
    ]
    whole = [compiled(scenario, sets) for scenario, sets in dict.fromkeys(scenarios)]
    digest = hashlib.sha256()
    for program in [
        part
        for each in whole
        for part in (
            each,
            *(case.program for case in each.cases),
            *(stage.program for stage in each.curriculum),
        )
    ]:
        environment = api.build(program)
        code = re.sub(
            r"scenario [0-9a-f]{12}\.|  # .*|^ *# .*\n", "", generate_module(program), flags=re.MULTILINE
        )
        for old, new in names.items():
            code = code.replace(old, new)
        digest.update(code.encode())
        digest.update(rollout.digest(environment, 0).encode())
        environment.close()
    return digest.hexdigest()


def rewrite(name: str, old: Any, new: Any) -> None:
    path = Places().record(name)
    if old["behavior"] != new["behavior"]:
        print(f"{name}: its code or its motion differs")
        return
    for place, request in new["pieces"].items():
        entry: Any = read(path)
        for key in place.split("/"):
            entry = entry.get(key, {})
        if [entry.get("digest"), entry.get("command")] == old["pieces"].get(place) and request[1] == entry[
            "command"
        ]:
            put(path, {**entry, "digest": request[0]}, *place.split("/"))


if __name__ == "__main__":
    names = dict(word.split("=") for word in sys.argv[1:] if "=" in word)
    records = {
        name: {
            "behavior": behavior(each, names),
            "pieces": {"/".join(piece.keys): list(piece.request()) for piece in pieces(each, Places())},
        }
        for name, each in {**experiments(), **benchmark.experiments()}.items()
    }
    if files := [word for word in sys.argv[1:] if "=" not in word]:
        for name, old in json.loads(Path(files[0]).read_text(encoding="utf-8")).items():
            rewrite(name, old, records[name])
    else:
        json.dump(records, sys.stdout)
