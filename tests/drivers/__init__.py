"""Every bundle on drivers that run without hardware: docs/drivers.md."""

import sys
from pathlib import Path

TESTS = str(Path(__file__).resolve().parents[1])
if TESTS not in sys.path:  # `python -m tests.drivers.tables`: what the tests share is beside us
    sys.path.insert(0, TESTS)
