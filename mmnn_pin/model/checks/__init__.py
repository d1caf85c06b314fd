"""What the proof needs of a robot, as residuals that users, tests and plots share."""
