"""`python -m deepbots_robot BUNDLE`: serve a bundle where deepbots itself is not installed."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from deepbots_robot.bundle import load
from deepbots_robot.model import BundleError
from deepbots_robot.server import report_lines
from deepbots_robot.serving import ServeError, Transport, nothing_served, serve


def main() -> int:
    """Serve, and print the report; 1 after an error, or if nothing was served in `--seconds`."""
    parser = argparse.ArgumentParser(prog="python -m deepbots_robot", description="Act for a robot by the policy of a bundle.")
    parser.add_argument("bundle", type=Path, help="a folder of `deepbots export`")
    parser.add_argument("--ros", action="store_true", help="ROS 2 over Cyclone DDS; the default")
    parser.add_argument("--ros1", action="store_true", help="ROS 1 by rospy, at the master of ROS_MASTER_URI")
    parser.add_argument("--interface", metavar="NAME", help="network interface of ROS 2; by default the loopback interface")
    parser.add_argument("--domain", metavar="N", type=int, default=0, help="domain of ROS 2, as ROS_DOMAIN_ID")
    parser.add_argument("--zmq", metavar="ADDRESS", help="ZeroMQ at an address such as tcp://127.0.0.1:5555")
    parser.add_argument("--websocket", metavar="PORT", help="WebSocket at a port of this machine, or HOST:PORT")
    parser.add_argument("--lockstep", action="store_true", help="answer each set of values once; the robot waits for the answer")
    parser.add_argument("--speed", metavar="N", type=float, default=1.0, help="how fast the time of the robot passes")
    parser.add_argument("--log", metavar="FILE", type=Path, help="write an MCAP log")
    parser.add_argument("--seconds", metavar="N", type=float, help="stop after so many seconds")
    parser.add_argument("--json", action="store_true", help="print the report as JSON")
    given = parser.parse_args()
    transport = Transport(given.zmq, given.websocket, given.interface, given.domain, given.ros1)
    try:
        report = serve(
            load(given.bundle), transport, speed=given.speed, lockstep=given.lockstep, log=given.log, seconds=given.seconds,
            note=lambda text: print(text, file=sys.stderr, flush=True),
        )  # fmt: skip
    except (BundleError, ServeError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print(json.dumps(report) if given.json else "\n".join(report_lines(report)))
    nothing = nothing_served(report, given.seconds)
    if nothing:
        print(f"error: {nothing}", file=sys.stderr)
    return 1 if nothing else 0


if __name__ == "__main__":
    sys.exit(main())
