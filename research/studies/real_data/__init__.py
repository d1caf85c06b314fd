"""What learners know of real robots' torques on motions that they never saw: `python -m research.studies.real_data`."""
