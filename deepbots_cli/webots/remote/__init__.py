"""Controllers as processes of their own: `deepbots webots --processes`.

server.py  the messages; starts the processes, and answers their requests
client.py  the classes of the module `controller` in such a process: each call goes to the server

Run as a program, the package runs the program of a controller. A controller has its turn from the end of a
step until the next step, as in one process, so both ways run the same simulation.
"""
