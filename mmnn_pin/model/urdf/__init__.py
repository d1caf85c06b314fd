"""The audit of a URDF: what would make a loader guess, drop or crash is found before a loader sees the file.

A check is a function from the `<robot>` element (or the tree of links) to its findings; `checks.audit` runs them all.
"""
