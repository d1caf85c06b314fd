"""The report: one HTML page that tells a colleague what was run, how good it was, and whether to believe it.

recordings -> result (metrics) -> verdict, tables, charts, robots, origin -> page, with the replay in it
"""

from .page import Report, report

__all__ = ["Report", "report"]
