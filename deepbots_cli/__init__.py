"""deepbots: one YAML scenario and a URDF robot become a trained, evaluated, explained robot policy.

The stages of the data, and the package of each; below, the other packages and modules:

    text ─▶ nodes ─▶ Scenario ─▶ typed trees ─▶ Program ─▶ generated Python ─▶ environment ─▶ run
    document    scenario    compiler, expressions   program   codegen             runtime         learning

program/            the compiled scenario
analysis/           ranges of values, equal quantities, thresholds, possible returns
robots/             robot files: URDF, meshes
diagnostics/        findings and their rules
lint/               rules about scenarios
engines/            simulated worlds, one package for each simulator
rollout/            sources by name or path; episodes as a stream of steps
cluster/            trainings in several processes or on several machines
view/               the live page, pictures, clips, recordings
insight/            explanations, reports, exported policies
webots/             projects of Webots
studio/             one page for writing, seeing and training
cli/, lsp/          the command and the language server
port.py             the interface of engines
engine_kinds.py     the names of engines and their requirements
frames.py           rotations and frames
footprint.py        footprints, link frames, bounding boxes
geometry.py         terrain, also of tiles, and meshes at simulation time
arrays.py           expressions over arrays
api.py              from scenario to environment
envs.py             shipped scenarios for Gymnasium
errors.py           the exceptions, as a tree
files.py            files read up to a limit, or written whole
display.py          the progress that a command shows
installation.py     the packages of extras, and how to install them
words.py            numbers and lists in messages
plugins.py          plug-ins of other packages
message_formats.py  the formats of messages
processes.py        further processes of Python
pictures.py         a check of pictures before they are decoded

The documented Python API is `Scenario`, `Permissions`, `load`, `compile`, `make`, `make_vec`,
`parallel_env`, `train`, `resume`, `evaluate`, `compare` and `load_policy`; each is imported on first use, so
that importing this package costs nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from deepbots_cli.api import compile, load, make, make_vec, parallel_env
    from deepbots_cli.document import Permissions
    from deepbots_cli.learning import compare, evaluate, load_policy, resume, train
    from deepbots_cli.scenario import Scenario

__version__ = "0.1.0"
__all__ = [
    "Permissions",
    "Scenario",
    "__version__",
    "compare",
    "compile",
    "evaluate",
    "load",
    "load_policy",
    "make",
    "make_vec",
    "parallel_env",
    "resume",
    "train",
]

_HOMES = {
    "Permissions": "deepbots_cli.document",
    "Scenario": "deepbots_cli.scenario",
    "compile": "deepbots_cli.api",
    "load": "deepbots_cli.api",
    "make": "deepbots_cli.api",
    "make_vec": "deepbots_cli.api",
    "parallel_env": "deepbots_cli.api",
    "train": "deepbots_cli.learning",
    "resume": "deepbots_cli.learning",
    "evaluate": "deepbots_cli.learning",
    "compare": "deepbots_cli.learning",
    "load_policy": "deepbots_cli.learning",
}


def __getattr__(name: str) -> object:
    home = _HOMES.get(name)
    if home is None:
        raise AttributeError(f"module 'deepbots_cli' has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(home), name)


def __dir__() -> list[str]:
    return sorted(__all__)
