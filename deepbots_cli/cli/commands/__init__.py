"""The commands in the order of `deepbots --help`: the module and function of each, and its line in the help.

A module is imported when one of its commands is called.
"""

from __future__ import annotations

from collections.abc import Mapping

COMMANDS: Mapping[str, tuple[str, str]] = {
    "train": ("train.command", "Train a policy in a new run directory, and evaluate it."),
    "eval": ("eval.command", "Evaluate the policy of a run on held-out episodes."),
    "compare": ("compare.command", "Compare policies on the same starts."),
    "explain-episode": ("insight.explain_episode", "Explain why an episode ended as it did."),
    "diagnose": ("insight.diagnose", "Tell why a training does not learn."),
    "runs": ("runs.command", "List your runs and groups, with their results."),
    "plot": ("plot.command", "Plot the training of runs over the timesteps."),
    "report": ("report.command", "Write a report about a run or a group: one HTML file."),
    "export": ("export.command", "Export the policy of a run as ONNX."),
    "lint": ("lint.lint", "Check scenarios and report every problem."),
    "test": ("test.command", "Run the tests of scenarios."),
    "explain": ("explain.command", "Explain a finding, a word of the language, or a term."),
    "fmt": ("rewriting.fmt", "Format scenario files in the canonical layout."),
    "lsp": ("lint.lsp", "Run the language server: findings, completion, hover."),
    "inspect": ("inspect.command", "Show a scenario, a run or a robot file as tables."),
    "run": ("run.command", "Run episodes without a policy, and show the reward terms."),
    "view": ("view.view", "Show a scenario, a run or a recording in the browser."),
    "play": ("view.play", "Drive the robot of a scenario in the browser."),
    "picture": ("view.picture", "Draw a picture of a scenario."),
    "clip": ("view.clip", "Make a video of an episode: MP4, GIF or an offline page."),
    "record": ("record.command", "Record episodes as an MCAP file."),
    "replay": ("replay.command", "Show a recording, or run it again and compare."),
    "compile": ("code.compile_", "Print the Python module that a scenario compiles to."),
    "diff": ("diff.command", "Compare the meaning of two scenarios."),
    "new": ("new.new", "Write a first scenario from a template or for a robot file."),
    "copy": ("new.copy", "Copy a scenario that comes with deepbots, and its files."),
    "eject": ("code.eject", "Write a scenario as a Python project that you can edit."),
    "list": ("installation.list_", "List the scenarios that come with deepbots."),
    "bench": ("bench.command", "Compare the time of a step with that of the physics."),
    "schema": ("code.schema", "Print the JSON Schema of scenario files, for editors."),
    "doctor": ("installation.doctor", "Check the installation."),
}
