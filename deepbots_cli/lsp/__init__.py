"""A language server for scenarios: `deepbots lsp`.

server.py       requests and what answers them
desk.py         what is open and what is known of it: all that requests are answered from
checking.py     analyses behind the scenes, published as they come
analysing.py    one version of a document, compiled and linted
documents.py    the files that are open
positions.py    offsets and positions of the protocol

diagnosing.py   findings as an editor shows them
completing.py   completion of keys and words; expressing.py within expressions, files.py of paths
hovering.py     what stands under the cursor       defining.py where it is defined
mending.py      fixes and suppressions             formatting.py, outlining.py

cursor.py       the path of the cursor in a text that may be broken
asking.py       what the language takes there; written.py names in the text
pointing.py     the piece of an expression, key or value under the cursor
describing.py   keys, functions, types and findings in a few lines

Nothing is written, nothing outside of the project is read, and nothing is simulated.
"""
