"""`python -m research.contest`."""

import sys

from research import alone
from research.contest.command import contest

sys.exit(alone(contest))
