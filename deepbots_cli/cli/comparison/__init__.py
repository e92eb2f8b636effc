"""Two scenarios compared by meaning: what `deepbots diff` shows.

items.py     a compiled scenario as items, each with its path in the words of the language and the group that it belongs to
sides.py     where a scenario comes from: a file, or a run, with the text of both
changes.py   the items that two scenarios do not share, and how they were worded
"""
