"""A language server for scenarios: `deepbots lsp`.

server.py         the server and its request handlers
workspace.py      open documents, positions in them, their analyses, and the view of a place that requests are answered from
cursor.py         the path of the cursor in a text that may be broken YAML
lookup.py         what the schema allows at a path; the expression, key or value under the cursor

diagnostics.py    findings as diagnostics; analysis in the background
completion.py     completion of keys, words, names, expressions and files
hover.py          hover texts
navigation.py     go to definition and document symbols
code_actions.py   fixes, suppressions and formatting

The server writes no file, reads nothing outside of the project, and simulates nothing.
"""
