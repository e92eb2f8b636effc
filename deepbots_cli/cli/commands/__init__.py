"""The commands in the groups and the order of `deepbots --help`: the module and function of each, and its
line in the help.

A module is imported when one of its commands is called. The rest of the help of a command is in
`../help/NAME.txt`.
"""

from __future__ import annotations

from collections.abc import Mapping

GROUPS: Mapping[str, Mapping[str, tuple[str, str]]] = {
    "Start": {
        "new": ("new.new", "Write a scenario: from a template, a copy, or a robot file."),
        "try": ("episodes.command", "Run a few episodes without training, and show the reward."),
        "studio": (
            "studio.command",
            "Write, watch and train a scenario on one page of the browser.",
        ),
        "play": ("view.play", "Drive the robot of a scenario in the browser."),
        "scenarios": ("installation.scenarios", "List the scenarios that come with deepbots."),
        "explain": ("explain.command", "Explain a finding of lint, a key of scenario files, or a term."),
    },
    "Check": {
        "lint": ("lint.lint", "Check scenarios and report every problem."),
        "inspect": ("inspect.command", "Show robots, messages, observation and reward as tables."),
        "test": ("test.command", "Run the tests of scenarios."),
        "fmt": ("rewriting.fmt", "Format scenario files in the canonical layout."),
        "diff": ("diff.command", "Show what differs between two scenarios."),
    },
    "Train": {
        "train": ("train.command", "Train a policy in a new run directory, and evaluate it."),
        "resume": ("resume.resume", "Continue a training, a group of trainings, or a study."),
        "tune": ("tune.command", "Search for better values of a scenario."),
        "apply": ("resume.apply", "Write the best values of a search into the scenario file."),
        "eval": ("eval.command", "Evaluate the policy of a run on held-out episodes."),
        "runs": ("runs.command", "List your trainings, with their results."),
        "compare": ("compare.command", "Compare trained policies on the same start states."),
        "robustness": (
            "robustness.command",
            "Evaluate a policy with sensor noise, delays and weaker motors.",
        ),
    },
    "Understand": {
        "view": ("view.view", "Watch a policy, a scenario or a recording in the browser."),
        "diagnose": ("diagnose.command", "Explain why a training does not learn, or why an episode ended."),
        "plot": ("plot.command", "Plot the learning curves of runs."),
        "replay": ("replay.command", "List the episodes of a recording, or run them again and compare."),
    },
    "Share": {
        "render": ("render.command", "Make a picture, a video or GIF, an offline page or a recording."),
        "report": ("report.command", "Write a report about a run: one HTML file to send."),
    },
    "Robot": {
        "transfer": ("transfer.command", "Check that a policy works in another engine or world."),
        "export": ("export.command", "Export the policy of a run for a robot."),
        "serve": ("serve.command", "Let a policy act for a robot, or simulate the robot."),
        "webots": ("webots.command", "Run a project of Webots: a world and its controllers."),
    },
    "Develop": {
        "compile": ("code.compile_", "Print the Python module that a scenario compiles to."),
        "bench": ("bench.command", "Measure how long a step takes, and the physics in it."),
        "lsp": ("lint.lsp", "For editors: run the language server, or print the JSON Schema."),
        "doctor": ("installation.doctor", "Check the installation."),
    },
}

COMMANDS: Mapping[str, tuple[str, str]] = {
    name: entry for group in GROUPS.values() for name, entry in group.items()
}

REPLACEMENTS: Mapping[str, str] = {
    "run": "deepbots try SCENARIO",
    "copy": "deepbots new NAME --from SCENARIO",
    "list": "deepbots scenarios",
    "picture": "deepbots render SCENARIO -o picture.png",
    "clip": "deepbots render SCENARIO -o video.mp4",
    "record": "deepbots render SCENARIO -o episode.mcap",
    "explain-episode": "deepbots diagnose RUN --episode K",
    "eject": "deepbots compile SCENARIO --project DIR",
    "--resume": "deepbots resume RUN",
    "--apply": "deepbots apply GROUP FILE",
    "--script": "--driver NAME",
    "--policy": "--driver NAME",
    "--actions": "--driver ACTION,ACTION",
    "--driver": "deepbots try SCENARIO --driver NAME",
    "--out": "--output FILE",
    "--picture": "deepbots render SCENARIO -o picture.png",
    "--video": "deepbots render RUN -o video.mp4",
    "--robustness": "deepbots robustness RUN",
}
"""The commands and options to write instead of other names that people look for."""
