"""Projects of Webots: worlds, robots and controllers, run on MuJoCo.

syntax.py           a `.wbt` or `.proto` file as a tree of nodes with their places
nodes.py            the node types of Webots (`nodes.txt`), and the values of fields
protos.py           PROTO nodes: their definitions, and the nodes that they stand for
library.py          PROTOs of Webots' own library that deepbots has an equivalent of
scene.py            bodies, joints, geometries and devices
scene_builder.py    the tree as a scene
shapes.py           geometries: sizes, volumes, meshes
looks.py            what is seen: geometry, color, and the pictures on it
model.py            a scene as a model of MuJoCo
physics.py          its state: steps, bounces, readings; motors as constraints; rays
simulation.py       time, messages and sampling: what a controller's step does
device.py           what devices share: sampling, lookup tables
joints.py           motors, brakes, position sensors
sensors.py          sensors of motion, light and the surroundings
cameras.py          cameras and range finders
rendering.py        the pictures that they take
ranging.py          lidars and radars
devices.py          emitters, receivers, devices that do little; the class of each device
tree.py             the classes Node and Field
supervisor.py       the classes Robot, Supervisor and Keyboard
unimplemented.py    names of Webots' functions that are not implemented, and their error
runner.py           controllers as threads of one process, one at a time
remote/             controllers as processes of their own
pace.py             when a world may advance: the pace of a clock, pauses, single steps
recorder.py         the viewpoint of a world, and a video of a run from it
viewer.py           a run in the browser
project.py          the files of a project: worlds, controllers, PROTOs
site/               the folder with the module `controller`, on the path of controllers
imports/            a project as a scenario: `deepbots new --webots`
findings.py         findings about the files of a project
export/             a scenario as a project of Webots
bridge/             what the controllers of an exported project use

A controller imports `controller` as in Webots; `deepbots webots` runs it.
"""
