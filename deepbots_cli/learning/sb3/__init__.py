"""The learner of Stable-Baselines3 and sb3-contrib. Only this package imports them.

algorithms.py    algorithms made for a scenario, action noise
defaults.py      the hyperparameters that a training takes: the scenario's, our defaults, the library's
models.py        models as zip files of the library, read without unpickling
plugins.py       callbacks and loggers of other packages
"""
