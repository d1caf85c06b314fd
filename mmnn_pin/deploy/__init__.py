"""Out of the simulation: controllers on robots with ROS 2 and on microcontrollers, and what a robot's recordings tell."""
