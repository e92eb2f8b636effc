"""Projects of Webots: worlds, robots and controllers, run on MuJoCo.

syntax.py       a `.wbt` or `.proto` file as a tree of nodes with their places
nodes.py        the node types of Webots (`nodes.txt`), and the values of fields
protos.py       PROTO nodes: their definitions, and the nodes that they stand for
library.py      PROTOs of Webots' own library that deepbots has an equivalent of
scene.py        the tree as bodies, joints, geometries and devices
shapes.py       geometries: sizes, volumes, meshes
physics.py      a scene as a model of MuJoCo, and its state
simulation.py   time, messages and sampling: what a controller's step does
devices.py      the classes of devices in the module `controller`
supervisor.py   the classes Node, Field and Supervisor
api.py          names of Webots' functions that are not implemented, and their error
runner.py       controllers as threads of one process, one at a time
project.py      the files of a project: worlds, controllers, PROTOs
site/           the folder with the module `controller`, on the path of controllers
findings.py     findings about the files of a project

A controller imports `controller` as in Webots; `deepbots webots` runs it.
"""
