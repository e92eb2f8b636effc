"""The graphical output: a page in the browser, pictures, clips and recordings, made of the same frames; and
plots of trainings.

frames.py         the drawn values of an environment at one moment, read by the engine port
episodes.py       the opened source, the driver, and the frames of an episode, of one world or a batch
replay.py         the player of a source; playing a recording, running it again to compare, and playing the
                  log of a robot
scene.py          the world in viser's scene, and the cameras of the browsers
server.py         the checks of a server for one person (host, origin, token), and viser's web server behind
                  them
page.py           the page, its reloads, and the loop that steps and draws
playback.py       the worlds of the page in time: players, episodes, steps; driving by keys, gamepad and
                  sliders
panel.py          the panel of the page, its tabs, tables and notices
pictures.py       PNG pictures, MP4 and GIF clips, and offline pages; the moving parts of an episode, and
                  their paths
recordings.py     episodes as MCAP files, written and read
training_logs.py  the logs of trainings as curves
plots.py          the plots of these curves

viser is in the extra `view`; pictures and clips other than offline pages do without it.
"""
