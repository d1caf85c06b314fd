"""Public robots against the truth about them."""
