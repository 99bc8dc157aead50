"""Where things are in this repository."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
SUPPORT = Path(__file__).parent
EXPECTED = ROOT / "tests" / "expected"
GOLDEN = ROOT / "tests" / "golden"
