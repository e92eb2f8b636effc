"""Projects of Webots: worlds, robots and controllers, run on MuJoCo.

syntax.py      a `.wbt` or `.proto` file as a tree of nodes with their places; findings about files
nodes.py       the node types of Webots (`nodes.txt`), and the values of fields
project.py     the files of a project: worlds, PROTOs with the nodes that they stand for, controllers
library/       equivalents of PROTOs of Webots: an interface, and a body that is a template
scene.py       bodies, joints, geometries and devices, made of the tree
shapes.py      geometries: sizes, volumes, meshes; what is seen: color, and the pictures on it
model.py       a scene as a model of MuJoCo
physics.py     its state: steps, bounces, readings; motors as constraints; rays
simulation.py  time, messages and sampling: what a controller's step does; the pace of a clock
rendering.py   pictures that cameras take, and a video from the viewpoint of the world
sensors.py     what devices share, missing functions; sensors of motion, light and the surroundings
imaging.py     cameras, range finders and lidars
devices.py     motors, position sensors, emitters, receivers; the class of each device
tree.py        the classes Node and Field
supervisor.py  the classes Robot, Supervisor and Keyboard
runner.py      controllers as threads of one process, one at a time
viewer.py      a run in the browser
command.py     the commands `deepbots webots` and `deepbots new --webots`
site/          the folder with the module `controller`, on the path of controllers
imports/       a project as a scenario: `deepbots new --webots`
export/        a scenario as a project of Webots
bridge/        what the controllers of an exported project use

deepbots-cli reaches the commands by the entry points of `pyproject.toml`. A controller imports `controller` as in
Webots.
"""
