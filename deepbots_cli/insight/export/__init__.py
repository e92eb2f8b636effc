"""A policy for a robot: what sensors measure in, the commands of actuators out, as a graph of ONNX with all
that must be known of it.

graph.py      a graph under construction
trees.py      expressions of a scenario, and the memories of stateful functions, as nodes
network.py    the networks of a policy as nodes, and whether they act as the learner does
readings.py   the inputs: sensors, readings of the world, goals
actuators.py  the outputs: the command of each actuator, its limits, its safe posture
memories.py   what a control step passes to the next one
names.py      what names mean while the policy observes, and on board of a robot
control.py    a whole control step as one graph
recording.py  steps of a simulation as an exported policy sees them
parity.py     whether an exported policy acts as the scenario does, and the recorded steps of a bundle
isaac.py      a policy in the form that runners of Isaac Lab read; deploy.py its settings, from the scenario
              alone
lerobot.py    the scaling of a policy as processors of LeRobot
leapp.py      the graph of a bundle with a pipeline file of LEAPP
bundle.py     the folder that `deepbots export` writes, and whether it fits a scenario
"""
