"""Work spread over processes of this machine or over a cluster, with Ray. Only this package imports it.

session.py   `Cluster`: a Ray of its own on this machine, or one that runs already
shards.py    the shards of a training as Ray actors, which are replaced when they are lost
tasks.py     calls of a function as Ray tasks, such as trainings of a group, which are repeated when they are lost

The result of a training does not depend on where its parts run: shards and trainings are functions of the scenario, the seed and their
number. What a worker computes therefore may be lost, and is computed again elsewhere.
"""

from deepbots_cli.cluster.session import Cluster

__all__ = ["Cluster"]
