"""The learner of `rsl_rl.PPO`, on RSL-RL. Only this package imports it.

learner.py       `RslLearner`: PPO behind the interface of `learning.learner`
internals.py     the private members of RSL-RL and torch that the learner uses

The settings are a model of `scenario.training`, and our defaults are in `learning.sb3.defaults`.
"""
