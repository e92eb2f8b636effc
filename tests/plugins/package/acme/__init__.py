"""A plug-in of deepbots: a sensor, a function, a lint rule, a message format, an algorithm, an engine, a scenario with its robot."""
