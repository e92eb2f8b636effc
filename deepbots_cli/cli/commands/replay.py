"""`deepbots replay`: what a recording holds, and whether it happens again."""

from __future__ import annotations

from contextlib import closing
from typing import Annotated

import typer

from deepbots_cli.cli import terminal
from deepbots_cli.cli.command import AllowCode, Json
from deepbots_cli.cli.exits import FAILED


def command(
    recording: Annotated[str, typer.Argument(metavar="RECORDING", help="A file that `deepbots record` wrote.")],
    to_verify: Annotated[bool, typer.Option("--verify", help="Run the episodes again, and compare every step bit for bit.")] = False,
    as_json: Json = False,
    allow_code: AllowCode = False,
) -> None:
    """Show the contents of a recording, or run it again and compare.

    With --verify, the scenario in the recording is compiled, each episode starts from its seed and takes its recorded actions. The command
    names the first step and the first quantity that differ, with exit code 1. On the machine of the recording, with the same
    versions, nothing differs.

    \b
      deepbots replay find_ball-0-0.mcap
      deepbots replay --verify find_ball-0-0.mcap

    Next: `deepbots view RECORDING` plays it in the browser.
    """
    from deepbots_cli.view.episodes import Player, Source
    from deepbots_cli.view.replay import Replayed, changes, verify

    opened = Source(recording if recording.endswith(".mcap") else f"{recording}.mcap", allow_code=allow_code).open()
    found, notes = opened.recording, changes(opened.recording)
    if not to_verify:
        with closing(Replayed(opened)) as player:
            ends = [(each.number, player.begin(0, each.number), player.seek(len(each.steps))) for each in found.episodes]
        rows = [
            {"episode": number, "steps": last.step, "ending": last.ending, "return": next(iter(last.agents.values())).episode_return}
            for number, _, last in ends
        ]
        if as_json:
            terminal.show_json({"recording": found.path, **found.metadata, "episodes": rows})
            return
        scenario, source, seed, driver, engine = (
            found.metadata.get(name, "?") for name in ("scenario", "source", "seed", "driver", "engine")
        )
        terminal.say(f"{scenario} ({source}), seed {seed}, driven by {driver}, engine {engine}")
        for row in rows:
            terminal.say(f"episode {row['episode']}: {row['ending']} after {row['steps']} steps, return {row['return']:.2f}")
        terminal.note(f"\nnext:\n  deepbots replay --verify {recording}")
        return
    for note in notes:
        terminal.note(note)
    with closing(Player(opened, "zero")) as player, terminal.progress(always=False) as show:
        count = len(found.episodes)
        difference = verify(found, player, lambda done: show(done, count) if show else None)
    if as_json:
        terminal.show_json(
            {"recording": found.path, "same": difference is None, "first": difference and difference._asdict(), "notes": notes}
        )
    elif difference is None:
        steps = sum(len(each.steps) - 1 for each in found.episodes)
        terminal.say(f"{found.path}: {count} episode{'s' * (count > 1)} and {steps} steps are the same to the bit")
    else:
        terminal.say(f"{found.path}: episode {difference.episode}, step {difference.step}: {difference.quantity} differs")
        terminal.say(f"  recorded {difference.recorded}\n  now      {difference.now}")
    if difference is not None:
        raise typer.Exit(FAILED)
