"""The commands `deepbots-robot check BUNDLE` and `deepbots-robot serve BUNDLE`, for machines without deepbots
itself.

Use the script `deepbots-robot`: `python -m` puts the current folder first on the path of imports, so in the
folder of a bundle it would run a file `json.py` of that bundle.
"""

from __future__ import annotations

import argparse
import io
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from deepbots_robot.bundle import load
from deepbots_robot.model import BundleError
from deepbots_robot.server import report_lines
from deepbots_robot.serving import NO_ROS1, ServeError, Transport, nothing_served, serve


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="deepbots-robot", description="Check the bundle of a policy, or let the policy act for a robot."
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="check|serve")
    about = {
        "check": "check all files, repeat the recorded steps, and print what the bundle is",
        "serve": "answer what a robot measures with commands, until Ctrl-C",
    }
    for name, text in about.items():
        command = commands.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.")
        command.add_argument("bundle", type=Path, help="a folder of `deepbots export`")
        command.add_argument(
            "--trusted",
            metavar="FILE",
            type=Path,
            help="require a signature by one of the public keys in this file",
        )
        command.add_argument("--json", action="store_true", help="print the result as JSON")
    serving = commands.choices["serve"]
    link = serving.add_mutually_exclusive_group()
    link.add_argument("--ros", action="store_true", help="ROS 2 over Cyclone DDS; the default")
    serving.add_argument("--ros1", action="store_true", help=argparse.SUPPRESS)
    serving.add_argument(
        "--interface", metavar="NAME", help="network interface of ROS 2; by default the loopback interface"
    )
    serving.add_argument(
        "--domain", metavar="N", type=int, help="domain of ROS 2, as ROS_DOMAIN_ID; 0 by default"
    )
    link.add_argument("--zmq", metavar="ADDRESS", help="ZeroMQ at an address such as tcp://127.0.0.1:5555")
    link.add_argument("--websocket", metavar="PORT", help="WebSocket at a port of this machine, or HOST:PORT")
    serving.add_argument(
        "--lockstep",
        action="store_true",
        help="answer each set of values once; the robot waits for the answer",
    )
    serving.add_argument(
        "--speed", metavar="N", type=float, default=1.0, help="how fast the time of the robot passes"
    )
    serving.add_argument("--log", metavar="FILE", type=Path, help="write an MCAP log")
    serving.add_argument("--seconds", metavar="N", type=float, help="stop after so many seconds")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command. Returns 1 after an error, or if nothing was served in `--seconds`."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # a terminal of another encoding shows escapes
    options = _parser().parse_args(arguments)
    try:
        return _check(options) if options.command == "check" else _serve(options)
    except (BundleError, ServeError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1


def _check(options: argparse.Namespace) -> int:
    bundle = load(options.bundle, trusted=options.trusted)
    info = bundle.info
    signed = options.trusted is not None
    if options.json:
        about = {
            "scenario": info.scenario.name,
            "digest": info.scenario.digest,
            "rate_hz": info.rate_hz,
            "signature_checked": signed,
        }
        print(json.dumps(about))
        return 0
    result = "not evaluated" if info.evaluation is None else info.evaluation.text
    print(f"{info.scenario.name}: all files are those that were exported, and the recorded steps repeat")
    print(f"  {info.training.algorithm}, {info.rate_hz:g} Hz; {result}")
    print(f"  signed with a trusted key: {'yes' if signed else 'not checked (--trusted FILE)'}")
    return 0


def _serve(options: argparse.Namespace) -> int:
    if options.ros1:
        raise ServeError(NO_ROS1)
    transport = Transport(options.zmq, options.websocket, options.interface, options.domain or 0)
    if not transport.is_ros and not (options.interface is None and options.domain is None):
        raise ServeError("--interface and --domain belong to ROS 2; leave out --zmq or --websocket")
    report = serve(
        load(options.bundle, trusted=options.trusted),
        transport,
        speed=options.speed,
        lockstep=options.lockstep,
        log=options.log,
        seconds=options.seconds,
        note=lambda text: print(text, file=sys.stderr, flush=True),
    )
    print(json.dumps(report) if options.json else "\n".join(report_lines(report)))
    nothing = nothing_served(report, options.seconds)
    if nothing:
        print(f"error: {nothing}", file=sys.stderr)
    return 1 if nothing else 0


if __name__ == "__main__":
    sys.exit(main())
