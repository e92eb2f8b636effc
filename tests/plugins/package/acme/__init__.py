"""A plug-in of deepbots: sensor, actuator, function, lint rule, message format, algorithm, engine, scenarios
with a robot."""
