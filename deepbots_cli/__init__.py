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
records.py          dataclasses that compile nothing at import
pictures.py         a check of pictures before they are decoded

The documented Python API is `Scenario`, `Permissions`, `load`, `compile`, `make`, `make_vec`,
`parallel_env`, `train`, `train_group`, `resume`, `evaluate`, `compare` and `load_policy`; each is imported on
first use, so that importing this package costs nothing. Gymnasium gets the names of `envs` as soon as both are
imported.
"""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence
    from types import ModuleType

    from deepbots_cli.api import compile, load, make, make_vec, parallel_env
    from deepbots_cli.document import Permissions
    from deepbots_cli.learning import compare, evaluate, load_policy, resume, train, train_group
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
    "train_group",
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
    "train_group": "deepbots_cli.learning",
    "resume": "deepbots_cli.learning",
    "evaluate": "deepbots_cli.learning",
    "compare": "deepbots_cli.learning",
    "load_policy": "deepbots_cli.learning",
}


def __getattr__(name: str) -> object:
    home = _HOMES.get(name)
    if home is None:
        raise AttributeError(f"module 'deepbots_cli' has no attribute {name!r}")
    return getattr(import_module(home), name)


def __dir__() -> list[str]:
    return sorted(__all__)


class _GymnasiumLoader(SourceFileLoader):
    """Finds and loads Gymnasium in the place of Python, which has no call for an imported module, and then
    registers the environments of `envs`."""

    @classmethod
    def find_spec(cls, name: str, path: Sequence[str] | None = None, _: object = None) -> ModuleSpec | None:
        spec = PathFinder.find_spec(name, path) if name == "gymnasium" else None
        if spec is not None and spec.origin is not None:
            spec.loader = cls(name, spec.origin)
        return spec

    def exec_module(self, module: ModuleType) -> None:
        super().exec_module(module)
        import_module("deepbots_cli.envs")


sys.meta_path.insert(0, _GymnasiumLoader)
if sys.modules.get("gymnasium") is not None:
    import_module("deepbots_cli.envs")
