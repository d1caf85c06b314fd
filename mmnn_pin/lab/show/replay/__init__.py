"""Replay of recorded runs: one HTML page that holds the robot, its motion and the viewer, and needs nothing else.

    recording -> robot -> look (bodies, shapes), motion (frames), events -> one blob -> page

What is drawn is meshcat's viewer (three.js); its scene is ours. The page gets the robot's tree and the joint positions
of every frame, and computes where the links are, so a minute of motion is smaller than one mesh.
"""

from .page import ReplayPage, page, wait_until_left

__all__ = ["ReplayPage", "page", "wait_until_left"]
