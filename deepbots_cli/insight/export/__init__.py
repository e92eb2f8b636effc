"""A policy for a robot: a graph of ONNX from the measurements of sensors to the commands of actuators, with
all facts that are needed to use it.

trees.py      expressions of a scenario as nodes, and the values that a control step passes to the next one
network.py    a graph under construction; the networks of a policy as its nodes, compared with the learner
devices.py    the inputs: sensors, readings of the world, goals; the outputs: the command of each actuator,
              its limits, its safe posture; steps of a simulation for an exported policy
control.py    a whole control step as one graph; the meaning of names in it
parity.py     the check that an exported policy acts as in the scenario, and the recorded steps of a bundle
deploy.py     a policy in the form that runners of Isaac Lab read, and their settings, from the scenario alone
lerobot.py    the scaling of a policy as processors of LeRobot
hub.py        a bundle with a card, the model and a video, for a model hub
bundle.py     the folder that `deepbots export` writes, and whether it fits a scenario
"""
