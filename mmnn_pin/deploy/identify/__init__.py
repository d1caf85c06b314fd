"""From recorded motion to a corrected URDF: logs read, equations stacked, parameters fitted, judged and written."""
