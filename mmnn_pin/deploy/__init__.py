"""Out of the simulation: robots with ROS 2, microcontrollers, and what recordings of robots tell."""
