"""A language server for scenarios: `deepbots lsp`.

server.py                 request handlers, findings as diagnostics, background analysis, code actions and
                          formatting
workspace.py              open documents, their analyses and locations, and the view of the cursor that
                          answers requests
cursor.py                 the path of the cursor in a text that may be broken YAML
lookup.py                 shapes, expressions and definitions at the cursor; symbols; names in the text
hover.py                  hover texts
uses.py                   the uses of a name
completion.py             completion in keys, values, and texts of the expression language

The server writes no file, reads nothing outside of the project, and simulates nothing.
"""
