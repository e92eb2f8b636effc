"""Why: what an episode came to, and why a training does not learn, in sentences with their numbers.

conditions.py  the endings of a scenario as comparisons whose values an episode keeps
trace.py       an episode that runs again, with what each step saw, did, earned and measured
statements.py  sentences with their evidence: the form of every row in the two tables
episode.py     the table that explains an episode
training.py    what is known of a training: its logs, and a few short episodes
diagnosis.py   the table of causes why a training does not learn
"""
