"""The expression language: text with units to typed tree, scalar trees and Python text.

The package is independent of YAML and scenarios. Its input is a text, a scope that resolves names, and a
function that takes findings. Read in this order:

dimensions.py   dimensions and units
intervals.py    interval arithmetic
types.py        types (with the time from which a value is known), symbols and scopes; the typed tree
syntax.py       tokens and the syntax tree
parser.py       text to syntax tree, with hints for common mistakes
functions.py    the table of functions and operators, and their Python; intervals of scalar trees
unification.py  agreement of values with each other and with their field
check.py        syntax tree to typed tree
scalar.py       scalar trees: one tree per SI number, as in the compiled scenario
lower.py        typed tree to scalar trees, with constants folded
text.py         values and scalar trees as text for people, and as Python; the units of a text
"""
