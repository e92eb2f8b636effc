"""The bundle of an exported policy, and whether it fits a scenario.

policy.onnx     what sensors measure in, the commands of actuators out, in SI units
bundle.json     its inputs and outputs, in order: units, frames, ranges, rates, ages, limits; the result with
                its interval, versions
parity.npz      recorded steps, which `deepbots_robot.load` repeats
README.md       the same for people
scenario.yaml   the scenario, which defines the names; its robot files are in the folder inputs
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Collection
from pathlib import Path, PurePath, PurePosixPath
from typing import TYPE_CHECKING

import deepbots_cli
from deepbots_cli import api
from deepbots_cli.compiler.inputs import INPUTS_FOLDER
from deepbots_cli.document import Permissions
from deepbots_cli.errors import MissingExtraError, RunError, UsageError
from deepbots_cli.insight.statements import render_template
from deepbots_cli.learning.runs.run import ModelName, ModelRef, Run, steps_of
from deepbots_cli.learning.runs.verdict import RunVerdict, last_episodes, run_verdict
from deepbots_cli.program import Program, identity
from deepbots_cli.program.task import ActionRange
from deepbots_cli.rollout.source import Source, SourceKind
from deepbots_cli.words import unit_text

if TYPE_CHECKING:
    from deepbots_cli.insight.export.control import ControlStep
    from deepbots_robot.model import ActionPart, BundleInfo, Input, Output, RobotFile, RosTopic

_LICENSE = re.compile(r"SPDX-License-Identifier:\s*([A-Za-z0-9(][\w.+() -]*)")
_SCENARIO_SUFFIXES = (".yaml", ".yml")


def bundle_files(run: Run, name: ModelName, key: Path | None = None) -> dict[PurePosixPath, bytes]:
    """Return the files of the bundle of a run. A simulation of some hundred steps checks that its commands
    are those of the scenario.

    Args:
        run: The run.
        name: Its model.
        key: A file with a private key, which signs the bundle.

    Raises:
        MissingExtraError: onnx, onnxruntime or the extra `train` is not installed.
        RunError: There is no such model, or it is damaged.
        UsageError: The scenario or the policy cannot be exported, or the key cannot be read.
    """
    try:
        import msgspec

        from deepbots_cli.insight.export.control import control_step
        from deepbots_cli.insight.export.network import check_network, numbers_read
        from deepbots_cli.insight.export.parity import recorded_parity
        from deepbots_cli.learning import policy
        from deepbots_cli.learning.sb3.algorithms import torch_settings
        from deepbots_robot import bundle, model, signature
    except ModuleNotFoundError as error:
        raise MissingExtraError("export", "exporting a policy") from error
    learner = policy.loaded(run, name)
    check_network(learner, run.program)
    step = control_step(run.program, learner)
    info = _info(run, name, step)
    graph = step.model({bundle.METADATA_KEY: bundle.description_digest(info)})
    with torch_settings():
        parity = recorded_parity(
            bundle.Bundle(info, graph), step, learner, engine=run.engine_for(run.program)
        )
    readme = render_template(
        "export/bundle.md.j2",
        info=info,
        used=numbers_read(graph),
        numbers=run.program.agent.numbers,
        places=_message_paths(info),
    )
    # The scenario names the copies of its robot files. It contains the YAML files that it extends or
    # includes.
    robots = [name for name in run.record.inputs if not name.endswith(_SCENARIO_SUFFIXES)]
    files = {
        bundle.GRAPH_NAME: graph,
        bundle.PARITY_NAME: parity,
        bundle.README_NAME: readme.encode(),
        bundle.SCENARIO_NAME: run.resolved.encode(),
        **{f"{INPUTS_FOLDER}/{name}": (run.path / INPUTS_FOLDER / name).read_bytes() for name in robots},
    }
    info = msgspec.structs.replace(
        info, files={name: hashlib.sha256(content).hexdigest() for name, content in files.items()}
    )
    description = model.encode(info)
    try:
        model.decode(description)
    except model.BundleError as error:
        raise UsageError(f"a robot could not read this bundle: {error}") from error
    files = {bundle.BUNDLE_NAME: description, **files}
    if key is not None:
        try:
            # The description has the digests of all other files, so that one signature covers them.
            files[bundle.SIGNATURE_NAME] = signature.sign(description, key)
        except signature.KeyFileError as error:
            raise UsageError(str(error)) from error
    return {PurePosixPath(name): content for name, content in files.items()}


def files_for(run: Run, name: ModelName, reader: str) -> dict[PurePosixPath, bytes]:
    """Return the files of `export --to` for a reader: `isaac-lab`, `lerobot` or `hub`.

    Raises:
        MissingExtraError: onnx or the extra `train` is not installed.
        RunError: There is no such model, or it is damaged.
        UsageError: The scenario does not fit this form.
    """
    if reader == "isaac-lab":
        from deepbots_cli.insight.export.deploy import deploy_settings

        # A scenario that does not fit is refused within 1 s; the imports and the model below take 7 s.
        deploy_settings(run.program)
    try:
        from deepbots_cli.insight.export import deploy, hub, lerobot
        from deepbots_cli.learning import policy
    except ModuleNotFoundError as error:
        raise MissingExtraError("export", "exporting a policy") from error
    if reader == "hub":
        return hub.hub_files(run, name)
    emit = deploy.isaac_files if reader == "isaac-lab" else lerobot.lerobot_files
    return emit(run.program, policy.loaded(run, name))


def _info(run: Run, name: ModelName, step: ControlStep) -> BundleInfo:
    """Return the content of bundle.json, without the digests of the files."""
    from deepbots_robot import model

    program, record = run.program, run.record
    if name == "best":
        verdict = run_verdict(run.path, record)
    else:
        newest = last_episodes(ModelRef(run, name, is_named=True))
        verdict = RunVerdict(newest[1].solved, newest[1]) if newest else RunVerdict(None, None)
    if program.others is not None:
        verdict = verdict.of_agent(program.others.agent)
    result = verdict.evaluation
    evaluation = None
    if result is not None:
        fields = result.model_dump(include={*model.Evaluation.__struct_fields__} - {"text", "solved"})
        evaluation = model.Evaluation(text=verdict.text, solved=verdict.solved, **fields)
    return model.BundleInfo(
        format=model.FORMAT,
        deepbots=deepbots_cli.__version__,
        scenario=model.Scenario(
            name=program.name,
            summary=program.summary,
            digest=run.digest,
            task_digest=identity.task_digest(program),
            robots=_robot_files(run),
            interface={agent: dict(items) for agent, items in identity.interface(program).items()},
            licenses=_licenses(run.path / INPUTS_FOLDER),
        ),
        training=model.Training(
            algorithm=program.agent.training.algorithm if program.agent.training else "",
            model=name,
            seed=record.seed,
            steps=steps_of(run.model(name)),
            engine=record.engine,
            versions=dict(record.versions),
        ),
        rate_hz=round(1.0 / step.timestep, 9),
        timestep_s=step.timestep,
        inputs=tuple(reading.info for reading in step.readings.values()),
        memory=tuple(step.memories),
        outputs=tuple(step.outputs),
        action=tuple(_action_parts(program)),
        files={},
        evaluation=evaluation,
        ros=ros_topics(program, {*step.readings, *(output.name for output in step.outputs)}),
    )


def ros_topics(program: Program, names: Collection[str]) -> dict[str, RosTopic]:
    """Return the ROS 2 topics of these inputs and outputs. Readings of the world have default topics that
    fit."""
    from deepbots_cli.program.topics import mapping
    from deepbots_robot.model import RosTopic

    return {
        name: RosTopic(topic=topic.name, type=topic.type, part=topic.part)
        for name, topic in mapping(program).items()
        if name in names
    }


def _message_paths(info: BundleInfo) -> dict[str, str]:
    """Return the path of each field in its ROS message, in words."""
    from deepbots_robot.serving import field_of
    from deepbots_robot.topics import Topic, part_of, parts

    paths = {}
    entries: list[Input | Output] = [*info.inputs, *info.outputs]
    for entry in entries:
        if (ros_place := info.ros.get(entry.name)) is not None:
            field = field_of(entry)
            part = parts(ros_place.type)[
                part_of(field, Topic(ros_place.topic, ros_place.type, ros_place.part))
            ]
            if part.by_joint:
                order = f"of {', '.join(field.joints)}, by `name`"
            elif part.count is None:
                order = "in the order of the table"
            else:
                order = ""
            paths[entry.name] = f"`{part.path}` {order}".strip()
    return paths


def _action_parts(program: Program) -> list[ActionPart]:
    from deepbots_robot.model import ActionPart

    parts = []
    for part in program.agent.action:
        if isinstance(part, ActionRange):
            parts += [
                ActionPart(name=name, unit=unit_text(part.unit), low=part.low, high=part.high)
                for name in part.names
            ]
        else:
            options = {
                option.name: dict(zip(part.variables, map(float, option.values), strict=True))
                for option in part.options
            }
            parts.append(ActionPart(name=part.name, options=options))
    return parts


def _robot_files(run: Run) -> dict[str, RobotFile]:
    """Return the file of each robot with its digest."""
    from deepbots_robot.model import RobotFile

    spec = api.load(Source.open(run.path, Permissions(), SourceKind.RUN)).spec
    robot_files = {}
    for name, robot in (spec.robots if spec is not None else {}).items():
        file = PurePath(str(robot.urdf)).relative_to(INPUTS_FOLDER).as_posix()
        robot_files[name] = RobotFile(
            file=file, digest=hashlib.sha256((run.path / INPUTS_FOLDER / file).read_bytes()).hexdigest()
        )
    return robot_files


def _licenses(inputs: Path) -> dict[str, str]:
    """Return the SPDX identifiers in the scenario and robot files of a run, by file."""
    texts = {
        path.relative_to(inputs).as_posix(): path.read_text("utf-8", errors="replace")
        for path in sorted(inputs.rglob("*"))
        if path.suffix in (*_SCENARIO_SUFFIXES, ".urdf", ".xacro")
    }
    return {name: match[1].strip(" -") for name, text in texts.items() if (match := _LICENSE.search(text))}


# Whether it fits


def read_bundle(folder: Path) -> BundleInfo:
    """Read the bundle.json of a bundle that passes all checks of `deepbots_robot.load`.

    Raises:
        MissingExtraError: onnxruntime is not installed.
        RunError: The folder is not a bundle, or one of its files is damaged, of another format or not the one
            that was exported.
    """
    try:
        import deepbots_robot
    except ModuleNotFoundError as error:
        raise MissingExtraError("robot", "reading a bundle") from error
    try:
        return deepbots_robot.load(folder).info
    except deepbots_robot.BundleError as error:
        raise RunError(str(error)) from error


def remarks(info: BundleInfo, program: Program, diff: str) -> list[str]:
    """Return the differences of a scenario that the policy fits, one sentence each. `diff` is the command
    that shows all differences."""
    texts = []
    if not math.isclose(info.timestep_s, program.period):
        texts.append(
            f"the policy was trained with an action every {info.timestep_s:g} s, but the scenario has one"
            f" every {program.period:g} s"
        )
    if info.scenario.task_digest != identity.task_digest(program):
        texts.append(
            "rewards, endings, starts or the world differ from the training; to see the differences, run:"
            f" {diff}"
        )
    return texts
