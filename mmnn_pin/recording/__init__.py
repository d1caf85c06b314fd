"""One run, written as it happens and read afterwards."""
