"""From text to nodes that know their place.

files.py      bytes to text: size, encoding, characters
parse.py      YAML text to nodes, within limits; parsers.py what is used of PyYAML
traps.py      text that is YAML, but not what was meant
scalars.py    what a plain scalar means, and which ones look like something else
places.py     where each character of a quoted or folded scalar stands in the file
syntax.py     the wording of syntax errors
nodes.py      Scalar, Sequence, Mapping
roots.py      which files a scenario may name
shipped.py    the scenarios and robots that come with deepbots
merge.py      two trees to one; dotted paths
removal.py    an entry taken out of the text of a file
overrides.py  `--set path=value`
layout.py     the canonical layout of a file
text.py       nodes back to YAML text
load.py       a file with all that it extends and includes, as one Document
"""

from deepbots_cli.document.load import Document, load, loads
from deepbots_cli.document.nodes import Entry, Mapping, Node, Path, Scalar, Sequence, descend, one_line, to_data, walk

__all__ = ["Document", "Entry", "Mapping", "Node", "Path", "Scalar", "Sequence", "descend", "load", "loads", "one_line", "to_data", "walk"]
