"""Build the documentation site: `python docs/build.py`, then open build/site/index.html.

Warnings are errors. With --execute the commands and programs of the tutorials are run first, and what they print is
compared with what the pages say (docs/execute.py).
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent


def main() -> int:
    """Run Sphinx; its exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--execute", action="store_true", help="run the tutorials first")
    parser.add_argument("--out", type=Path, default=HERE.parent / "build" / "site")
    given = parser.parse_args()
    if given.execute and (code := subprocess.call([sys.executable, HERE / "execute.py"])):
        return code
    options = ["-W", "--keep-going", "-q", "-j", "2", "-d", str(given.out.parent / "site-doctrees")]
    return subprocess.call([sys.executable, "-m", "sphinx", *options, str(HERE), str(given.out)])


if __name__ == "__main__":
    sys.exit(main())
