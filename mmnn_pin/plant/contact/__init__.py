"""The contact plant: the same robot in MuJoCo, free to slip. Needs the extra `contact`."""
