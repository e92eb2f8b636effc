"""The process of a controller: `python -m deepbots_cli.webots.remote PIPE PROGRAM [ARGUMENT...]`."""

from __future__ import annotations

import os
import sys
import types
from multiprocessing.connection import Connection
from pathlib import Path

from deepbots_cli.webots.remote.client import connect, controller_module
from deepbots_cli.webots.runner import describe, print_traceback


def main() -> None:
    """Run the program with its folder, the module `controller` and further packages on its path."""
    pipe, program, *arguments = sys.argv[1:]
    session = connect(Connection(int(pipe)))
    packages = [
        folder for folder in os.environ.pop("DEEPBOTS_CONTROLLER_PACKAGES", "").split(os.pathsep) if folder
    ]
    # `python_environment` has set it for this process alone, not for those that the program starts.
    os.environ.pop("PYTHONSAFEPATH", None)
    sys.path[:0] = [str(Path(program).parent), *packages]
    sys.modules["controller"] = controller_module()
    sys.argv = [program, *arguments]
    module = types.ModuleType("__main__")
    module.__file__ = program
    module.__builtins__ = __builtins__  # type: ignore[attr-defined]
    sys.modules["__main__"] = module
    try:
        exec(compile(Path(program).read_bytes(), program, "exec"), vars(module))  # after --allow-code
    except Exception as error:  # noqa: BLE001  # a failure of a program is reported
        print_traceback(error, __file__)
        session.fail(describe(error))
        raise SystemExit(1) from None


main()
