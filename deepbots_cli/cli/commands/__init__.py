"""The commands in the groups and the order of `deepbots --help`, and the line of each in the help.

A command is the function `command` of the module with its name. One with little code of its own is
`command_NAME` in the module of another command (`BESIDE`):

compare.py      diff, runs       lint.py      fmt          train.py      resume, repeat, tune, apply
view.py         play, studio,    try_.py      test         transfer.py   robustness, diagnose
                replay           new.py       scenarios    compile.py    lsp
render.py       report, plot     export.py    serve        bench.py      doctor
course.py       grade

`webots` is in deepbots-webots. The module is imported when the command is called. The rest of its help is in
`../help/NAME.txt`.
"""

from __future__ import annotations

from collections.abc import Mapping
from keyword import iskeyword

GROUPS: Mapping[str, Mapping[str, str]] = {
    "Start": {
        "new": "Write a scenario: from a template, a copy, or a robot file.",
        "try": "Run a few episodes without training, and show the reward.",
        "studio": "Write, watch and train a scenario on one page of the browser.",
        "play": "Drive the robot of a scenario in the browser.",
        "scenarios": "List the scenarios that come with deepbots.",
        "explain": "Explain a finding of lint, a key of scenario files, or a term.",
    },
    "Check": {
        "lint": "Check scenarios and report every problem.",
        "inspect": "Show robots, messages, observation and reward as tables.",
        "test": "Run the tests of scenarios.",
        "fmt": "Format scenario files in the canonical layout.",
        "diff": "Show what differs between two scenarios.",
    },
    "Train": {
        "train": "Train a policy in a new run directory, and evaluate it.",
        "resume": "Continue a training, a group of trainings, or a study.",
        "repeat": "Train a run again, and compare the two policies.",
        "tune": "Search for better values of a scenario.",
        "apply": "Write the best values of a search into the scenario file.",
        "eval": "Evaluate the policy of a run on held-out episodes.",
        "runs": "List your trainings, with their results.",
        "compare": "Compare trained policies on the same start states.",
        "robustness": "Evaluate a policy with sensor noise, delays and weaker motors.",
    },
    "Understand": {
        "view": "Watch a policy, a scenario or a recording in the browser.",
        "diagnose": "Explain why a training does not learn, or why an episode ended.",
        "plot": "Plot the learning curves of runs.",
        "replay": "List the episodes of a recording, or run them again and compare.",
    },
    "Learn": {
        "course": "Learn in lessons that mark themselves.",
        "grade": "Mark what students handed in.",
    },
    "Share": {
        "render": "Make a picture, a video or GIF, an offline page or a recording.",
        "report": "Write a report about a run: one HTML file to send.",
    },
    "Robot": {
        "transfer": "Check that a policy works in another engine or world.",
        "export": "Export the policy of a run for a robot.",
        "serve": "Let a policy act for a robot, or simulate the robot.",
        "webots": "Run a project of Webots: a world and its controllers.",
    },
    "Develop": {
        "compile": "Print the Python module that a scenario compiles to.",
        "bench": "Measure how long a step takes, and the physics in it.",
        "lsp": "For editors: run the language server, or print the JSON Schema.",
        "doctor": "Check the installation.",
    },
}

COMMANDS: Mapping[str, str] = {name: line for group in GROUPS.values() for name, line in group.items()}
"""The line of each command."""

REPLACEMENTS: Mapping[str, str] = {
    "run": "deepbots try SCENARIO",
    "copy": "deepbots new NAME --from SCENARIO",
    "list": "deepbots scenarios",
    "picture": "deepbots render SCENARIO -o picture.png",
    "clip": "deepbots render SCENARIO -o video.mp4",
    "record": "deepbots render SCENARIO -o episode.mcap",
    "explain-episode": "deepbots diagnose RUN --episode K",
    "eject": "deepbots compile SCENARIO --project DIR",
    "schema": "deepbots lsp --schema",
    "publish": "deepbots export RUN --to hub",
    "--resume": "deepbots resume RUN",
    "--apply": "deepbots apply STUDY FILE",
    "--script": "--driver NAME",
    "--policy": "--driver NAME",
    "--actions": "--driver ACTION,ACTION",
    "--driver": "deepbots try SCENARIO --driver NAME",
    "--out": "--output FILE",
    "--ros1": "--ros with ros1_bridge, --zmq ADDRESS or --websocket PORT",
    "--picture": "deepbots render SCENARIO -o picture.png",
    "--video": "deepbots render RUN -o video.mp4",
    "--robustness": "deepbots robustness RUN",
}
"""The commands and options to write instead of other names that people look for."""
GONE: Mapping[str, str] = {
    "--keep": "name the model in place of the run, such as RUN/models/agent/last.zip",
    "--retry": "after a training that is not solved, `train` prints the command with the advised values",
    "--shards auto": "write the number of cores, and compare the steps/s of trainings with fewer",
    "--to leapp": "leave out --to: a bundle has the same graph, policy.onnx",
}
"""The options, and the values of options, that are gone, and what to do instead."""


