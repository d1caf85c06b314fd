"""Chapter 4 of the thesis: calibration, what the figures determine, and the claim, tested (docs/thesis/chapter4.md)."""
