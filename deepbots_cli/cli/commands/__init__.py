"""The commands in the groups and the order of `deepbots --help`: the module and function of each, and its line in the help.

A module is imported when one of its commands is called.
"""

from __future__ import annotations

from collections.abc import Mapping

GROUPS: Mapping[str, Mapping[str, tuple[str, str]]] = {
    "Start": {
        "new": ("new.new", "Write a scenario: from a template, a copy, or a robot file."),
        "try": ("episodes.command", "Run a few episodes without training, and show the reward."),
        "play": ("view.play", "Drive the robot of a scenario in the browser."),
        "scenarios": ("installation.scenarios", "List the scenarios that come with deepbots."),
        "explain": ("explain.command", "Explain a finding, a word of the language, or a term."),
    },
    "Check": {
        "lint": ("lint.lint", "Check scenarios and report every problem."),
        "inspect": ("inspect.command", "Show a scenario, a run or a robot file as tables."),
        "test": ("test.command", "Run the tests of scenarios."),
        "fmt": ("rewriting.fmt", "Format scenario files in the canonical layout."),
        "diff": ("diff.command", "Compare the meaning of two scenarios."),
    },
    "Train": {
        "train": ("train.command", "Train a policy in a new run directory, and evaluate it."),
        "eval": ("eval.command", "Evaluate the policy of a run on held-out episodes."),
        "runs": ("runs.command", "List your runs and groups, with their results."),
        "compare": ("compare.command", "Compare policies on the same starts."),
    },
    "Understand": {
        "view": ("view.view", "Show a scenario, a run or a recording in the browser."),
        "diagnose": ("insight.diagnose", "Tell why a training does not learn."),
        "explain-episode": ("insight.explain_episode", "Explain why an episode ended as it did."),
        "plot": ("plot.command", "Plot the training of runs over the timesteps."),
        "replay": ("replay.command", "Show a recording, or run it again and compare."),
    },
    "Share": {
        "picture": ("view.picture", "Draw a picture of a scenario."),
        "clip": ("view.clip", "Make a video of an episode: MP4, GIF or an offline page."),
        "record": ("record.command", "Record episodes as an MCAP file."),
        "report": ("report.command", "Write a report about a run or a group: one HTML file."),
        "export": ("export.command", "Export the policy of a run as ONNX."),
    },
    "Develop": {
        "compile": ("code.compile_", "Print the Python module that a scenario compiles to."),
        "bench": ("bench.command", "Compare the time of a step with that of the physics."),
        "schema": ("code.schema", "Print the JSON Schema of scenario files, for editors."),
        "lsp": ("lint.lsp", "Run the language server: findings, completion, hover."),
        "doctor": ("installation.doctor", "Check the installation."),
    },
}

COMMANDS: Mapping[str, tuple[str, str]] = {name: entry for group in GROUPS.values() for name, entry in group.items()}

REPLACEMENTS: Mapping[str, str] = {
    "run": "deepbots try SCENARIO",
    "copy": "deepbots new NAME --from SCENARIO",
    "list": "deepbots scenarios",
    "eject": "deepbots compile SCENARIO --project DIR",
    "--script": "--driver NAME",
    "--policy": "--driver NAME",
    "--actions": "--driver ACTION,ACTION",
    "--out": "--output FILE",
}
"""What to write instead of commands and options that people look for under another name."""