NEEDS: Mapping[str, Mapping[str, str]] = {
    "bench": {"--worlds": "--engine"},
    "eval": {"--junit": "--min-success --min-return --require-solved"},
    "lint": {"--unsafe-fixes": "--fix --diff"},
    "lsp": {"--for --output": "--schema"},
    "new": {"--kind --task --xacro-arg --copy": "--urdf", "--protos": "--webots"},
    "replay": {"--tolerance": "--verify"},
    "serve": {
        "--episodes --seed --set --engine --allow-path --allow-code": "--as-robot; belongs to a simulated robot"
    },
    "try": {"--lockstep --speed": "--robot"},
    "webots": {
        "--open --port": "--view",
        "--steps --view": "--allow-code; runs the programs of the project, which you should trust",
    },
}
"""The options, by command, that need one of other options, and after a semicolon what they do."""
EXCLUDES: Mapping[str, Mapping[str, str]] = {
    "": {"--workers": "--cluster"},
    "compare": {"--own": "--scenario; evaluates each run in its own scenario"},
    "compile": {
        "--program": "--json --target --project; prints the scenario itself, as JSON",
        "--project": "--output --target; writes the module for one world",
    },
    "export": {
        "--new-key": "--output --to --last --check --sign; makes a key and exports nothing",
        "--sign": "--check --to; signs a bundle",
        "--check": "--output --last --to --agent --force; writes nothing",
    },
    "lint": {
        "--json": "--format",
        "--deep --exploits": "--fix --diff --unsafe-fixes; has findings without automatic fixes",
        "--set": "--fix --diff; changes no file",
        "--diff": "--format --json --statistics; prints changes instead of findings",
        "--watch": "--fix --diff; reads files and changes none",
    },
    "new": {
        "--template --from --urdf --webots --lesson": "--template --from --urdf --webots --lesson",
        "--project": "--schema; writes a schema for all its scenarios",
        "--lesson": "--project --schema; writes no scenario of its own",
    },
    "render": {"--follow": "--from --at; moves the camera"},
    "serve": {
        "--ros --zmq --websocket": "--ros --zmq --websocket",
        "--interface --domain": "--zmq --websocket; belongs to ROS 2",
        "--log --seconds --trusted": "--as-robot; belongs to the policy",
    },
    "train": {"--seed": "--seeds", "--view": "--seeds; shows a single run"},
    "transfer": {
        "--log": "--engine --scenario --set --min-success --min-return --episodes --quick --seed --workers"
        " --cluster; compares a log with the simulation of one run"
    },
}
"""The options, by command and for all commands, that exclude others, and after a semicolon what they do."""
TAKES: Mapping[str, Mapping[str, str]] = {
    "compare": {"agents that compete": "--episodes --seed --last --scenario"},
    "course": {
        "list": "--workers",
        "start": "--with",
        "check": "--workers",
        "hint": "--step --workers",
        "next": "--with",
        "verify": "--no-train --workers",
    },
    "diagnose": {
        "a training": "--only-logs --agent",
        "an episode": "--episode --seed --last --agent",
        "--episode failed": "--episode --agent",
        "a recording": "--episode",
        "the file of a failed episode": "",
        "the log of a robot": "--episode",
    },
    "eval": {
        "--episodes failed": "--episodes",
        "a group": "all but --baselines --details; name one of its runs",
        "several engines": "all but --baselines --details; name one engine",
    },
    "export": {
        "a new key": "--new-key",
        "a policy": "all but --set --allow-path; it is exported as it was trained",
    },
    "lint": {
        "a robot file": "all but --set --deep --exploits; it is only read",
        "standard input": "all but --exploits --watch --fix --diff; name a file",
        "files": "all but --stdin-filename; it names the file of standard input, -",
    },
    "render": {
        "a robot file": "--output --size --from --at --engine --xacro-arg",
        "--episodes failed": "all but --seed --episode --driver --last; it repeats an evaluation of a run",
    },
    "replay": {"the log of a robot": ""},
    "resume": {
        "a study": "--trials --workers --cluster",
        "a group of seeds": "--timesteps --full --callback --logger --workers --cluster",
        "a run": "--timesteps --full --callback --logger --workers --cluster --view",
    },
    "try": {"the file of a failed episode": ""},
}
"""The options, by command and by what it is asked about, that it takes beside those for files and output, or
`all but` some, and after a semicolon the reason."""
BESIDE: Mapping[str, str] = {
    "apply": "train",
    "diagnose": "transfer",
    "diff": "compare",
    "doctor": "bench",
    "fmt": "lint",
    "grade": "course",
    "lsp": "compile",
    "play": "view",
    "plot": "render",
    "replay": "view",
    "repeat": "train",
    "report": "render",
    "resume": "train",
    "robustness": "transfer",
    "runs": "compare",
    "scenarios": "new",
    "serve": "export",
    "studio": "view",
    "test": "try_",
    "tune": "train",
}
"""The commands that share the module of another one."""


def function_name(name: str) -> tuple[str, str]:
    """Return the names of the module and of the function of a command; the module of a keyword of Python,
    such as `try`, ends with `_`."""
    if name in BESIDE:
        return BESIDE[name], f"command_{name}"
    return f"{name}_" if iskeyword(name) else name, "command"
