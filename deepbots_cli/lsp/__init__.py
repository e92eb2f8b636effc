"""A language server for scenarios: `deepbots lsp`.

server.py         request handlers; findings as diagnostics; analysis in the background; code actions and
                  formatting
workspace.py      open documents, positions in them, their analyses and locations, and the view of a place
                  that requests are answered from
cursor.py         the path of the cursor in a text that may be broken YAML
lookup.py         what the schema allows at a path; what is under the cursor, its definition and hover text;
                  document symbols

completion.py     completion of keys, words, names, expressions and files

The server writes no file, reads nothing outside of the project, and simulates nothing.
"""
