"""A scenario as a small Python project of its own, whose generated classes are there to be edited."""

from __future__ import annotations

from pathlib import Path, PurePosixPath

import deepbots_cli
from deepbots_cli.api import Compiled
from deepbots_cli.cli.copying import Files
from deepbots_cli.codegen.names import class_name
from deepbots_cli.compiler.inputs import FOLDER, RESOLVED
from deepbots_cli.errors import UsageError, cloned

_README = """\
# {name}

{summary}

Written out by deepbots {version}, from scenario {digest}.

    pip install -r requirements.txt    # which names a clone of deepbots
    python run.py      # a few episodes of random actions
    python train.py    # training, then evaluation

- environment.py: a class for each robot, and the supervisor. **Edit this**: sensors, messages, reward, endings.
- {resolved}: the scenario: world, robots, spaces, training. The classes are joined to it by name. Its files are in {inputs}/.
- task.py: brings the two together.
"""

_TASK = '''\
"""Brings environment.py and {resolved} together."""

from dataclasses import replace
from pathlib import Path

from deepbots_cli import api, engines
from deepbots_cli.program import Program
from deepbots_cli.runtime import Supervisor, assemble
from environment import {supervisor}

HERE = Path(__file__).parent


def scenario() -> Program:
    return compiled().ir


def make(ir: Program, *, render_mode: str | None = None) -> Supervisor:
    """The environment: a Gymnasium environment like any other."""
    return assemble({supervisor}, ir, lambda world: engines.create("pybullet", world), render_mode)


def compiled() -> api.Compiled:
    """What a training records: the scenario, and the code as it is now."""
    made = api.compile(HERE / "{resolved}"{options})
    code = (HERE / "environment.py").read_text(encoding="utf-8")
    own = {{name: (HERE / name).read_bytes() for name in ("environment.py", "task.py")}}
    return replace(made, code=code, inputs={{**made.inputs, **own}})
'''

_RUN = '''\
"""A few episodes of random actions."""

from task import make, scenario

environment = make(scenario())
for seed in range(3):
    environment.reset(seed=seed)
    total, steps, ended = 0.0, 0, False
    while not ended:
        _, reward, terminated, truncated, info = environment.step(environment.action_space.sample())
        total, steps, ended = total + reward, steps + 1, terminated or truncated
    print(f"episode {seed}: return {total:.1f} in {steps} steps, ended by {info['ended_by']}")
environment.close()
'''

_TRAIN = '''\
"""Training in a new directory under runs/, then evaluation."""

from pathlib import Path

from deepbots_cli.learning import evaluate, train
from task import compiled, make

if __name__ == "__main__":
    result = train(compiled(), runs=Path("runs"), seed=0, build=make, progress=True)
    print(f"{result.run}: {result.steps} steps, {result.episodes} episodes")
    print(evaluate(result.run, build=make).verdict)
'''


def files(compiled: Compiled) -> Files:
    """The files of the project, README first."""
    ir = compiled.ir
    name = class_name(ir.name)
    words = {"resolved": RESOLVED, "inputs": FOLDER, "supervisor": f"{name}Supervisor"}
    words["options"] = ", allow_code=True" if compiled.allow_code else ""
    texts = {
        "README.md": _README.format(
            name=ir.name, summary=ir.summary, version=deepbots_cli.__version__, digest=compiled.digest[:12], **words
        ),
        "environment.py": compiled.code,
        RESOLVED: compiled.resolved,
        "task.py": _TASK.format(**words),
        "run.py": _RUN,
        "train.py": _TRAIN,
        "requirements.txt": _requirements(),
    }
    copies = {PurePosixPath(FOLDER, path): content for path, content in compiled.inputs.items()}
    return {PurePosixPath(path): text.encode() for path, text in texts.items()} | copies


def _requirements() -> str:
    """What the project needs: the clone that deepbots was installed from, where pip knows it; no index of packages has deepbots."""
    clone = cloned()
    known = clone != "deepbots-cli"
    here = f"deepbots-cli[train] @ {Path(clone).as_uri()}" if known else "# deepbots-cli[train] @ file:///PATH/TO/THE/CLONE"
    moved = ", where that has changed" if known else ""
    return f"# deepbots {deepbots_cli.__version__} is installed from a clone; put its place here{moved}\n{here}\n"


def check(folder: Path) -> None:
    """Raises: UsageError: The folder is there and holds anything; a project is never written over another."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise UsageError(f"{folder} exists and is not an empty folder; name another")
