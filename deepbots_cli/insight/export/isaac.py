"""A policy in the form that runners of Isaac Lab read: `exported/policy.onnx` over observations, and
`params/deploy.yaml` around it."""

from __future__ import annotations

from pathlib import PurePosixPath

import numpy as np
import yaml

from deepbots_cli.insight.export.deploy import deploy_settings
from deepbots_cli.insight.export.network import Graph, check_network, decide
from deepbots_cli.learning.learner import Learner
from deepbots_cli.program import Program

DEPLOY_NAME, GRAPH_NAME = PurePosixPath("params/deploy.yaml"), PurePosixPath("exported/policy.onnx")


def isaac_files(program: Program, learner: Learner) -> dict[PurePosixPath, bytes]:
    """Return `params/deploy.yaml` and `exported/policy.onnx`.

    Raises:
        UsageError: The scenario is refused by `deploy_settings`.
    """
    text = yaml.safe_dump(
        deploy_settings(program), default_flow_style=None, sort_keys=False, allow_unicode=True
    )
    check_network(learner, program)
    graph = Graph()
    observation = graph.input("obs", np.float32, 1, len(program.agent.inputs))
    decision = decide(graph, learner.network(), program, {"observation": observation})
    graph.output("actions", decision.action, np.float32, 1, len(program.agent.range_names))
    return {DEPLOY_NAME: text.encode(), GRAPH_NAME: graph.model(program.name)}
