"""Scenarios to begin with: what `deepbots new` writes.

templates.py   from one of the templates beside it (*.yaml, arm.urdf)
"""
