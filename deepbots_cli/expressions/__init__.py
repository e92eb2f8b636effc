"""The expression language: text with units in, typed tree, scalar trees and Python text out.

It knows nothing of YAML or scenarios: it sees a text, a scope that resolves names, and a place to
report findings to. Read in this order:

dimensions.py   what a quantity measures, and the names behind numbers
intervals.py    interval arithmetic
types.py        types, stages, symbols, scopes; the typed tree
syntax.py       tokens and the untyped tree
parser.py       text to tree, with hints for the commonest slips
functions.py    THE table: all that is known of each function and operator; functions of other packages
unification.py  whether values fit together and fit their field
check.py        tree to typed tree
scalar.py       single SI numbers: what the compiled scenario holds
lower.py        typed tree to scalars; constants are folded
printer.py      scalars to Python text; stateful functions as statements
"""
