"""Chapter 5 of the thesis: a rig that fits what it prints, and how the ranking depends on the rig (docs/chapter5.md)."""
