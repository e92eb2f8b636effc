"""The expression language: text with units in, typed tree, scalar trees and Python text out.

It knows nothing of YAML or scenarios: it sees a text, a scope that resolves names, and a place to
report findings to. Read in this order:

dimensions.py  what a quantity measures             units.py      the names behind numbers
lexer.py       text to tokens                       syntax.py     the untyped tree
stream.py      the tokens one by one, quantities    parser.py     tokens to tree
foreign.py     habits of other languages, refused kindly
types.py       Type, Stage, Symbol, Subject, Scope  intervals.py  interval arithmetic
functions.py   what an entry of the table says      table.py      the functions of the language
examples.py    a call of each, for the reference
typed.py       the typed tree                       check.py      tree to typed tree, with
                 names.py, operators.py, calls.py, agree.py, size.py, guesses.py
expect.py      what a field demands of a value
scalar.py      what is left: single SI numbers      lower.py      typed tree to scalars, with
                 fold.py (constants), geometry.py (world functions)
state.py       stateful functions as statements     emit.py       scalars to Python text
"""
