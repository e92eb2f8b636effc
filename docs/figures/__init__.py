"""Pictures of the pages, drawn as SVG: python docs/build_figures.py writes them to docs/images and course.

drawing.py    lines, arrows, shapes and texts, in light and dark colors
frames.py     the frames of a robot file
rays.py       the rays of a distance sensor, and what it reads
regions.py    three starts of a scenario of docs/resets.md
terrain.py    two terrains as nets
channel.py    messages on their way through a channel
value.py      the way of a value from the robot file to the policy
curriculum.py the success rate over the stages of a curriculum
intervals.py  the interval of a success rate
loop.py       the loop of observation, action and reward
rover.py      the robot of the lessons from above
axes.py       the places of its sensors
wheels.py     what its wheels do with an action
"""
