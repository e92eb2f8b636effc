"""The tables of `deepbots inspect`: their captions, and those that it shows without `--full`."""

from __future__ import annotations

from deepbots_cli.cli.sources import OpenedSource
from deepbots_cli.diagnostics import Source, Span
from deepbots_cli.document import MappingNode

CAPTIONS = {
    "observation": "low .. high is mapped to the range in `seen_as`; values outside are clipped",
    "critic": "what only the value function sees, in training",
    "mirror_images": "the value of a number in the mirror image is `sign` times the value of `mirror_image`",
    "poses": "end links of the robots at the start of the episode with seed 0, in the world frame",
    "drawn": "values that each reset draws",
    "hyperparameters": "`from` names the source of each value: the scenario, or the default of deepbots or"
    " of the library",
    "timing": "the physics step of each action and measurement, for step n = 0, 1, ... of the agent; the"
    " first physics step is 1",
}
BRIEF_TABLES = (
    "run",
    "scenario",
    "robots",
    "message_fields",
    "observation",
    "critic",
    "action",
    "mirror_images",
    "reward",
    "endings",
    "training",
)
"""The tables without `--full`."""


def root_of(side: OpenedSource, reference: str) -> MappingNode:
    """Return the mapping of a scenario, an empty one if it has none."""
    if isinstance(side.root, MappingNode):
        return side.root
    return MappingNode(Span(Source(reference, ""), 0, 0), {})
