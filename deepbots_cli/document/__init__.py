"""From YAML text to nodes with their position in the file.

files.py         which files a scenario may read; bytes to text
parse.py         YAML text to nodes, within limits
syntax_hints.py  the messages of syntax errors
value_hints.py   valid YAML that is probably a mistake
nodes.py         Scalar, Sequence, Mapping; paths, walking, changed trees
load.py          a scenario with the files that it extends and includes, `remove` and `--set`, as one Document
layout.py        nodes to text: the canonical layout, and written trees; edits that keep the other text
shipped.py       the scenarios and robots that come with deepbots
"""

from deepbots_cli.document.load import Document, Permissions, load, loads
from deepbots_cli.document.nodes import (
    Entry,
    MappingNode,
    Node,
    NodePath,
    ScalarNode,
    SequenceNode,
    descend,
    inline_text,
    to_data,
    walk,
)

__all__ = [
    "Document",
    "Entry",
    "MappingNode",
    "Node",
    "NodePath",
    "Permissions",
    "ScalarNode",
    "SequenceNode",
    "descend",
    "inline_text",
    "load",
    "loads",
    "to_data",
    "walk",
]
