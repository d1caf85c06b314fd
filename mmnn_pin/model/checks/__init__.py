"""The properties of a robot that the proof needs, as residuals that users, tests and plots share."""
