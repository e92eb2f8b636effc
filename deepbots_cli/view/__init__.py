"""Everything that is seen: a page in the browser, pictures and clips, drawn from the same frames.

frames.py    what is drawn of an environment at one moment, read by the engine port
episodes.py  what is opened, who acts, and the frames of an episode
scene.py     the world in viser's scene
hand.py      driving by keys, gamepad, buttons and sliders
server.py    viser's web server behind checks
page.py      the page: panel, time, plots, and the loop that steps and draws
recordings.py  episodes as MCAP files: what is written and read
replay.py    playing a recording, and running it again to compare
pictures.py  PNG pictures, MP4 and GIF clips, and offline pages

viser is the extra `view`; pictures and clips other than offline pages do without it.
"""
