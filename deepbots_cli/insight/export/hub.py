"""A policy as a repository of a model hub: a card with metadata, the model, a video of an episode if this
machine can draw, and the bundle in a folder of its own. Nothing is uploaded."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory

from deepbots_cli.errors import EngineError, MissingExtraError
from deepbots_cli.insight.export import bundle
from deepbots_cli.insight.statements import render_template
from deepbots_cli.learning.runs.run import ModelName, Run
from deepbots_cli.scenario.training import ALGORITHMS
from deepbots_cli.view import pictures
from deepbots_cli.view.episodes import Showing
from deepbots_cli.view.replay import closing_player
from deepbots_robot.bundle import BUNDLE_NAME
from deepbots_robot.model import decode


def hub_files(run: Run, name: ModelName) -> dict[PurePosixPath, bytes]:
    """Return the files of the repository, without a video where nothing draws or encodes one.

    Raises:
        MissingExtraError, RunError, UsageError: As for `bundle_files`.
    """
    files = {"bundle" / path: content for path, content in bundle.bundle_files(run, name).items()}
    with TemporaryDirectory() as folder, suppress(EngineError, MissingExtraError):
        pictures.check_target(video := Path(folder, "replay.mp4"), (".mp4",), force=True)
        with closing_player(Showing(str(run.path), model=name, is_model_named=True), None) as player:
            pictures.write_clip(player, video, pictures.Viewpoint(480, 320), seed=run.record.seed, episode=0)
        files[PurePosixPath(video.name)] = video.read_bytes()
    info = decode(files["bundle" / PurePosixPath(BUNDLE_NAME)])
    package, _, kind = ALGORITHMS[info.training.algorithm].import_path.partition(":")
    is_sb3, program = package in ("stable_baselines3", "sb3_contrib"), run.program
    # A critic that sees more has layers of deepbots, and an environment of several agents another action.
    loads_alone = is_sb3 and not program.agent.critic and program.others is None
    card = render_template(
        "export/hub.md.j2",
        info=info,
        is_sb3=is_sb3,
        algorithm=(package, kind) if loads_alone else None,
        has_video=PurePosixPath("replay.mp4") in files,
    )
    return {
        PurePosixPath("README.md"): card.encode(),
        PurePosixPath("policy.zip"): run.model(name).read_bytes(),
        **files,
    }
