"""The verbs in the order of `deepbots --help`. Each is the function `command` of its module, which is imported when the verb is called."""

from __future__ import annotations

from collections.abc import Mapping

VERBS: Mapping[str, str] = {
    "train": "Train a policy in a new run directory, and evaluate it.",
    "eval": "Evaluate the policy of a run on held-out episodes.",
    "compare": "Compare policies on the same starts.",
    "plot": "Plot the training of runs over the timesteps.",
    "lint": "Check scenarios and report every problem.",
    "explain": "Explain a finding, a word of the language, or a glossary term.",
    "fmt": "Format scenario files in the canonical layout.",
    "lsp": "Run the language server: findings, completion, hover, fixes.",
    "inspect": "Show the values of a scenario, a run or a robot file as tables.",
    "run": "Run episodes without a trained policy, and show the reward terms.",
    "view": "Show a scenario, a run or a recording in the browser.",
    "play": "Drive the robot of a scenario in the browser.",
    "picture": "Draw a picture of a scenario.",
    "clip": "Make a moving picture of an episode: MP4, GIF or an offline page.",
    "record": "Record episodes as an MCAP file.",
    "replay": "Show what a recording holds, or run it again and compare.",
    "compile": "Print the Python module that a scenario compiles to.",
    "diff": "Compare the meaning of two scenarios.",
    "new": "Write a first scenario from a template or for a robot file.",
    "copy": "Copy a scenario that comes with deepbots, and its files.",
    "upgrade": "Upgrade a scenario file to the current version of the language.",
    "eject": "Write a scenario as a Python project that you can edit.",
    "list": "List the scenarios that come with deepbots, and your runs.",
    "bench": "Compare the time of a step with the time of the physics alone.",
    "schema": "Print the JSON Schema of scenario files, for editors.",
    "doctor": "Check the installation.",
}
