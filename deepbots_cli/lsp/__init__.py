"""A language server for scenarios: `deepbots lsp`.

server.py                 request handlers, findings as diagnostics, background analysis, code actions and
                          formatting
workspace.py              open documents, their analyses and locations, and the view of the cursor that
                          answers requests
cursor.py                 the path of the cursor in a text that may be broken YAML
lookup.py                 shapes of the schema and definitions at a path or the cursor; document symbols
hover.py                  hover texts
uses.py                   the uses of a name
completion.py             completion in keys, values, and texts of the expression language
written_names.py          names that the current text defines
choices.py                the choices of a completion

The server writes no file, reads nothing outside of the project, and simulates nothing.
"""
