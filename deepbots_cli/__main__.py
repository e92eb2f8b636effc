"""`python -m deepbots_cli` is `deepbots`."""

from __future__ import annotations

import sys

from deepbots_cli.cli import main

sys.exit(main())
