"""The learner of the built-in algorithms, on Stable-Baselines3 and sb3-contrib. Only this package imports
them.

learner.py       `OnPolicyLearner`, `OffPolicyLearner`: algorithms behind the interface of `learning.learner`
internals.py     the private members of the library that deepbots uses
algorithms.py    algorithms created for a scenario, with their schedules, noise and limits
defaults.py      the hyperparameters that a training takes: the scenario's, our defaults, the library's
rollouts.py      actors and their buffers; the worlds of a collector as a vector environment
imitation.py     the imitation loss of on-policy algorithms with a teacher
models.py        models as zip files of the library, read without unpickling; the state beside them
networks.py      the layers of a policy, the values of its critic; mirror images of experience
logs.py          scalars for TensorBoard and other loggers; callbacks and loggers of other packages
"""
