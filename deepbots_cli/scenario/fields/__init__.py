"""Field types: the type of a single value of a scenario.

A field type is part of the annotation of a field, `Annotated[str | int | float, Quantity("length")]`. It
checks the form of the value (a text, a number, a range) and raises errors with the code, headline and help of
a finding. `scenario.base.visit_values` passes it to the compiler, which reads units, names and expressions
inside a text. A value is kept as it is written.

base.py        FieldType, the base of all; errors
names.py       texts, truth values, words of the language, colors; names, references to them, files
quantities.py  numbers without a unit; texts of the expression language: quantities, ranges, expressions
training.py    schedules, criteria of stages and of a solved task

A module imports only modules above it. Aliases at the end of a module are the field types that several
sections use. A value of an alias `Randomizable...` may be drawn in every episode.
"""
