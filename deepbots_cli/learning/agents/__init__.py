"""Several agents in the same worlds.

multi_agent.py  the learner of several agents: one for each of them
self_play.py    one policy for two equal agents, against itself and a pool of its past versions
matches.py      policies and scripts of two agents against each other
"""
