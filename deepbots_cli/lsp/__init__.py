"""A language server for scenarios: `deepbots lsp`.

server.py       request handlers, findings as diagnostics, background analysis, code actions and formatting
workspace.py    open documents, their analyses and locations, and the view of the cursor that answers
                requests
cursor.py       the path of the cursor in a text that may be broken YAML, and what the schema allows at a path
hover.py        what is under the cursor: hover texts and definitions
completion.py   completion in keys, values, and texts of the expression language

The server writes no file, reads nothing outside of the project, and simulates nothing.
"""
