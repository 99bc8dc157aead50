"""Python processes that are waited for, and what they said."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping
from typing import Any


def python(*arguments: object, environment: Mapping[str, str] | None = None, **more: Any) -> Any:
    """The ended process. `environment` is added to ours; `more` is for `subprocess.run`."""
    command = [sys.executable, *map(str, arguments)]
    settings = {"capture_output": True, "text": True, "timeout": 120, "check": False, **more}
    return subprocess.run(command, env=os.environ | (environment or {}), **settings)


def fleet(*arguments: object, **more: Any) -> subprocess.CompletedProcess[str]:
    """The same of `fleet` with these arguments."""
    return python("-m", "fleet", *arguments, **more)
