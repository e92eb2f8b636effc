"""The verbs in the order of `deepbots --help`; each is the function `command` of the module of its name."""

from __future__ import annotations

from collections.abc import Mapping

VERBS: Mapping[str, str] = {
    "train": "Train a policy in a new run directory, and evaluate it.",
    "eval": "Evaluate the policy of a run on held-out episodes.",
    "lint": "Check scenarios and report every problem.",
    "explain": "Explain a finding: what it means, and what to write instead.",
    "fmt": "Put scenario files into the canonical layout.",
    "lsp": "Serve an editor: findings as you type, completion, fixes.",
    "inspect": "Show what a scenario means: spaces, messages, reward, timing.",
    "run": "Run episodes without a trained policy, and show the reward terms.",
    "compile": "Print the Python that a scenario is compiled to.",
    "diff": "Compare two scenarios by meaning.",
    "new": "Write a first scenario, with a comment on every part.",
    "copy": "Copy a scenario that comes with deepbots, to change it.",
    "upgrade": "Bring a scenario file to the current version of the language.",
    "eject": "Write a scenario out as a small Python project of its own.",
    "list": "List the scenarios that come with deepbots, and your runs.",
    "bench": "Time a step of the environment against bare physics.",
    "schema": "Print the JSON Schema of scenario files, for editors.",
    "doctor": "Check the installation.",
}
