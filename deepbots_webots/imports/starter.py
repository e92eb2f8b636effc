"""A scenario from a project of Webots: the YAML text, with the project's Python at each place that is left to
a person. The template is `scenario.yaml.j2`."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path, PurePosixPath

from jinja2 import Environment, FileSystemLoader, StrictUndefined, Template

from deepbots_cli import api
from deepbots_cli.cli.command import Starter
from deepbots_cli.cli.starters.draft import yaml_name
from deepbots_cli.diagnostics.findings import FILL_IN
from deepbots_cli.errors import UsageError
from deepbots_cli.robots.model import to_urdf
from deepbots_webots.imports.draft import DraftRobot, read_project, stated_number
from deepbots_webots.imports.world import plain, pose_text


def from_webots(world: Path, library: Sequence[Path], name: str, title: str) -> Starter:
    """Return the scenario `NAME.yaml` for a world, with a robot file per robot. No code of the project runs.

    Raises:
        WorldError: The world has errors.
        UsageError: A file cannot be read, no robot has a motor, or no valid scenario came out.
    """
    draft = read_project(world, library)

    def file_of(robot: DraftRobot) -> str:
        return f"{name}_{robot.parts.name}.urdf"

    text = _template().render(
        draft=draft,
        judge=draft.judge,
        reward=stated_number(draft.judge.returned("get_reward")),
        title=title,
        file_of=file_of,
        fill_in=FILL_IN,
    )
    lines = [line.rstrip() for line in text.rstrip().split("\n")]
    todos = sum(line.strip().startswith(FILL_IN) for line in lines)
    files = {f"{name}.yaml": "".join(f"{line}\n" for line in lines).encode()}
    files |= {file_of(robot): to_urdf(robot.model).encode() for robot in draft.robots}
    files |= {path: content for robot in draft.robots for path, content in robot.parts.meshes.items()}
    files |= draft.surroundings.pictures
    _check(files, name)
    paths = {PurePosixPath(path): content for path, content in files.items()}
    return Starter(paths, todos, list(map(str, draft.findings.warnings)))


def _template() -> Template:
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        undefined=StrictUndefined,
        trim_blocks=True,
        finalize=lambda value: str(value).rstrip("\n"),  # of a macro, which ends its last line
        autoescape=False,  # the output is YAML
    )
    environment.filters |= {"word": yaml_name, "pose": pose_text, "plain": plain, "visible": _visible}
    return environment.get_template("scenario.yaml.j2")


def _visible(text: str) -> str:
    """Return a text of the project without characters that YAML refuses, and on one line."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def _check(files: dict[str, bytes], name: str) -> None:
    """Check that the scenario is valid.

    Raises:
        UsageError: It has an error.
    """
    with tempfile.TemporaryDirectory() as folder:
        for path, content in files.items():
            Path(folder, path).write_bytes(content)
        for finding in api.lint(Path(folder, f"{name}.yaml")):
            if finding.severity == "error":
                raise UsageError(f"no valid scenario came out: {finding.headline}")
