"""Chapter 5 of the thesis: a rig that fits what it prints, and what a ranking depends on (docs/thesis/chapter5.md)."""
