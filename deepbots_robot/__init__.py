"""A policy on a robot: what runs a bundle beside a robot, without deepbots and without a simulator.

topics.py   which part of a ROS 2 message carries a field, with units and counts; the first mapping of a robot
idl.py      the ROS 2 messages as types of Cyclone DDS
"""
